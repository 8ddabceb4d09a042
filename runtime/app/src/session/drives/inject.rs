//! Faults that are injected into emulated drives on purpose, as the command line names them.
//!
//! Two ways: a frame of the drive is changed on its way to the wire ([`FrameFault`]), or the drive,
//! its motor or the process around it is changed ([`Injector::turn`]). Times are the drives', so
//! that a fault hits the same tick of an episode on any machine.

mod parse;

use core::fmt;
use std::cell::RefCell;
use std::rc::Rc;

use trocar_canopen::cia301::Cob;
use trocar_canopen::cia301::emcy::{ErrorCode, register};
use trocar_canopen::{Frame, NodeId, Payload};
use trocar_drives::{Network, Tampering, Terminal};

pub use parse::BadFault;

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// The node loses its power and its place on the bus. It boots up when the fault is over; its
    /// motor keeps its place.
    Pull,
    /// The node is reset and boots up.
    Reboot,
    /// The drive fails by itself with this code.
    Emergency(ErrorCode),
    /// The motor turns nothing any more: its axis is limp, the drive thinks otherwise. Encoder and
    /// drive stay as they are, and the following error grows if something else turns the axis.
    Slack,
    /// The node's answers to SYNC get lost. Transmit PDOs alone: heartbeats and SDO answers still
    /// come.
    Silence,
    /// The node's answers come a cycle and a half late. Later than the next SYNC, so that the
    /// master misses one cycle and has the answer in the wrong one.
    Late,
    /// The node's answers are a byte too short.
    Short,
    /// The node's answers make no sense. Eight bytes FFh in each transmit PDO.
    Garbage,
    /// The node's heartbeats get lost. Its PDOs still come; the master's heartbeat consumer has to
    /// notice.
    NoHeartbeat,
    /// The node says that it is another make, from the start. Its product code (1018h:02) is one
    /// too high at boot; `at` and `for` do not matter.
    WrongIdentity,
    /// The controllers of all others on the bus count too many errors and leave it. Reported once,
    /// as an error frame to every socket that asks for them; nothing ends it.
    BusOff,
    /// Another node sends SYNC on the bus. One frame, so a fault that lasts is several faults.
    ForeignMaster,
}

/// A fault with its place and time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InjectedFault {
    /// What.
    pub kind: FaultKind,
    /// The drive; of a fault of a bus, one that is on it.
    pub node: NodeId,
    /// When: after all drives were first enabled, ns.
    pub at_ns: u64,
    /// How long, ns; for good if not given.
    pub for_ns: Option<u64>,
    /// As it was typed.
    ///
    /// For [`fmt::Display`] alone; two faults that are typed differently are not equal.
    text: String,
}

impl fmt::Display for InjectedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// An active fault of frames of `node`.
///
/// Several may be active; the first that applies to a frame decides.
#[derive(Clone, Copy, Debug)]
struct FrameFault {
    kind: FaultKind,
    node: NodeId,
    /// Of [`FaultKind::Late`]: one and a half cycles.
    delay_ns: u64,
}

impl FrameFault {
    /// None if this frame passes as it is. Only transmit PDOs and heartbeats of the node are
    /// touched.
    fn of(&self, frame: &Frame) -> Option<Tampering> {
        let answer = matches!(Cob::of(frame.id), Cob::TransmitPdo(_, node) if node == self.node);
        let beat = matches!(Cob::of(frame.id), Cob::Heartbeat(node) if node == self.node);
        let replaced =
            |data: &[u8]| Tampering::Replace(Frame::new(frame.id, Payload::truncated(data)));
        match (self.kind, answer, beat) {
            (FaultKind::Silence, true, _) | (FaultKind::NoHeartbeat, _, true) => {
                Some(Tampering::Drop)
            }
            (FaultKind::Late, true, _) => Some(Tampering::Delay(self.delay_ns)),
            (FaultKind::Short, true, _) => {
                let length = frame.data().len().saturating_sub(1);
                Some(replaced(&frame.data()[..length]))
            }
            (FaultKind::Garbage, true, _) => Some(replaced(&[0xFF; 8])),
            _ => None,
        }
    }
}

/// What a fault needs of the process around the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outside {
    /// The axis of this node is limp, or not any more.
    Slack(NodeId, bool),
    /// The bus that this node is on reports that the controllers of all its nodes are off.
    BusOff(NodeId),
    /// Another node sends the SYNC of the arm that this node belongs to.
    ForeignMaster(NodeId),
}

impl InjectedFault {
    /// `since_ns` counts from the moment all drives were first enabled. False for ever without
    /// `for_ns`.
    fn is_over(&self, since_ns: u64) -> bool {
        let end_ns = self.for_ns.map(|for_ns| self.at_ns + for_ns);
        end_ns.is_some_and(|end_ns| since_ns >= end_ns)
    }
}

/// A fault goes through these in order and begins once; one without an end stays `Active`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// `at_ns` has not come.
    Waiting,
    /// It has begun, and its end, if it has one, has not come.
    Active,
    /// What can be undone was undone.
    Over,
}

/// The faults of a run, and what is left of them.
pub(super) struct Injector {
    /// In the order of the command line, which is the place that [`Injector::turn`] gives.
    faults: Vec<(InjectedFault, Stage)>,
    /// Shared with the closure that the network calls for each frame; never borrowed across a call
    /// into the network.
    frame_faults: Rc<RefCell<Vec<FrameFault>>>,
    /// Of the first arm; [`FaultKind::Late`] delays by one and a half of it.
    cycle_ns: u64,
}

impl Injector {
    /// Prepares `faults` on `network`, whose drives get a set-point every `cycle_ns`.
    pub(super) fn new(
        faults: &[InjectedFault],
        cycle_ns: u64,
        network: &mut Network<Terminal>,
    ) -> Self {
        let frame_faults = Rc::new(RefCell::new(Vec::<FrameFault>::new()));
        if !faults.is_empty() {
            let active = Rc::clone(&frame_faults);
            network.tamper(Box::new(move |_, _, frame| {
                let active = active.borrow();
                let what = active.iter().find_map(|fault| fault.of(frame));
                what.unwrap_or(Tampering::Pass)
            }));
        }
        let waiting = faults.iter().map(|fault| (fault.clone(), Stage::Waiting));
        Self {
            faults: waiting.collect(),
            frame_faults,
            cycle_ns,
        }
    }

    /// Begins and ends what is due so long after the drives were enabled; `outside` does what is
    /// not the drives', and `begun` is told the place of each fault that begins.
    pub(super) fn turn(
        &mut self,
        since_ns: u64,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
        begun: &mut dyn FnMut(usize),
    ) {
        for place in 0..self.faults.len() {
            let (fault, stage) = &mut self.faults[place];
            let fault = fault.clone();
            match stage {
                Stage::Waiting if since_ns >= fault.at_ns => {
                    *stage = Stage::Active;
                    self.begin(&fault, network, outside);
                    begun(place);
                }
                Stage::Active if fault.is_over(since_ns) => {
                    *stage = Stage::Over;
                    if !self.has_active(&fault) {
                        self.end(&fault, network, outside);
                    }
                }
                Stage::Waiting | Stage::Active | Stage::Over => {}
            }
        }
    }

    /// Whether a fault of the same kind and node is active: where two overlap, only the end of the
    /// last one undoes them.
    fn has_active(&self, fault: &InjectedFault) -> bool {
        self.faults.iter().any(|(other, stage)| {
            *stage == Stage::Active && (other.kind, other.node) == (fault.kind, fault.node)
        })
    }

    /// What has an effect at once has it here; the rest is put among `frame_faults`.
    fn begin(
        &self,
        fault: &InjectedFault,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
    ) {
        let node = fault.node;
        match fault.kind {
            FaultKind::Pull => {
                network.power(node, false);
                if let Some(motor) = network.motor(node) {
                    *motor = Terminal::new(motor.feedback);
                }
            }
            FaultKind::Reboot => {
                network.poke(node, |now, node, out| node.power_on(now, out));
            }
            FaultKind::Emergency(code) => network.poke(node, |now, node, out| {
                node.fail(now, code, register_of(code), out);
            }),
            FaultKind::Slack => outside(Outside::Slack(node, true), network),
            FaultKind::BusOff => outside(Outside::BusOff(node), network),
            FaultKind::ForeignMaster => outside(Outside::ForeignMaster(node), network),
            FaultKind::Silence
            | FaultKind::Late
            | FaultKind::Short
            | FaultKind::Garbage
            | FaultKind::NoHeartbeat => self.frame_faults.borrow_mut().push(FrameFault {
                kind: fault.kind,
                node,
                delay_ns: self.cycle_ns * 3 / 2,
            }),
            // It was so from the start.
            FaultKind::WrongIdentity => {}
        }
    }

    /// Undoes power, slack and faults of frames. A reset, an emergency, a bus-off and a foreign
    /// SYNC are events: there is nothing to undo.
    fn end(
        &self,
        fault: &InjectedFault,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
    ) {
        let node = fault.node;
        match fault.kind {
            FaultKind::Pull => network.power(node, true),
            FaultKind::Slack => outside(Outside::Slack(node, false), network),
            FaultKind::Silence
            | FaultKind::Late
            | FaultKind::Short
            | FaultKind::Garbage
            | FaultKind::NoHeartbeat => self
                .frame_faults
                .borrow_mut()
                .retain(|active| (active.kind, active.node) != (fault.kind, node)),
            FaultKind::Reboot
            | FaultKind::Emergency(_)
            | FaultKind::BusOff
            | FaultKind::ForeignMaster
            | FaultKind::WrongIdentity => {}
        }
    }
}

/// The bit of 1001h that goes with a drive's own error.
///
/// Error codes of CiA 301 have their class in the first digit: 2xxxh is current, 3xxxh voltage,
/// 4xxxh temperature, 81xxh communication, the rest of 8xxxh monitoring, which sets the device
/// profile's bit. The generic bit alone stands for all others.
const fn register_of(code: ErrorCode) -> u8 {
    match (code.0 >> 12, code.0 >> 8) {
        (0x2, _) => register::CURRENT,
        (0x3, _) => register::VOLTAGE,
        (0x4, _) => register::TEMPERATURE,
        (_, 0x81) => register::COMMUNICATION,
        (0x8, _) => register::PROFILE,
        _ => register::GENERIC,
    }
}
