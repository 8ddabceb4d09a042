//! Buses with emulated drives and a master, in virtual time.
//!
//! Virtual time moves only in `advance`: on each bus frames arrive in the order of their last bits,
//! and every 0.5 ms each drive reads its motor and looks at its clock. The same calls give the same
//! frames, whatever the host does.

mod passage;
mod seat;

use super::motor::Motor;
use super::wire::{Delivery, Order, Wire};
use crate::node::{Demand, Node};
use hal::TimeNs;
use trocar_canopen::master::{ControllerEvent, Received};
use trocar_canopen::{Frame, NodeId, Outbox};

use seat::Seat;

/// How often a drive looks at its clock and its motor, ns.
pub const NODE_STEP_NS: u64 = 500_000;

/// Frames that a drive's controller holds.
///
/// What does not fit is lost, as in a real controller.
const NODE_QUEUE: usize = 64;
/// Frames of strangers that wait for a bus; what comes beyond that is lost.
const STRANGER_QUEUE: usize = 256;

/// What becomes of a frame on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tampering {
    /// Nothing.
    Pass,
    /// No node receives it.
    Drop,
    /// Everybody gets another one.
    Replace(Frame),
    /// Everybody gets it twice.
    Repeat,
    /// Everybody gets it this much later, ns.
    Delay(u64),
}

/// Decides about every frame: line, time, frame.
///
/// Called once a frame, when its last bit has passed; frames that it delays or repeats do not come
/// by again.
pub type Tamper = Box<dyn FnMut(u8, TimeNs, &Frame) -> Tampering>;

/// A drive on a bus: its node, and the motor that it turns.
struct Drive<M> {
    /// Index of its bus.
    line: usize,
    /// Its controller on that bus.
    port: usize,
    node: Node,
    motor: M,
    /// Without power it neither hears nor acts, and its motor is not stepped.
    powered: bool,
}

/// A bus with the masters on it.
struct Line {
    wire: Wire,
    masters: Vec<Seat>,
    /// Whose frames no node here receives.
    stranger: usize,
    /// Frames that [`Tampering::Delay`] holds back, with the time at which they arrive.
    delayed: Vec<(TimeNs, Delivery)>,
}

impl<M> core::fmt::Debug for Network<M> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Network")
            .field("now", &self.now)
            .field("lines", &self.lines.len())
            .field("drives", &self.drives.len())
            .finish_non_exhaustive()
    }
}

/// Up to three buses, their drives, and the ends of each that masters have.
///
/// There is one master, for whom this is a [`Bus`](trocar_canopen::master::Bus); others can be
/// added. They receive each other's frames, as on any bus.
///
/// At construction the master is number 0 and the time 0.
pub struct Network<M> {
    /// Of the event at hand; frames that are sent are queued at this time.
    now: TimeNs,
    /// A whole multiple of [`NODE_STEP_NS`].
    next_step: TimeNs,
    lines: Vec<Line>,
    drives: Vec<Drive<M>>,
    tamper: Option<Tamper>,
    out: Outbox,
}

impl<M: Motor> Network<M> {
    /// `lines` buses at `bit_rate`, without drives; the master's queues hold `master_queue` frames
    /// each.
    #[must_use]
    pub fn new(lines: u8, bit_rate: u32, master_queue: usize) -> Self {
        let lines = (0..lines)
            .map(|_| {
                let mut wire = Wire::new(bit_rate);
                let stranger = wire.attach(Order::Priority, STRANGER_QUEUE);
                Line {
                    wire,
                    masters: Vec::new(),
                    stranger,
                    delayed: Vec::new(),
                }
            })
            .collect();
        let mut network = Self {
            now: TimeNs(0),
            next_step: TimeNs(0),
            lines,
            drives: Vec::new(),
            tamper: None,
            out: Outbox::default(),
        };
        network.add_master(master_queue);
        network
    }

    /// Puts a drive on `line` and switches it on.
    ///
    /// Its boot-up message is queued at once.
    ///
    /// # Panics
    /// If there is no such bus.
    pub fn add(&mut self, line: u8, node: Node, motor: M) {
        let line = usize::from(line);
        let port = self.lines[line].wire.attach(Order::Priority, NODE_QUEUE);
        self.drives.push(Drive {
            line,
            port,
            node,
            motor,
            powered: true,
        });
        let place = self.drives.len() - 1;
        self.with(place, |now, drive, out| {
            let off = Demand {
                torque: false,
                position_counts: 0.0,
                velocity_counts_s: 0.0,
                torque_per_mille_max: 0.0,
            };
            drive.node.feedback(drive.motor.step(0, &off));
            drive.node.power_on(now, out);
        });
    }

    /// Decides from now on what becomes of every frame.
    pub fn tamper(&mut self, tamper: Tamper) {
        self.tamper = Some(tamper);
    }

    /// Frames arrive as they are again.
    pub fn leave_alone(&mut self) {
        self.tamper = None;
    }

    /// The drive with the number `id`.
    #[must_use]
    pub fn node(&self, id: NodeId) -> Option<&Node> {
        let drive = self.drives.iter().find(|drive| drive.node.id() == id)?;
        Some(&drive.node)
    }

    /// The bus that it is on.
    #[must_use]
    pub fn line_of(&self, id: NodeId) -> Option<u8> {
        let drive = self.drives.iter().find(|drive| drive.node.id() == id)?;
        u8::try_from(drive.line).ok()
    }

    /// Whether it has power.
    #[must_use]
    pub fn is_powered(&self, id: NodeId) -> bool {
        let drive = self.drives.iter().find(|drive| drive.node.id() == id);
        drive.is_some_and(|drive| drive.powered)
    }

    /// Its motor.
    pub fn motor(&mut self, id: NodeId) -> Option<&mut M> {
        let drive = self.drives.iter_mut().find(|drive| drive.node.id() == id)?;
        Some(&mut drive.motor)
    }

    /// Does something to the drive `id` itself, which may answer on its bus.
    pub fn poke(&mut self, id: NodeId, act: impl FnOnce(TimeNs, &mut Node, &mut Outbox)) {
        if let Some(place) = self.drives.iter().position(|drive| drive.node.id() == id) {
            self.with(place, |now, drive, out| act(now, &mut drive.node, out));
        }
    }

    /// Takes the drive `id` off its bus and off its power, or puts it back.
    pub fn power(&mut self, id: NodeId, powered: bool) {
        let Some(place) = self.drives.iter().position(|drive| drive.node.id() == id) else {
            return;
        };
        let drive = &mut self.drives[place];
        drive.powered = powered;
        self.lines[drive.line]
            .wire
            .set_attached(drive.port, powered);
        if powered {
            self.with(place, |now, drive, out| drive.node.power_on(now, out));
        }
    }

    /// The first master's controller on `line` goes bus-off, or comes back.
    pub fn bus_off(&mut self, line: u8, off: bool) {
        let line = &mut self.lines[usize::from(line)];
        let Some(master) = line.masters.first_mut() else {
            return;
        };
        line.wire.set_attached(master.port, !off);
        let trouble = if off {
            ControllerEvent::BusOff
        } else {
            ControllerEvent::Restarted
        };
        master.inbox.push(Received::ControllerEvent(trouble));
    }

    /// Reports `trouble` on `line` to the first master.
    pub fn trouble(&mut self, line: u8, trouble: ControllerEvent) {
        if let Some(master) = self.lines[usize::from(line)].masters.first_mut() {
            master.inbox.push(Received::ControllerEvent(trouble));
        }
    }

    /// A node that is neither a drive nor a master of ours sends `frame` on `line`; tells whether
    /// it found room.
    pub fn intrude(&mut self, line: u8, frame: Frame) -> bool {
        let now = self.now;
        let line = &mut self.lines[usize::from(line)];
        line.wire.send(now, line.stranger, frame).is_ok()
    }

    /// The bus `line`.
    #[must_use]
    pub fn wire(&self, line: u8) -> &Wire {
        &self.lines[usize::from(line)].wire
    }

    /// Lets a drive act, and queues what it says.
    fn with(&mut self, place: usize, act: impl FnOnce(TimeNs, &mut Drive<M>, &mut Outbox)) {
        let drive = &mut self.drives[place];
        if !drive.powered {
            return;
        }
        self.out.clear();
        act(self.now, drive, &mut self.out);
        for frame in self.out.frames() {
            // A drive whose queue is full loses the frame, as a real one would.
            let wire = &mut self.lines[drive.line].wire;
            let _ = wire.send(self.now, drive.port, *frame);
        }
    }
}
