//! The adversaries: each a way to ask an arm for harm.

mod bang_bang;
mod climber;
mod drift;
mod jumps;
mod messages;
mod nonsense;
mod walk;

use hal::{ArmState, Chunk, Pose, TICK_NS, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::rig::home;
use crate::config::ControlConfig;
use crate::kinematics::forward;
use hal::random::SplitMix64;

/// A policy step.
pub(super) const STEP_NS: u64 = 40 * TICK_NS;

/// What an adversary sees before it acts.
pub(super) struct View<'a> {
    /// The control period.
    pub(super) now: TimeNs,
    /// Which arm it is asked about.
    pub(super) arm: usize,
    /// Where all arms are.
    pub(super) arms: &'a [ArmState],
    /// Everything about limits and boundaries.
    pub(super) config: &'a ControlConfig,
}

/// One way to attack one arm.
pub(super) trait Adversary {
    /// What arrives in this tick; without anything new the arm goes on seeing what came last.
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk>;
}

/// The ways there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// As fast as possible from one far corner to another.
    BangBang,
    /// Targets that are elsewhere in every tick, and single ticks that are very far away.
    Jumps,
    /// Slowly into corners, beyond them, and out again.
    Drift,
    /// A good motion with NaN, infinities, denormal and huge numbers in it.
    Nonsense,
    /// A good motion whose messages come late, twice, in the wrong order or not at all.
    Messages,
    /// Looks at the arm and goes where a boundary or the other arm comes nearer fastest.
    Climber,
    /// Wild chunks of many kinds, one after the other.
    Walk,
    /// Each of the others for a while.
    All,
}

impl Kind {
    const SINGLE: [Self; 7] = [
        Self::BangBang,
        Self::Jumps,
        Self::Drift,
        Self::Nonsense,
        Self::Messages,
        Self::Climber,
        Self::Walk,
    ];

    /// An adversary of this kind.
    pub(super) fn adversary(self) -> Box<dyn Adversary> {
        match self {
            Self::BangBang => Box::<bang_bang::BangBang>::default(),
            Self::Jumps => Box::<jumps::Jumps>::default(),
            Self::Drift => Box::<drift::Drift>::default(),
            Self::Nonsense => Box::<nonsense::Nonsense>::default(),
            Self::Messages => Box::<messages::Messages>::default(),
            Self::Climber => Box::<climber::Climber>::default(),
            Self::Walk => Box::<walk::Walk>::default(),
            Self::All => Box::new(Turns {
                adversaries: Self::SINGLE.map(Self::adversary),
                current: 0,
                patience: 0,
            }),
        }
    }
}

/// Lets each adversary act for a while.
struct Turns {
    adversaries: [Box<dyn Adversary>; Kind::SINGLE.len()],
    current: usize,
    patience: u32,
}

impl Adversary for Turns {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience == 0 {
            self.current = below(random, self.adversaries.len());
            self.patience = ticks(random, 20, 1500);
        }
        self.patience -= 1;
        self.adversaries[self.current].next(random, view)
    }
}

/// An index below `count`.
pub(in crate::tests) fn below(random: &mut SplitMix64, count: usize) -> usize {
    usize::try_from(random.next_u64() % count as u64).unwrap()
}

/// A number of ticks in `low..high`.
pub(super) fn ticks(random: &mut SplitMix64, low: u32, high: u32) -> u32 {
    low + u32::try_from(random.next_u64() % u64::from(high - low)).unwrap()
}

/// A chunk of one target, held.
fn hold(now: TimeNs, target: TipTarget) -> Chunk {
    // The sequence rises with the time, so that whoever acts next is in order.
    Chunk::new(now, 1 + now.0, STEP_NS, &[target; 8])
}

/// A chunk of many.
fn chunk(now: TimeNs, step_ns: u64, targets: &[TipTarget]) -> Chunk {
    Chunk::new(now, 1 + now.0, step_ns, targets)
}

/// A target anywhere within `reach_m` of the middle of the workspace, in any orientation.
fn wild_target(random: &mut SplitMix64, reach_m: f64) -> TipTarget {
    let mut unit = || random.between(-1.0, 1.0);
    let place = Vector3::new(unit(), unit(), unit()) * reach_m + Vector3::new(0.0, 0.0, -0.11);
    let turn = UnitQuaternion::new(Vector3::new(unit(), unit(), unit()) * 2.0);
    let rotation = turn * forward(&home().position).rotation;
    let pose = Pose::from_parts(Translation3::from(place), rotation);
    TipTarget::new(&pose, 0.4 + 1.5 * unit())
}

/// A motion that breaks nothing: a circle about home with some turning, and the jaw at work.
fn good_target(time_s: f64) -> TipTarget {
    let phase = core::f64::consts::TAU * time_s / 2.5;
    let home = forward(&home().position);
    let place = Vector3::new(
        0.008 * phase.cos(),
        0.006 * phase.sin(),
        0.004 * phase.sin(),
    );
    let turn = UnitQuaternion::new(Vector3::new(0.2 * phase.sin(), 0.0, 0.3 * phase.cos()));
    let pose = Pose::from_parts(
        Translation3::from(home.translation.vector + place),
        turn * home.rotation,
    );
    TipTarget::new(&pose, 0.3 + 0.2 * phase.sin())
}

/// The next 100 steps of the good motion.
fn good_chunk(now: TimeNs) -> Chunk {
    let mut good = chunk(now, STEP_NS, &[good_target(0.0); 100]);
    for index in 0..100 {
        good.targets[index] = good_target(good.due(index).seconds());
    }
    good
}
