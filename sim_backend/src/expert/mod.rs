//! Scripted experts: one script a task, a little different with each seed.
//!
//! A script sees the scene's true state, once a policy step, and answers with the tip targets of that instant. Targets
//! form smooth paths from rest to rest, so that they can be recorded as demonstrations. Scripts follow what moves, and
//! start over when a grasp failed.

mod block_transfer;
#[cfg(test)]
pub(crate) mod closed_loop;
mod hand;
mod motion;
mod needle_handover;
mod needle_lift;
mod suture_pad;
mod tissue_retraction;
mod wire;

use hal::{Chunk, TimeNs, TipTarget};

use crate::simulation::{ArmScene, SceneState};
use crate::task::{ARMS_MAX, Scene, TaskConfig};

/// Time between two steps of an expert, ns: 40 control ticks.
pub const STEP_NS: u64 = 40 * hal::TICK_NS;

/// Targets in one chunk of an expert: 0.4 s.
pub const CHUNK_LEN: usize = 10;

/// The scripted expert of a task.
#[derive(Clone, Debug)]
pub struct Expert {
    script: AnyScript,
}

#[derive(Clone, Debug)]
enum AnyScript {
    NeedleLift(Box<needle_lift::Lifter>),
    BlockTransfer(Box<block_transfer::Mover>),
    SuturePad(Box<suture_pad::Driver>),
    NeedleHandover(Box<needle_handover::Passer>),
    TissueRetraction(Box<tissue_retraction::Retractor>),
}

/// Where the tips should be at one instant, each in its arm's RCM frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wish {
    first: TipTarget,
    second: Option<TipTarget>,
}

/// What an expert of one task does.
trait Script: Clone {
    /// The wish for `now`; to be asked every [`STEP_NS`]. The first call starts from where the tips are measured.
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish;

    /// Attempts at a grasp begun so far, the present one included.
    fn attempts(&self) -> u32;

    /// Changes `scene` to what it would be after `wish` if the arms kept up.
    fn foresee(&self, scene: &mut SceneState, wish: &Wish) {
        arrive(&mut scene.first, &wish.first);
        if let (Some(arm), Some(target)) = (&mut scene.second, &wish.second) {
            arrive(arm, target);
        }
    }
}

impl Expert {
    /// An expert for `task`; its habits hang on `seed`, apart from the scene's own randomness.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        let script = match &task.scene {
            Scene::NeedleLift(scene) => {
                AnyScript::NeedleLift(Box::new(needle_lift::Lifter::new(task, scene, seed)))
            }
            Scene::BlockTransfer(scene) => {
                AnyScript::BlockTransfer(Box::new(block_transfer::Mover::new(task, scene, seed)))
            }
            Scene::SuturePad(scene) => {
                AnyScript::SuturePad(Box::new(suture_pad::Driver::new(task, scene, seed)))
            }
            Scene::NeedleHandover(scene) => {
                AnyScript::NeedleHandover(Box::new(needle_handover::Passer::new(task, scene, seed)))
            }
            Scene::TissueRetraction(scene) => {
                let script = tissue_retraction::Retractor::new(task, scene, seed);
                AnyScript::TissueRetraction(Box::new(script))
            }
        };
        Self { script }
    }

    /// The first arm's target for `now` and those that would follow if the arm kept up and nothing unforeseen happened;
    /// to be called every [`STEP_NS`].
    pub fn chunk(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Chunk {
        let wishes = self.wishes(now, scene);
        Chunk::new(now, sequence, STEP_NS, &wishes.map(|wish| wish.first))
    }

    /// The same for all arms of the task, in their order; to be called instead of [`Expert::chunk`].
    pub fn chunks(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Vec<Chunk> {
        let wishes = self.wishes(now, scene);
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
        match &self.script {
            AnyScript::NeedleLift(script) => script.attempts(),
            AnyScript::BlockTransfer(script) => script.attempts(),
            AnyScript::SuturePad(script) => script.attempts(),
            AnyScript::NeedleHandover(script) => script.attempts(),
            AnyScript::TissueRetraction(script) => script.attempts(),
        }
    }

    fn wishes(&mut self, now: TimeNs, scene: &SceneState) -> [Wish; CHUNK_LEN] {
        match &mut self.script {
            AnyScript::NeedleLift(script) => foreseen(&mut **script, now, scene),
            AnyScript::BlockTransfer(script) => foreseen(&mut **script, now, scene),
            AnyScript::SuturePad(script) => foreseen(&mut **script, now, scene),
            AnyScript::NeedleHandover(script) => foreseen(&mut **script, now, scene),
            AnyScript::TissueRetraction(script) => foreseen(&mut **script, now, scene),
        }
    }
}

/// The wish of `script` for `now`, and those that would follow.
fn foreseen<S: Script>(script: &mut S, now: TimeNs, scene: &SceneState) -> [Wish; CHUNK_LEN] {
    let mut wish = script.step(now, scene);
    let mut wishes = [wish; CHUNK_LEN];
    let mut ahead = script.clone();
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

/// [`arrive`] with the thing in the hand.
fn carry(arm: &mut ArmScene, target: &TipTarget) {
    let thing_in_tip = arm.tip_in_rcm.inv_mul(&arm.thing_in_rcm);
    arrive(arm, target);
    arm.thing_in_rcm = arm.tip_in_rcm * thing_in_tip;
}

fn arrive(arm: &mut ArmScene, target: &TipTarget) {
    arm.tip_in_rcm = target.tip_in_rcm();
    arm.jaw = target.jaw;
}
