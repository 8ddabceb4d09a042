//! Scripted experts: what the scripts of all tasks share. Each lies with its task, and is a little different with each seed.
//!
//! A script sees the scene's true state, once a policy step, and answers with the tip targets of that instant. Targets
//! form smooth paths from rest to rest, so that they can be recorded as demonstrations. Scripts follow what moves, and
//! start over when a grasp failed.

pub(crate) mod alone;
#[cfg(test)]
pub(crate) mod closed_loop;
pub(crate) mod hand;
pub(crate) mod motion;
pub(crate) mod play;
pub(crate) mod wire;

use core::fmt::Debug;

use hal::{Chunk, TimeNs, TipTarget};

pub use play::Activity;

use crate::simulation::{ArmScene, SceneState};
use crate::task::{ARMS_MAX, TaskConfig};

/// Time between two steps of an expert, ns: 40 control ticks.
pub const STEP_NS: u64 = 40 * hal::TICK_NS;

/// Targets in one chunk of an expert: 0.4 s.
pub const CHUNK_LEN: usize = 10;

/// The scripted expert of a task.
#[derive(Debug)]
pub struct Expert {
    script: Box<dyn AnyScript>,
}

/// Where the tips should be at one instant, each in its arm's RCM frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wish {
    pub(crate) first: TipTarget,
    pub(crate) second: Option<TipTarget>,
}

/// What an expert of one task does.
pub(crate) trait Script: Clone + Debug + Send + 'static {
    /// The wish for `now`; to be asked every [`STEP_NS`]. The first call starts from where the tips are measured.
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish;

    /// Attempts at a grasp begun so far, the present one included.
    fn attempts(&self) -> u32;

    /// What each arm is doing.
    fn activities(&self) -> [Activity; ARMS_MAX];

    /// Changes `scene` to what it would be after `wish` if the arms kept up.
    fn foresee(&self, scene: &mut SceneState, wish: &Wish);
}

/// A script of whatever task, with its foresight.
pub(crate) trait AnyScript: Debug + Send {
    /// The wish for `now`, and those that would follow.
    fn wishes(&mut self, now: TimeNs, scene: &SceneState) -> [Wish; CHUNK_LEN];

    /// Attempts at a grasp begun so far, the present one included.
    fn attempts(&self) -> u32;

    /// What each arm is doing.
    fn activities(&self) -> [Activity; ARMS_MAX];
}

impl<S: Script> AnyScript for S {
    fn wishes(&mut self, now: TimeNs, scene: &SceneState) -> [Wish; CHUNK_LEN] {
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
}

impl Expert {
    /// An expert for `task`; its habits hang on `seed`, apart from the scene's own randomness.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        Self {
            script: task.scene_of(seed).expert(&task.arms, seed),
        }
    }

    /// The first arm's target for `now` and those that would follow if the arm kept up and nothing unforeseen happened;
    /// to be called every [`STEP_NS`].
    pub fn chunk(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Chunk {
        let wishes = self.script.wishes(now, scene);
        Chunk::new(now, sequence, STEP_NS, &wishes.map(|wish| wish.first))
    }

    /// The same for all arms of the task, in their order; to be called instead of [`Expert::chunk`].
    pub fn chunks(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Vec<Chunk> {
        let wishes = self.script.wishes(now, scene);
        let first = wishes.map(|wish| Some(wish.first));
        let second = wishes.map(|wish| wish.second);
        let mut chunks = Vec::with_capacity(ARMS_MAX);
        for targets in [first, second] {
            let targets: Vec<TipTarget> = targets.into_iter().flatten().collect();
            if !targets.is_empty() {
                chunks.push(Chunk::new(now, sequence, STEP_NS, &targets));
            }
        }
        chunks
    }

    /// Attempts at a grasp begun so far, the present one included.
    #[must_use]
    pub fn attempts(&self) -> u32 {
        self.script.attempts()
    }

    /// What each arm was doing at the last step; an arm that the task lacks does [`Activity::Other`].
    #[must_use]
    pub fn activities(&self) -> [Activity; ARMS_MAX] {
        self.script.activities()
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

#[cfg(test)]
mod tests;
