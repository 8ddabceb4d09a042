//! A trained DP3 network as a policy: what depth cameras saw lately and arm states in, a chunk for
//! each arm out.

use std::collections::VecDeque;
use std::path::Path;

use hal::{Chunk, Observation, POLICY_STEP_NS, Policy, PolicyError, TimeNs};
use tch::{Device, TchError, Tensor};

use crate::checkpoint::{Cause, CheckpointError, Recipe, load_dp3};
use crate::compute::Compute;
use crate::dimension::length;
use crate::dp3::{CloudObservation, Dp3Config, FoldedDp3, LimitsNormaliser};
use crate::interface::{self, Interface};
use trocar_data::perception::{CloudRecipe, Point};

/// A DP3 policy that was loaded from a folder.
///
/// It sees as many observations as its configuration says, a step of its recipe apart, or as nearly
/// as a run shows them; of one that is missing, the next newer one takes the place, as in training
/// at the beginning of an episode.
#[derive(Debug)]
pub struct Dp3Policy {
    config: Dp3Config,
    dp3: FoldedDp3,
    device: Device,
    interface: Interface,
    cloud: CloudRecipe,
    /// On the network's device, as is `state`; `action` is on the CPU.
    points: LimitsNormaliser,
    state: LimitsNormaliser,
    action: LimitsNormaliser,
    /// Oldest first, at most `history_steps() + 1`; cleared by `reset`.
    seen: VecDeque<ObservationStep>,
    /// Of the run, by `reset`; the noise depends on it and on the number of the answer.
    seed: u64,
}

/// One observation as the network wants it, in SI units.
#[derive(Clone, Debug)]
struct ObservationStep {
    stamp: TimeNs,
    cloud: Vec<Point>,
    state: Vec<f32>,
}

/// The network's input: observations, the oldest first.
struct NetworkInput {
    points: Vec<Point>,
    states: Vec<f32>,
}

impl NetworkInput {
    fn about(history: &[&ObservationStep]) -> Self {
        let clouds = history.iter().flat_map(|seen| &seen.cloud);
        let states = history.iter().flat_map(|seen| &seen.state);
        Self {
            points: clouds.copied().collect(),
            states: states.copied().collect(),
        }
    }
}

impl Dp3Policy {
    /// Loads the policy in `folder` and runs it once. The threads of `compute` become those of the
    /// whole process.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it.
    pub fn load(folder: &Path, compute: impl Into<Compute>) -> Result<Self, CheckpointError> {
        let compute = compute.into();
        let (device, kind) = (compute.device, compute.prepare(folder)?);
        let loaded = load_dp3(folder, device)?;
        let torch = |error: TchError| Cause::Parameter(error.into()).in_file(folder);
        let mut policy = Self {
            config: loaded.dp3.config().clone(),
            points: loaded.points.to_device(device).map_err(torch)?,
            state: loaded.state.to_device(device).map_err(torch)?,
            action: loaded.action,
            dp3: FoldedDp3::new(loaded.dp3, kind).map_err(torch)?,
            interface: Interface::new(loaded.recipe),
            cloud: loaded.cloud,
            device,
            seen: VecDeque::new(),
            seed: 0,
        };
        policy.warm_up().map_err(torch)?;
        Ok(policy)
    }

    /// Runs the network once on zeros: the first run allocates and selects kernels.
    fn warm_up(&mut self) -> Result<(), TchError> {
        let nothing = ObservationStep {
            stamp: TimeNs(0),
            cloud: vec![[0.0; 3]; self.cloud.points],
            state: vec![0.0; length(self.config.state_dim)],
        };
        let asked = NetworkInput::about(&vec![&nothing; self.observations()]);
        self.network(&asked, 0).map(|_| ())
    }

    /// The checkpoint's recipe: cameras, step, query interval.
    #[must_use]
    pub const fn recipe(&self) -> &Recipe {
        &self.interface.recipe
    }

    /// How its clouds are made.
    #[must_use]
    pub const fn cloud(&self) -> &CloudRecipe {
        &self.cloud
    }

    /// Observations that the network sees, a step of its recipe apart.
    #[must_use]
    pub fn observations(&self) -> usize {
        length(self.config.n_obs_steps)
    }

    /// The actions that answer `asked`, from the newest observation on; in SI units, row-major.
    fn network(&mut self, asked: &NetworkInput, answer: u64) -> Result<Vec<f32>, TchError> {
        let config = &self.config;
        let shape = [1, config.n_obs_steps, -1, 3];
        let device = self.device;
        tch::no_grad(|| {
            let points = on_device(asked.points.as_flattened(), &shape, device)?;
            let states = [1, config.n_obs_steps, config.state_dim];
            let states = on_device(&asked.states, &states, device)?;
            let (points, state) = (self.points.apply(&points)?, self.state.apply(&states)?);
            let observation = CloudObservation {
                points: &points,
                state: &state,
            };
            let noise = config.start_noise(self.seed, answer)?;
            let actions = self
                .dp3
                .infer(&observation, &noise.f_to_device(device)?)?
                .f_to_device(Device::Cpu)?;
            // All that is left of the horizon: the later steps bridge the time to the next answer.
            let first = config.n_obs_steps - 1;
            let actions = actions.f_narrow(1, first, config.horizon - first)?;
            Vec::<f32>::try_from(&self.action.invert(&actions)?.f_reshape([-1])?)
        })
    }

    /// What the network wants of `observation`.
    fn look(&self, observation: &Observation<'_>) -> Result<ObservationStep, PolicyError> {
        Ok(ObservationStep {
            state: self.interface.state(observation)?,
            cloud: interface::cloud(&self.cloud, observation)?,
            stamp: observation
                .arms
                .first()
                .map_or(TimeNs(0), |arm| arm.state.stamp),
        })
    }

    /// Adds the newest observation. Remembered ones that are not older are dropped, so that a clock
    /// that was set back starts anew.
    fn remember(&mut self, seen: ObservationStep) {
        self.seen.retain(|other| other.stamp < seen.stamp);
        self.seen.push_back(seen);
        while self.seen.len() as u64 > self.history_steps() + 1 {
            let _forgotten = self.seen.pop_front();
        }
    }

    /// The remembered observations nearest to the newest one's time and whole steps before, oldest
    /// first.
    fn history(&self) -> Vec<&ObservationStep> {
        let mut history = Vec::new();
        let Some(mut newest) = self.seen.back() else {
            return history;
        };
        let (now, step_ns) = (newest.stamp.0, self.interface.recipe.step_ns);
        let apart_ns = step_ns.max(POLICY_STEP_NS) / 2;
        for steps in 0..self.observations() as u64 {
            let due = now.saturating_sub(steps.saturating_mul(step_ns));
            let off = |seen: &&ObservationStep| seen.stamp.0.abs_diff(due);
            let near = self.seen.iter().filter(|seen| off(seen) <= apart_ns);
            newest = near.min_by_key(off).unwrap_or(newest);
            history.push(newest);
        }
        history.reverse();
        history
    }
}

fn on_device(numbers: &[f32], shape: &[i64], device: Device) -> Result<Tensor, TchError> {
    let numbers = Tensor::f_from_slice(numbers)?.f_view(shape)?;
    numbers.f_to_device(device)
}

impl Policy for Dp3Policy {
    fn reset(&mut self, seed: u64) {
        self.seed = seed;
        self.interface.sequence = 0;
        self.seen.clear();
    }

    fn history_steps(&self) -> u64 {
        let recipe = &self.interface.recipe;
        recipe.policy_steps_before(self.observations())
    }

    fn observe(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        let seen = self.look(observation)?;
        self.remember(seen);
        Ok(())
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.observe(observation)?;
        let asked = NetworkInput::about(&self.history());
        let actions = self.network(&asked, self.interface.sequence);
        self.interface.chunks(observation, actions)
    }
}
