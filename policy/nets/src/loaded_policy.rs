//! A trained policy of any kind, chosen by its `config.json`.

use std::path::Path;

use hal::{Chunk, Observation, Policy, PolicyError};

use crate::act_pc_policy::ActPcPolicy;
use crate::act_policy::ActPolicy;
use crate::checkpoint::{
    ACT_PC_TYPE, Cause, CheckpointError, DP3_TYPE, RECIPE, Recipe, dp3_history_steps, load_recipe,
    policy_type,
};
use crate::compute::Compute;
use crate::dp3_policy::Dp3Policy;

/// A policy that was loaded from a folder.
#[derive(Debug)]
pub enum LoadedPolicy {
    /// ACT, from colour images.
    Act(Box<ActPolicy>),
    /// ACT-PC, from point clouds.
    ActPc(Box<ActPcPolicy>),
    /// DP3, from point clouds.
    Dp3(Box<Dp3Policy>),
}

/// What is known of a policy before its weights are read.
///
/// What a real-time run needs in its own process; the network runs in a child, which loads the
/// weights.
#[derive(Clone, Debug)]
pub struct PolicyOutline {
    /// Cameras, step, query period.
    pub recipe: Recipe,
    /// Steps before a query that it wants to have observed too.
    pub history_steps: u64,
}

impl PolicyOutline {
    /// Of the policy in `folder`: its weights may still be refused.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it.
    pub fn read(folder: &Path) -> Result<Self, CheckpointError> {
        let recipe =
            load_recipe(folder)?.ok_or_else(|| Cause::NoRecipe.in_file(&folder.join(RECIPE)))?;
        let history_steps = match policy_type(folder)?.as_deref() {
            Some(DP3_TYPE) => dp3_history_steps(folder, &recipe)?,
            _ => 0,
        };
        Ok(Self {
            recipe,
            history_steps,
        })
    }
}

impl LoadedPolicy {
    /// Loads the policy in `folder` and runs it once. The threads of `compute` become those of the
    /// whole process.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it.
    pub fn load(folder: &Path, compute: impl Into<Compute>) -> Result<Self, CheckpointError> {
        let compute = compute.into();
        Ok(match policy_type(folder)?.as_deref() {
            Some(ACT_PC_TYPE) => Self::ActPc(Box::new(ActPcPolicy::load(folder, compute)?)),
            Some(DP3_TYPE) => Self::Dp3(Box::new(Dp3Policy::load(folder, compute)?)),
            _ => Self::Act(Box::new(ActPolicy::load(folder, compute)?)),
        })
    }

    /// The policy's recipe: cameras, step, query period.
    #[must_use]
    pub fn recipe(&self) -> &Recipe {
        match self {
            Self::Act(policy) => policy.recipe(),
            Self::ActPc(policy) => policy.recipe(),
            Self::Dp3(policy) => policy.recipe(),
        }
    }

    fn policy(&mut self) -> &mut dyn Policy {
        match self {
            Self::Act(policy) => policy.as_mut(),
            Self::ActPc(policy) => policy.as_mut(),
            Self::Dp3(policy) => policy.as_mut(),
        }
    }
}

impl Policy for LoadedPolicy {
    fn reset(&mut self, seed: u64) {
        self.policy().reset(seed);
    }

    fn history_steps(&self) -> u64 {
        match self {
            Self::Act(policy) => policy.history_steps(),
            Self::ActPc(policy) => policy.history_steps(),
            Self::Dp3(policy) => policy.history_steps(),
        }
    }

    fn observe(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        self.policy().observe(observation)
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.policy().infer(observation)
    }
}
