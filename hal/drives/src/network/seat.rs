//! The masters' ends of the buses in memory.

use super::super::motor::Motor;
use super::super::wire::Order;
use super::Network;
use hal::TimeNs;
use trocar_canopen::Frame;
use trocar_canopen::master::{Bus, Received};

/// A master's controller on one bus.
pub(super) struct Seat {
    /// On the wire of its bus.
    pub(super) port: usize,
    /// What has arrived since the last `receive`, unbounded.
    pub(super) inbox: Vec<Received>,
}

impl<M: Motor> Network<M> {
    /// Puts another master on every bus, with queues of `queue` frames; gives its number. The first
    /// one is 0.
    pub fn add_master(&mut self, queue: usize) -> usize {
        let number = self.lines.first().map_or(0, |line| line.masters.len());
        for line in &mut self.lines {
            let port = line.wire.attach(Order::Fifo, queue);
            let inbox = Vec::new();
            line.masters.push(Seat { port, inbox });
        }
        number
    }

    /// As [`Bus::send`], for `master`.
    ///
    /// Gives how many found room, in order; the rest are not queued. 0 for a bus or a master that
    /// is not there.
    pub fn send_as(&mut self, master: usize, line: u8, frames: &[Frame]) -> usize {
        let now = self.now;
        let Some(line) = self.lines.get_mut(usize::from(line)) else {
            return 0;
        };
        let Some(Seat { port, .. }) = line.masters.get(master) else {
            return 0;
        };
        frames
            .iter()
            .take_while(|frame| line.wire.send(now, *port, **frame).is_ok())
            .count()
    }

    /// As [`Bus::receive`], for `master`.
    pub fn receive_as(&mut self, master: usize, line: u8, sink: &mut dyn FnMut(Received)) {
        let line = self.lines.get_mut(usize::from(line));
        if let Some(seat) = line.and_then(|line| line.masters.get_mut(master)) {
            seat.inbox.drain(..).for_each(sink);
        }
    }

    /// As [`Bus::flush`], for `master`.
    pub fn flush_as(&mut self, master: usize, line: u8) {
        if let Some(line) = self.lines.get_mut(usize::from(line))
            && let Some(seat) = line.masters.get(master)
        {
            line.wire.discard(seat.port);
        }
    }

    /// When everything that drives want to say now will have been said, if nothing else comes from
    /// the first master; none if there is nothing.
    #[must_use]
    pub fn silent_at(&self) -> Option<TimeNs> {
        let lines = self.lines.iter();
        lines
            .filter_map(|line| line.wire.silent_at(line.masters.first()?.port))
            .max()
    }

    /// Whether frames of the first master wait for their bus.
    #[must_use]
    pub fn has_pending_frames(&self) -> bool {
        let mut lines = (0..).zip(&self.lines);
        lines.any(|(line, _)| self.waiting(0, line) > 0)
    }

    /// Frames of `master` that wait on `line`.
    #[must_use]
    pub fn waiting(&self, master: usize, line: u8) -> usize {
        let line = &self.lines[usize::from(line)];
        line.masters
            .get(master)
            .map_or(0, |seat| line.wire.waiting(seat.port))
    }
}

impl<M: Motor> Bus for Network<M> {
    fn now(&self) -> TimeNs {
        self.now
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.send_as(0, line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.receive_as(0, line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.flush_as(0, line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.advance(until);
    }
}
