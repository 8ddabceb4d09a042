//! Emulated drives on a real bus.

use super::motor::Motor;
use super::network::Network;
use hal::TimeNs;
use trocar_canopen::Frame;
use trocar_canopen::master::{Bus, Received};

/// A network of drives whose master is somewhere outside, on `B`.
///
/// A frame from outside takes the time of its bits on the emulated wire, against the drives' own
/// frames, before the drives hear it; what a drive says leaves when its last bit is sent there. So
/// a plan that is too much for the bit rate fails here although the real bus between the processes,
/// a virtual one perhaps, has no bit rate at all.
#[derive(Debug)]
pub struct Station<M, B> {
    network: Network<M>,
    bus: B,
    lines: u8,
    frames: Vec<Frame>,
    /// See [`Self::lost`].
    lost: u64,
}

impl<M: Motor, B: Bus> Station<M, B> {
    /// `network` with `lines` buses, seen from outside on the lines of `bus`.
    ///
    /// The outer bus takes the place of the network's first master.
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

    /// Takes what has come, lets the drives live until now, and sends what they have said. Call it
    /// a few times in a cycle of the master; gives the time.
    pub fn turn(&mut self) -> TimeNs {
        let now = self.bus.now();
        self.take();
        self.network.advance(now);
        self.give();
        now
    }

    /// The same for drives that have a time of their own and a world that moves with them. They
    /// live until `until`; `act` is called at every whole multiple of `step_ns` that passes, when
    /// they have lived until then. What has come is put on the wire at `until`.
    pub fn turn_until(
        &mut self,
        until: TimeNs,
        step_ns: u64,
        act: &mut dyn FnMut(TimeNs, &mut Network<M>),
    ) {
        let mut step = self.network.now().0 / step_ns.max(1) + 1;
        while step.saturating_mul(step_ns) <= until.0 {
            let at = TimeNs(step * step_ns);
            self.network.advance(at);
            act(at, &mut self.network);
            step += 1;
        }
        self.network.advance(until);
        self.give();
        self.take();
    }

    /// From the outer bus to the drives.
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

    /// From the drives to the outer bus.
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

    /// Of `self.frames`, of which the first `taken` found room.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Terminal;
    use crate::node::{AxisConfig, Feedback, Node};
    use trocar_canopen::{CanId, NodeId, Payload};

    /// A bus outside: what is to come, and what was said.
    #[derive(Debug, Default)]
    struct Outside {
        coming: Vec<Frame>,
        said: Vec<Frame>,
    }

    impl Bus for Outside {
        fn now(&self) -> TimeNs {
            TimeNs(0)
        }

        fn send(&mut self, _line: u8, frames: &[Frame]) -> usize {
            self.said.extend_from_slice(frames);
            frames.len()
        }

        fn receive(&mut self, _line: u8, sink: &mut dyn FnMut(Received)) {
            self.coming.drain(..).map(Received::Frame).for_each(sink);
        }

        fn flush(&mut self, _line: u8) {}

        fn wait(&mut self, _until: TimeNs) {}
    }

    fn station() -> Station<Terminal, Outside> {
        let mut network = Network::new(1, 1_000_000, 8);
        let node = Node::new(NodeId::new(5).unwrap(), &AxisConfig::default());
        let feedback = Feedback {
            position_counts: 42.0,
            ..Feedback::default()
        };
        network.add(0, node, Terminal::new(feedback));
        Station::new(network, Outside::default(), 1)
    }

    /// A world moves with its drives at every whole step and never twice.
    #[test]
    fn world_steps_once_with_its_drives() {
        let mut station = station();
        let mut steps = Vec::new();
        for until_us in [300, 1000, 1000, 1700, 4100] {
            let until = TimeNs(until_us * 1000);
            station.turn_until(until, 1_000_000, &mut |at, network| {
                assert_eq!(network.now(), at);
                steps.push(at.0 / 1_000_000);
            });
            assert_eq!(station.network_mut().now(), until);
        }
        assert_eq!(steps, [1, 2, 3, 4]);
    }

    /// A drive is where its terminal says and its demand waits there.
    #[test]
    fn drive_reads_feedback_and_leaves_its_demand() {
        let mut station = station();
        let node = NodeId::new(5).unwrap();
        let motor = station.network_mut().motor(node).unwrap();
        motor.feedback.position_counts = 77.0;
        // Reads 6064h.
        let request = Payload::new(&[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]).unwrap();
        let request = Frame::new(CanId::new(0x605).unwrap(), request);
        station.turn_until(TimeNs(1_000_000), 1_000_000, &mut |_, _| {});
        station.bus_mut().coming.push(request);
        station.turn_until(TimeNs(2_000_000), 1_000_000, &mut |_, _| {});
        let network = station.network_mut();
        assert!(network.has_pending_frames() && network.silent_at().is_none());
        // The request takes 123 us or so; then the answer has its place on the wire.
        network.advance(TimeNs(2_140_000));
        let network = station.network_mut();
        let silent_at = network.silent_at().unwrap();
        assert!(!network.has_pending_frames() && silent_at > network.now());
        station.turn_until(silent_at, 1_000_000, &mut |_, _| {});
        let answer = station.bus_mut().said.last().copied().unwrap();
        assert_eq!(answer.data()[4..], [77, 0, 0, 0]);
        let motor = station.network_mut().motor(node).unwrap();
        assert!(!motor.demand.torque && (motor.demand.position_counts - 77.0).abs() < 1e-9);
    }
}
