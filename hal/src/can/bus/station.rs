//! Emulated drives on a real bus.

use super::motor::Motor;
use super::network::Network;
use crate::TimeNs;
use crate::can::Frame;
use crate::can::master::{Bus, Received};

/// A network of drives whose master is somewhere outside, on `B`.
///
/// A frame from outside takes the time of its bits on the emulated wire, against the drives' own frames, before the drives
/// hear it; what a drive says leaves when its last bit is sent there. So a plan that is too much for the bit rate fails
/// here although the real bus between the processes, a virtual one perhaps, has no bit rate at all.
#[derive(Debug)]
pub struct Station<M, B> {
    network: Network<M>,
    bus: B,
    lines: u8,
    frames: Vec<Frame>,
    lost: u64,
}

impl<M: Motor, B: Bus> Station<M, B> {
    /// `network` with `lines` buses, seen from outside on the lines of `bus`.
    #[must_use]
    pub fn new(network: Network<M>, bus: B, lines: u8) -> Self {
        Self {
            network,
            bus,
            lines,
            frames: Vec::new(),
            lost: 0,
        }
    }

    /// Takes what has come, lets the drives live until now, and sends what they have said. Call it a few times in a
    /// cycle of the master; gives the time.
    pub fn turn(&mut self) -> TimeNs {
        let now = self.bus.now();
        self.take();
        self.network.advance(now);
        self.give();
        now
    }

    /// The same for drives that have a time of their own, which is `until` at the end, and a world that moves with them:
    /// `act` is called at every whole multiple of `step_ns` that passes, when the drives have lived until then.
    pub fn turn_until(
        &mut self,
        until: TimeNs,
        step_ns: u64,
        act: &mut dyn FnMut(TimeNs, &mut Network<M>),
    ) {
        self.take();
        let mut step = self.network.now().0 / step_ns.max(1) + 1;
        while step.saturating_mul(step_ns) <= until.0 {
            let at = TimeNs(step * step_ns);
            self.network.advance(at);
            act(at, &mut self.network);
            step += 1;
        }
        self.network.advance(until);
        self.give();
    }

    fn take(&mut self) {
        for line in 0..self.lines {
            let frames = &mut self.frames;
            frames.clear();
            self.bus.receive(line, &mut |received| {
                if let Received::Frame(frame) = received {
                    frames.push(frame);
                }
            });
            let taken = self.network.send(line, &self.frames);
            self.count_lost(taken);
        }
    }

    fn give(&mut self) {
        for line in 0..self.lines {
            let frames = &mut self.frames;
            frames.clear();
            self.network.receive(line, &mut |received| {
                if let Received::Frame(frame) = received {
                    frames.push(frame);
                }
            });
            let taken = self.bus.send(line, &self.frames);
            self.count_lost(taken);
        }
    }

    fn count_lost(&mut self, taken: usize) {
        let left = self.frames.len() - taken;
        self.lost += u64::try_from(left).unwrap_or(u64::MAX);
    }

    /// Frames that found no room, inside or outside.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// The drives.
    pub const fn network_mut(&mut self) -> &mut Network<M> {
        &mut self.network
    }

    /// The real bus.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus
    }
}
