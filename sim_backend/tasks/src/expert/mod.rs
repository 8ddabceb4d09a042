//! Scripted experts. An expert sees the scene's true state, once a policy step, and answers with a
//! chunk of tip targets, as a policy does; each is a little different with each seed. The scripts
//! that they follow lie with their tasks.
//!
//! It plans in space alone: joints, their limits and the workspace are the controller's, as with
//! any policy.

use hal::{Chunk, TimeNs, TipTarget};

use crate::scene::SceneState;
use crate::script::AnyScript;
pub use crate::script::{Activity, CHUNK_LEN, STEP_NS, SettleCriteria};
use crate::task::TaskConfig;
use hal::ARMS_MAX;

/// The scripted expert of a task.
#[derive(Debug)]
pub struct Expert {
    script: Box<dyn AnyScript>,
}

impl Expert {
    /// An expert for `task`; its habits depend on `seed`, apart from the scene's own randomness.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        Self {
            script: task.scene_of(seed).expert(&task.arms, seed),
        }
    }

    /// The same for an operator to go by, who sees late and waits with `care` for what the hands
    /// come to.
    #[must_use]
    pub fn careful(task: &TaskConfig, seed: u64, care: SettleCriteria) -> Self {
        let mut expert = Self::new(task, seed);
        expert.script.take_care(care, seed);
        expert
    }

    /// The first arm's target for `now` and those that would follow if the arm kept up and nothing
    /// unforeseen happened; to be called every [`STEP_NS`]. [`CHUNK_LEN`] targets in that arm's RCM
    /// frame. Costs ten steps of the script.
    pub fn chunk(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Chunk {
        let wishes = self.script.wishes(now, scene);
        Chunk::new(now, sequence, STEP_NS, &wishes.map(|wish| wish.first))
    }

    /// The same for all arms of the task, in their order; to be called instead of
    /// [`Expert::chunk`].
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

    /// What each arm was doing at the last step; an arm that the task lacks does
    /// [`Activity::Other`].
    #[must_use]
    pub fn activities(&self) -> [Activity; ARMS_MAX] {
        self.script.activities()
    }
}

#[cfg(test)]
mod tests;
