//! What befalls an arm: frames of strangers, and the trouble that a bus can make.

use core::fmt;

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use trocar_canopen::Frame;
use trocar_canopen::master::{ArmPlan, ControllerEvent};
use trocar_drives::Tampering;

use crate::frames::{Mood, anything};

/// Most bursts in a life and most acts in a burst.
const BURSTS_MAX: usize = 400;
const ACTS_MAX: usize = 6;

/// A whole story, which shrinks to a small one.
#[derive(Clone, Debug)]
pub(crate) struct Scenario {
    /// Which buses, and how full they are without strangers.
    pub(crate) buses: Buses,
    /// Whether it begins with the bring-up and not with an enabled arm.
    pub(crate) from_the_start: bool,
    /// Where in their ranges the axes are at first, and around what they are led, per mille.
    pub(crate) place: u16,
    /// How often the controller looks at the arm in a cycle, where it may.
    pub(crate) pace: u8,
    /// What happens.
    pub(crate) bursts: Vec<Burst>,
}

impl Scenario {
    /// One in which nothing happens.
    pub(crate) const fn quiet(buses: Buses) -> Self {
        Self {
            buses,
            from_the_start: false,
            place: 500,
            pace: 1,
            bursts: Vec::new(),
        }
    }
}

/// Which of three plans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Buses {
    /// Half of the bus is left to strangers.
    Roomy,
    /// 1 kHz on three buses.
    Three,
    /// As shipped: the bus is nearly full.
    Shipped,
}

/// Several things at one instant.
#[derive(Clone, Debug)]
pub(crate) struct Burst {
    /// Half milliseconds after the burst before.
    pub(crate) looks: u8,
    /// What happens then.
    pub(crate) acts: Vec<Act>,
}

/// One thing, on a bus where it happens on one; buses are counted round.
#[derive(Clone)]
pub(crate) enum Act {
    /// A stranger sends a frame.
    Frame(u8, Frame),
    /// The master's controller says something about itself, or hears what no CANopen device sends.
    ControllerEvent(u8, ControllerEvent),
    /// The master's controller goes off the bus, or comes back.
    BusOff(u8, bool),
    /// There is no room in the master's queue, so many times.
    NoRoom(u8, u8),
    /// So many frames are lost on their way to the master.
    Lose(u8, u8),
    /// What the wire does to the next frame.
    Spoil(Tampering),
    /// The drive of an axis loses its power, or gets it back.
    Power(u8, bool),
    /// The motor of an axis is stuck from now on. (One without inertia that came loose would leap.)
    Stuck(u8),
    /// The master's thread does not run for so many milliseconds.
    Stall(u16),
    /// The master's clock jumps by so many milliseconds.
    ClockJump(i32),
}

impl fmt::Debug for Act {
    /// A frame as candump writes it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame(line, frame) => write!(f, "Frame({line}, {frame})"),
            Self::ControllerEvent(line, trouble) => {
                write!(f, "ControllerEvent({line}, {trouble:?})")
            }
            Self::BusOff(line, off) => write!(f, "BusOff({line}, {off})"),
            Self::NoRoom(line, times) => write!(f, "NoRoom({line}, {times})"),
            Self::Lose(line, frames) => write!(f, "Lose({line}, {frames})"),
            Self::Spoil(Tampering::Replace(frame)) => write!(f, "Spoil(Replace({frame}))"),
            Self::Spoil(tampering) => write!(f, "Spoil({tampering:?})"),
            Self::Power(axis, on) => write!(f, "Power({axis}, {on})"),
            Self::Stuck(axis) => write!(f, "Stuck({axis})"),
            Self::Stall(ms) => write!(f, "Stall({ms})"),
            Self::ClockJump(ms) => write!(f, "ClockJump({ms})"),
        }
    }
}

impl Buses {
    /// The plan, from the shipped one.
    pub(crate) fn plan(self, shipped: &ArmPlan) -> ArmPlan {
        let mut plan = *shipped;
        match self {
            Self::Shipped => {}
            Self::Roomy => plan.cycle_ns *= 2,
            Self::Three => {
                plan.lines = 3;
                plan.cycle_ns /= 2;
                for (axis, line) in plan.axes.iter_mut().zip([0, 0, 0, 1, 1, 2, 2]) {
                    axis.line = line;
                }
            }
        }
        plan
    }

    /// Bursts come so many times slower: where the arm leaves strangers little of the bus they
    /// would own it.
    pub(crate) const fn slowness(self) -> u32 {
        match self {
            Self::Roomy => 1,
            Self::Three | Self::Shipped => 3,
        }
    }
}

/// What the bus and the machine do to the master and its drives.
fn trouble() -> BoxedStrategy<Act> {
    let line = || 0..3_u8;
    let told = select(
        &[
            ControllerEvent::Foreign,
            ControllerEvent::ErrorPassive,
            ControllerEvent::ErrorActive,
            ControllerEvent::Restarted,
            ControllerEvent::BusOff,
            ControllerEvent::Down,
        ][..],
    );
    let spoilt = prop_oneof![
        2 => Just(Tampering::Drop),
        2 => Just(Tampering::Repeat),
        2 => (0..20_000_000_u64).prop_map(Tampering::Delay),
        1 => anything().prop_map(Tampering::Replace),
    ];
    prop_oneof![
        8 => spoilt.prop_map(Act::Spoil),
        4 => (line(), 0..40_u8).prop_map(|(line, frames)| Act::Lose(line, frames)),
        4 => (line(), 0..60_u8).prop_map(|(line, times)| Act::NoRoom(line, times)),
        3 => (line(), told).prop_map(|(line, trouble)| Act::ControllerEvent(line, trouble)),
        3 => prop_oneof![4 => 0..30_u16, 1 => 0..300_u16].prop_map(Act::Stall),
        3 => prop_oneof![2 => 0..30, 2 => -30..0, 1 => 0..10_000].prop_map(Act::ClockJump),
        2 => (line(), any::<bool>()).prop_map(|(line, off)| Act::BusOff(line, off)),
        1 => (0..7_u8, any::<bool>()).prop_map(|(axis, on)| Act::Power(axis, on)),
        1 => (0..7_u8).prop_map(Act::Stuck),
    ]
    .boxed()
}

/// Lives among frames of `mood`, of which so many in 400 things that happen are trouble.
fn among(mood: Mood, troubles: u32, from_the_start: bool) -> BoxedStrategy<Scenario> {
    let line = 0..3_u8;
    let frame = (line, mood.frames()).prop_map(|(line, frame)| Act::Frame(line, frame));
    let act = match troubles {
        0 => frame.boxed(),
        _ => prop_oneof![400 - troubles => frame, troubles => trouble()].boxed(),
    };
    let burst = (0..4_u8, vec(act, 0..=ACTS_MAX));
    let burst = burst.prop_map(|(looks, acts)| Burst { looks, acts });
    let buses =
        prop_oneof![4 => Just(Buses::Roomy), 2 => Just(Buses::Three), 1 => Just(Buses::Shipped)];
    // Often at an end.
    let place = prop_oneof![2 => Just(500), 2 => 0..=1000_u16, 1 => Just(0), 1 => Just(1000)];
    let pace = select(&[1, 1, 1, 2, 4][..]);
    (buses, place, pace, vec(burst, 0..=BURSTS_MAX))
        .prop_map(move |(buses, place, pace, bursts)| Scenario {
            buses,
            from_the_start,
            place,
            pace,
            bursts,
        })
        .boxed()
}

/// Lives of all kinds.
pub(crate) fn life() -> impl Strategy<Value = Scenario> {
    prop_oneof![
        6 => among(Mood::Bystander, 0, false),
        4 => among(Mood::Bystander, 2, false),
        3 => among(Mood::Drives, 0, false),
        2 => among(Mood::Meaning, 0, false),
        2 => among(Mood::Bystander, 40, false),
        2 => among(Mood::Bystander, 4, true),
        1 => among(Mood::Meaning, 4, true),
        1 => among(Mood::Anything, 1, false),
    ]
}
