//! Buses that are interfaces of Linux: raw CAN sockets, in batches, without waiting. Hot path:
//! bounded, no allocation.
//!
//! Error frames are enabled, so the controller's errors are reported; a socket that was too slow
//! tells how many frames it missed. What waits in an interface's queue is the kernel's: it throws
//! it away when the controller leaves the bus, and nothing here can call it back, so after bus-off
//! the master says nothing more on that line.

mod sys;

use std::io;

use socketcan::id::ERR_MASK_ALL;
use socketcan::{CanSocket, Socket as _, SocketOptions as _};

use super::master::{Bus, ControllerEvent, Received};
use super::{CanId, Frame, Payload};
use hal::TimeNs;
use sys::{BATCH, RawFrame};

/// Most batches that one call takes: more than any bus brings in a cycle. What is left waits for
/// the next call.
const BATCHES_MAX: usize = 32;

/// The time, and how to wait for it. Only the real-time driver has a clock, so it lends one.
pub trait Clock {
    /// What time it is.
    fn now(&self) -> TimeNs;

    /// Waits until `until` or a little later.
    fn wait(&mut self, until: TimeNs);
}

/// An interface cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{name}: cannot be opened as a CAN interface")]
pub struct OpenError {
    /// The interface.
    pub name: String,
    /// The system's reason.
    #[source]
    pub source: io::Error,
}

/// One to three interfaces.
#[derive(Debug)]
pub struct SocketBus<C> {
    lines: Vec<Line>,
    clock: C,
}

#[derive(Debug)]
struct Line {
    socket: CanSocket,
    /// Frames that this socket missed so far, as the kernel counts.
    missed: u32,
    /// What sending met, to be reported with the next frames.
    trouble: Option<ControllerEvent>,
}

impl<C: Clock> SocketBus<C> {
    /// Opens the interfaces `names`, which are line 0, 1 and so on.
    ///
    /// # Errors
    /// [`OpenError`] with the name.
    pub fn open(names: &[String], clock: C) -> Result<Self, OpenError> {
        let lines = names
            .iter()
            .map(|name| {
                Line::open(name).map_err(|source| OpenError {
                    name: name.clone(),
                    source,
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { lines, clock })
    }
}

impl<C: Clock> SocketBus<C> {
    /// Waits until something has come on any line, for `timeout_ns` of the system's time at most;
    /// `false` if a line is in trouble, for which no waiting helps.
    pub fn wait_for_frames(&mut self, timeout_ns: u64) -> bool {
        sys::wait_readable(self.lines.iter().map(|line| &line.socket), timeout_ns)
    }
}

impl Line {
    fn open(name: &str) -> io::Result<Self> {
        let socket = CanSocket::open(name)?;
        socket.set_nonblocking(true)?;
        socket.set_error_filter(ERR_MASK_ALL)?;
        sys::count_missed(&socket)?;
        Ok(Self {
            socket,
            missed: 0,
            trouble: None,
        })
    }

    fn send(&mut self, frames: &[Frame]) -> usize {
        let mut sent = 0;
        for chunk in frames.chunks(BATCH) {
            let mut raw = [RawFrame::default(); BATCH];
            for (place, frame) in raw.iter_mut().zip(chunk) {
                *place = RawFrame::of(frame);
            }
            match sys::send(&self.socket, &mut raw[..chunk.len()]) {
                Ok(count) => {
                    sent += count;
                    if count < chunk.len() {
                        break;
                    }
                }
                Err(error) => {
                    if is_down(&error) {
                        self.trouble = Some(ControllerEvent::Down);
                    }
                    break;
                }
            }
        }
        sent
    }

    /// Reports the frames that the kernel dropped since it last said how many; `missed` is its
    /// count since the socket was opened.
    fn tell_lost(&mut self, missed: Option<u32>, sink: &mut dyn FnMut(Received)) {
        let missed = missed.unwrap_or(self.missed);
        let lost = missed.wrapping_sub(self.missed);
        self.missed = missed;
        if lost > 0 {
            sink(Received::ControllerEvent(ControllerEvent::Lost(lost)));
        }
    }

    fn receive(&mut self, sink: &mut dyn FnMut(Received)) {
        if let Some(trouble) = self.trouble.take() {
            sink(Received::ControllerEvent(trouble));
        }
        let mut raw = [RawFrame::default(); BATCH];
        for _ in 0..BATCHES_MAX {
            match sys::receive(&self.socket, &mut raw) {
                Ok((count, missed)) => {
                    raw.iter().take(count).for_each(|frame| frame.tell(sink));
                    self.tell_lost(missed, sink);
                    if count < BATCH {
                        return;
                    }
                }
                Err(error) => {
                    if is_down(&error) {
                        sink(Received::ControllerEvent(ControllerEvent::Down));
                    }
                    return;
                }
            }
        }
    }
}

fn is_down(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::ENETDOWN | libc::ENODEV | libc::ENXIO)
    )
}

impl RawFrame {
    fn of(frame: &Frame) -> Self {
        let mut data = [0; 8];
        data[..frame.data().len()].copy_from_slice(frame.data());
        Self {
            id: frame.id.raw().into(),
            length: frame.payload.length(),
            data,
            ..Self::default()
        }
    }

    /// Says what it means, if it means anything.
    fn tell(&self, sink: &mut dyn FnMut(Received)) {
        if self.id & libc::CAN_ERR_FLAG != 0 {
            self.tell_trouble(sink);
            return;
        }
        let special = self.id & (libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG) != 0;
        let id = u16::try_from(self.id).ok().and_then(CanId::new);
        let length = usize::from(self.length).min(self.data.len());
        sink(match id.filter(|_| !special) {
            Some(id) => {
                let payload = Payload::truncated(&self.data[..length]);
                Received::Frame(Frame::new(id, payload))
            }
            None => Received::ControllerEvent(ControllerEvent::Foreign),
        });
    }

    /// An error frame: its identifier holds classes, its second byte what the controller is like.
    ///
    /// `linux/can/error.h`.
    fn tell_trouble(&self, sink: &mut dyn FnMut(Received)) {
        const CONTROLLER: u32 = 0x004;
        const BUS_OFF: u32 = 0x040;
        const RESTARTED: u32 = 0x100;
        const OVERFLOW: u8 = 0x03;
        const PASSIVE: u8 = 0x30;
        const WARNING: u8 = 0x0C;
        const ACTIVE: u8 = 0x40;
        let mut tell = |trouble| sink(Received::ControllerEvent(trouble));
        if self.id & BUS_OFF != 0 {
            tell(ControllerEvent::BusOff);
        }
        if self.id & RESTARTED != 0 {
            tell(ControllerEvent::Restarted);
        }
        if self.id & CONTROLLER != 0 {
            let state = self.data[1];
            if state & PASSIVE != 0 {
                tell(ControllerEvent::ErrorPassive);
            }
            // It becomes less than passive step by step.
            let recovers = state & (WARNING | ACTIVE) != 0 && state & PASSIVE == 0;
            if recovers {
                tell(ControllerEvent::ErrorActive);
            }
            if state & OVERFLOW != 0 {
                tell(ControllerEvent::Lost(1));
            }
        }
    }
}

impl<C: Clock> Bus for SocketBus<C> {
    fn now(&self) -> TimeNs {
        self.clock.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        let line = self.lines.get_mut(usize::from(line));
        line.map_or(0, |line| line.send(frames))
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        if let Some(line) = self.lines.get_mut(usize::from(line)) {
            line.receive(sink);
        }
    }

    fn flush(&mut self, _line: u8) {}

    fn wait(&mut self, until: TimeNs) {
        self.clock.wait(until);
    }
}

#[cfg(test)]
mod tests;
