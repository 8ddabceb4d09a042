//! A single drive: enabled, then alone with frames and time.

use core::fmt;

use hal::TimeNs;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use trocar_canopen::Outbox;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia402::{Command, ControlView, PowerState};
use trocar_canopen::index;
use trocar_canopen::{Frame, NodeId};
use trocar_drives::node::{AxisConfig, Demand, Feedback, Node};

use crate::frames::{CONTROLS, anything, frame, mostly, payload};
use crate::memory;

/// Most steps of a life, of which a few are whole ways up.
const STEPS_MAX: usize = 500;
/// Frames that one frame and the time after it may be answered with, at most.
const ANSWERS_MAX: usize = 16;
/// The drive.
const NODE: u8 = 5;

/// Identifiers that mean something to it, so that more than one frame in 2048 is heard.
const HEARD: [u16; 7] = [0x305, 0x405, 0x505, 0x605, 0x701, 0x705, 0x205];

/// Objects that change most.
const TOUCHED: [u16; 24] = [
    0x1005, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019, 0x1029, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6007,
    0x6040, 0x605A, 0x6060, 0x607A, 0x607C, 0x607D, 0x2000, 0x6065, 0x607F, 0x6080, 0x6085, 0x60C2,
];

/// One thing that happens to it.
#[derive(Clone)]
pub(crate) enum Act {
    /// It hears a frame.
    Frame(Frame),
    /// Its motor is stuck, or is not any more.
    Stuck(bool),
    /// Its power stage fails.
    Fail,
}

impl fmt::Debug for Act {
    /// A frame as candump writes it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame(frame) => write!(f, "{frame}"),
            Self::Stuck(stuck) => write!(f, "Stuck({stuck})"),
            Self::Fail => write!(f, "Fail"),
        }
    }
}

/// Something, and the time that passes after it, ns.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    act: Act,
    then_ns: u64,
}

/// What came of many lives.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    pub(crate) thrown: u64,
    pub(crate) lives: u64,
    pub(crate) enabled: u64,
    pub(crate) faults: u64,
    pub(crate) travelled: f64,
    /// Most bytes that a life held, and those of one in which nothing happens.
    pub(crate) bytes_max: i64,
    pub(crate) bytes_quiet: i64,
}

/// What a master would say, most of the time, so that the axis moves.
pub(crate) fn story() -> impl Strategy<Value = Vec<Step>> {
    let sync = Just(frame(0x080, &[]));
    // Often within the range, sometimes anywhere.
    let target = prop_oneof![3 => 0..0x4000_i32, 1 => any::<i32>()];
    let set_point = target.prop_map(|target| {
        let [a, b, c, d] = target.to_le_bytes();
        frame(0x205, &[0x0F, 0, a, b, c, d])
    });
    let frames = prop_oneof![60 => sync, 60 => set_point, 30 => nonsense(), 10 => anything()];
    let act = prop_oneof![
        160 => frames.prop_map(Act::Frame),
        1 => any::<bool>().prop_map(Act::Stuck),
        1 => Just(Act::Fail),
    ];
    let then_ns = || prop_oneof![400 => 0..1_000_000_u64, 1 => 0..20_000_000_000_u64];
    let step = (act, then_ns()).prop_map(|(act, then_ns)| vec![Step { act, then_ns }]);
    let up = then_ns().prop_map(|then_ns| {
        let step = |heard| Step {
            act: Act::Frame(heard),
            then_ns,
        };
        up().map(step).collect()
    });
    vec(prop_oneof![40 => step, 1 => up], 0..=STEPS_MAX).prop_map(|steps| steps.concat())
}

/// A whole way to enabled: a reset of faults, then each word, with a SYNC after each.
fn up() -> impl Iterator<Item = Frame> {
    [0x80, 0x06, 0x07, 0x0F].into_iter().flat_map(|control| {
        let word = frame(0x205, &[control, 0, 0, 0, 0, 0]);
        [word, frame(0x080, &[])]
    })
}

fn nonsense() -> impl Strategy<Value = Frame> {
    let nmt = (
        select(&[0x01, 0x01, 0x01, 0x02, 0x80, 0x81, 0x82][..]),
        select(&[0, NODE, NODE, 9][..]),
    );
    let nmt = nmt.prop_map(|(command, node)| frame(0x000, &[command, node]));
    let control = (select(&CONTROLS[..]), any::<u32>());
    let control = control.prop_map(|(control, target)| {
        let [a, b, c, d] = target.to_le_bytes();
        frame(0x205, &[control, 0, a, b, c, d])
    });
    let transfer = (
        select(&[0x40, 0x2F, 0x2B, 0x23, 0x60, 0x70, 0x21][..]),
        select(&TOUCHED[..]),
        select(&[0, 0, 1, 2, 3][..]),
        mostly(&[0, 1, 6, 8, 0x0F]),
        any::<[u8; 3]>(),
    );
    let transfer = transfer.prop_map(|(command, object, sub, first, [a, b, c])| {
        let [low, high] = object.to_le_bytes();
        frame(0x605, &[command, low, high, sub, first, a, b, c])
    });
    let heard = (select(&HEARD[..]), payload());
    let heard = heard.prop_map(|(id, payload)| frame(id, payload.as_slice()));
    let sync = payload().prop_map(|payload| frame(0x080, payload.as_slice()));
    prop_oneof![3 => transfer, 3 => heard, 1 => control, 1 => nmt, 1 => sync]
}

/// The drive with its motor.
struct Bench {
    node: Node,
    out: Outbox,
    now: TimeNs,
    position: f64,
    stuck: bool,
}

/// What the drive is like.
fn config() -> AxisConfig {
    AxisConfig {
        // Near enough to be met.
        range: (-20_000, 30_000),
        following_window: 20_000,
        ..AxisConfig::default()
    }
}

impl Bench {
    /// Operational, mapped as the data sheet's example, and enabled.
    fn enabled() -> Self {
        let id = NodeId::new(NODE).unwrap();
        let mut bench = Self {
            node: Node::new(id, &config()),
            out: Outbox::default(),
            now: TimeNs(0),
            position: 0.0,
            stuck: false,
        };
        bench.node.power_on(TimeNs(0), &mut bench.out);
        for (index, sub, length, value) in [
            (0x1400_u16, 2, 1, 1_u32),
            (0x1600, 0, 1, 0),
            (0x1600, 1, 4, 0x6040_0010),
            (0x1600, 2, 4, 0x607A_0020),
            (0x1600, 0, 1, 2),
            (0x1400, 1, 4, 0x205),
            (0x6060, 0, 1, 8),
        ] {
            let command = 0x23 | (4 - length) << 2;
            let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), value.to_le_bytes());
            bench.hear(0x605, &[command, low, high, sub, a, b, c, d]);
        }
        bench.hear(0x000, &[0x01, 0]);
        for heard in up() {
            bench.hear(heard.id.raw(), heard.data());
        }
        assert_eq!(bench.node.power_state(), PowerState::OperationEnabled);
        bench
    }

    fn hear(&mut self, id: u16, data: &[u8]) {
        self.node
            .on_frame(self.now, &frame(id, data), &mut self.out);
    }

    /// Something happens; gives how many frames the drive heard of it.
    fn act(&mut self, act: &Act) -> u64 {
        match act {
            Act::Frame(frame) => {
                self.node.on_frame(self.now, frame, &mut self.out);
                return 1;
            }
            Act::Stuck(stuck) => self.stuck = *stuck,
            // A short circuit: the generic and the current bit.
            Act::Fail => self
                .node
                .fail(self.now, ErrorCode(0x2320), 0x03, &mut self.out),
        }
        0
    }

    /// Time passes, and the motor answers to it.
    fn pass(&mut self, ns: u64) {
        self.now = self.now.plus_ns(ns);
        self.node.on_time(self.now, &mut self.out);
        let demand = self.node.demand(self.now);
        let follows = demand.torque && !self.stuck;
        if follows {
            self.position = demand.position_counts;
        }
        self.node.feedback(Feedback {
            position_counts: self.position,
            velocity_counts_s: if follows {
                demand.velocity_counts_s
            } else {
                0.0
            },
            torque_per_mille: 0.0,
        });
    }

    /// Bits 7 and 0 to 3 of the control word.
    fn control(&self) -> ControlView {
        ControlView(u16::try_from(self.node.dictionary().get(index::CONTROL)).unwrap())
    }

    /// Takes a step; tells what must not be.
    fn step(&mut self, step: &Step, tally: &mut Tally) -> Result<(), String> {
        let before = self.node.demand(self.now);
        let was = self.node.power_state();
        tally.thrown += self.act(&step.act);
        let told = self.node.power_state();
        self.pass(step.then_ns);
        let is = self.node.power_state();
        self.check_answers()?;
        self.check_motion(&before, step.then_ns, tally)?;
        // Nothing but a control word gives it torque; a fault is left by a control word or a reset,
        // and never by waiting.
        let gains = is.has_torque() && !was.has_torque();
        let asked = self.control().command() == Command::EnableOperation;
        must(!gains || asked, || {
            format!("it went from {was:?} to {is:?} by itself")
        })?;
        let resets = match step.act {
            Act::Frame(frame) => frame.id.raw() == 0 || self.control().fault_reset(),
            Act::Stuck(_) | Act::Fail => false,
        };
        let left = was == PowerState::Fault && told != PowerState::Fault && !resets;
        let waited = told == PowerState::Fault && is != PowerState::Fault;
        must(!left && !waited, || {
            format!("it left its fault for {is:?} by itself")
        })?;
        tally.faults += u64::from(is == PowerState::Fault && was != PowerState::Fault);
        tally.enabled += u64::from(is == PowerState::OperationEnabled);
        Ok(())
    }

    fn check_answers(&mut self) -> Result<(), String> {
        let said = self.out.frames().len();
        self.out.clear();
        must(said <= ANSWERS_MAX && self.out.lost() == 0, || {
            format!("{said} frames were said")
        })
    }

    /// It is sent to where it may be, and no faster than it may.
    fn check_motion(&self, before: &Demand, ns: u64, tally: &mut Tally) -> Result<(), String> {
        let demand = self.node.demand(self.now);
        let (low, high) = (f64::from(config().range.0), f64::from(config().range.1));
        let position = demand.position_counts;
        must((low..=high).contains(&position), || {
            format!("it is sent to {position}")
        })?;
        // Without torque the demand is wherever the motor is.
        if !demand.torque || !before.torque {
            return Ok(());
        }
        let way = (position - before.position_counts).abs();
        let reach = f64::from(config().speed_max) * TimeNs(ns).seconds();
        must(way <= reach + 1e-3, || {
            format!("it goes {way} where {reach} is as far as it can")
        })?;
        tally.travelled += way;
        Ok(())
    }
}

fn must(holds: bool, what: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(what()) }
}

/// One life; tells the first thing in it that must not be.
pub(crate) fn live(story: &[Step], tally: &mut Tally) -> Result<(), String> {
    memory::begin();
    let mut bench = Bench::enabled();
    tally.lives += 1;
    for (n, step) in story.iter().enumerate() {
        let told = bench.step(step, tally);
        told.map_err(|what| format!("at step {n}: {what}"))?;
    }
    let bytes = memory::most();
    tally.bytes_max = tally.bytes_max.max(bytes);
    if story.is_empty() {
        tally.bytes_quiet = tally.bytes_quiet.max(bytes);
    }
    let quiet = tally.bytes_quiet;
    must(bytes <= quiet + quiet / 4, || {
        format!("{bytes} bytes were held instead of {quiet}")
    })
}
