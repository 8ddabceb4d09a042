//! What the scripts of all tasks share. Each lies with its task, and is a little different with
//! each seed.
//!
//! A script sees the scene's true state, once a policy step, and answers with the tip targets of
//! that instant. Targets form smooth paths from rest to rest, so that they can be recorded as
//! demonstrations. Scripts follow what moves, and start over when a grasp failed.
//!
//! [`AnyScript::wishes`] turns the scene into each hand's view, in the scene frame; [`play::Hand`]
//! moves on in its part's phases, or stays, and gives the placement of its present
//! [`motion::Motion`]; that becomes a target in the arm's RCM frame. For the rest of the chunk a
//! copy of the script is played on in a scene that is imagined: arms where they were wanted, what
//! is held carried along, nothing else moving.

pub(crate) mod alone;
pub(crate) mod care;
pub(crate) mod hand;
pub(crate) mod motion;
pub(crate) mod play;
pub(crate) mod wire;

use core::fmt::Debug;

use hal::{TimeNs, TipTarget};

pub use care::SettleCriteria;
pub use play::Activity;

use crate::scene::{ArmScene, SceneState};
use hal::ARMS_MAX;

/// Time between two steps of an expert, ns: 40 control ticks.
pub const STEP_NS: u64 = 40 * hal::TICK_NS;

/// Targets in one chunk of an expert: 0.4 s.
pub const CHUNK_LEN: usize = 10;

/// Where the tips should be at one instant, each in its arm's RCM frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TipTargets {
    pub(crate) first: TipTarget,
    pub(crate) second: Option<TipTarget>,
}

/// What an expert of one task does. Cloned once a policy step, to be played on.
pub(crate) trait Script: Clone + Debug + Send + 'static {
    /// The wish for `now`; to be asked every [`STEP_NS`]. The first call starts from where the tips
    /// are measured.
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> TipTargets;

    /// Attempts at a grasp begun so far, the present one included.
    fn attempts(&self) -> u32;

    /// What each arm is doing.
    fn activities(&self) -> [Activity; ARMS_MAX];

    /// From now on it is played with `care`, whose pauses are drawn by `seed`.
    fn take_care(&mut self, care: SettleCriteria, seed: u64);

    /// Changes `scene` to what it would be after `wish` if the arms kept up. Fingers feel in it
    /// what they felt before: a grip is foreseen neither to close nor to slip.
    fn foresee(&self, scene: &mut SceneState, wish: &TipTargets);
}

/// A script of whatever task, with its foresight.
pub(crate) trait AnyScript: Debug + Send {
    /// The wish for `now`, and those that would follow. Counted from 0, the n-th is for n times
    /// [`STEP_NS`] after `now`. Only the step for `now` changes the script itself.
    fn wishes(&mut self, now: TimeNs, scene: &SceneState) -> [TipTargets; CHUNK_LEN];

    /// Attempts at a grasp begun so far, the present one included.
    fn attempts(&self) -> u32;

    /// What each arm is doing.
    fn activities(&self) -> [Activity; ARMS_MAX];

    /// As [`Script::take_care`].
    fn take_care(&mut self, care: SettleCriteria, seed: u64);
}

impl<S: Script> AnyScript for S {
    fn wishes(&mut self, now: TimeNs, scene: &SceneState) -> [TipTargets; CHUNK_LEN] {
        let mut wish = self.step(now, scene);
        let mut wishes = [wish; CHUNK_LEN];
        let mut ahead = self.clone();
        let mut imagined = *scene;
        let mut due = now;
        for slot in wishes.iter_mut().skip(1) {
            due = due.plus_ns(STEP_NS);
            ahead.foresee(&mut imagined, &wish);
            wish = ahead.step(due, &imagined);
            *slot = wish;
        }
        wishes
    }

    fn attempts(&self) -> u32 {
        Script::attempts(self)
    }

    fn activities(&self) -> [Activity; ARMS_MAX] {
        Script::activities(self)
    }

    fn take_care(&mut self, care: SettleCriteria, seed: u64) {
        Script::take_care(self, care, seed);
    }
}

/// [`arrive`] with the thing in the hand.
pub(crate) fn carry(arm: &mut ArmScene, target: &TipTarget) {
    let thing_in_tip = arm.tip_in_rcm.inv_mul(&arm.thing_in_rcm);
    arrive(arm, target);
    arm.thing_in_rcm = arm.tip_in_rcm * thing_in_tip;
}

/// Changes `arm` to what it would be if it were where `target` wants it.
pub(crate) fn arrive(arm: &mut ArmScene, target: &TipTarget) {
    arm.tip_in_rcm = target.tip_in_rcm();
    arm.jaw = target.jaw;
}
