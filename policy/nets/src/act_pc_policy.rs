//! A trained ACT-PC network as a policy: what depth cameras see and arm states in, a chunk for each
//! arm out.
//!
//! The way of an observation: depth images to a cloud by the checkpoint's recipe, centres and
//! neighbours on the CPU, network, un-normalisation, absolute targets. No history: each answer
//! depends on the present observation alone.

use std::path::Path;

use hal::{Chunk, Observation, Policy, PolicyError};
use tch::{Device, TchError, Tensor};

use crate::act_pc::{ActPcConfig, Clouds, CloudsError, FoldedActPc};
use crate::checkpoint::{Cause, CheckpointError, Recipe, load_act_pc};
use crate::compute::Compute;
use crate::dimension::length;
use crate::interface::{self, Interface};
use crate::normalise::Normaliser;
use trocar_data::perception::{CloudRecipe, Point};

/// An ACT-PC policy that was loaded from a folder.
#[derive(Debug)]
pub struct ActPcPolicy {
    config: ActPcConfig,
    /// Launched kernel by kernel: it has no CUDA graph.
    network: FoldedActPc,
    device: Device,
    interface: Interface,
    /// How clouds were made in training.
    cloud: CloudRecipe,
    /// On the CPU, as is `action`.
    state: Normaliser,
    action: Normaliser,
}

impl ActPcPolicy {
    /// Loads the policy in `folder` and runs it once. The threads of `compute` become those of the
    /// whole process.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it.
    pub fn load(folder: &Path, compute: impl Into<Compute>) -> Result<Self, CheckpointError> {
        let compute = compute.into();
        let (device, kind) = (compute.device, compute.prepare(folder)?);
        let loaded = load_act_pc(folder, device)?;
        let network = FoldedActPc::new(&loaded.network, kind)
            .map_err(|error| Cause::Parameter(error.into()).in_file(folder))?;
        let policy = Self {
            state: loaded.statistics.state.normaliser(),
            action: loaded.statistics.action.normaliser(),
            config: loaded.network.config().clone(),
            network,
            device,
            interface: Interface::new(loaded.recipe),
            cloud: loaded.cloud,
        };
        let dims = length(policy.config.act.state_dim);
        let nothing = vec![[0.0; 3]; policy.cloud.points];
        policy
            .actions(&nothing, &vec![0.0; dims])
            .map_err(|error| Cause::Inconsistent(error.to_string()).in_file(folder))?;
        Ok(policy)
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

    /// A cloud in metres and the state in SI units to actions in SI units, row-major.
    fn actions(&self, cloud: &[Point], state: &[f32]) -> Result<Vec<f32>, CloudsError> {
        let clouds = Clouds::new(&[cloud], &self.config, self.device)?;
        let actions = tch::no_grad(|| {
            let state = Tensor::f_from_slice(state)?.f_unsqueeze(0)?;
            let state = self.state.apply(&state)?.f_to_device(self.device)?;
            let chunk = self.network.infer(&clouds, &state)?;
            let chunk = self.action.invert(&chunk.f_to_device(Device::Cpu)?)?;
            Vec::<f32>::try_from(&chunk.f_reshape([-1])?)
        });
        actions.map_err(|error: TchError| error.into())
    }
}

impl Policy for ActPcPolicy {
    fn reset(&mut self, _seed: u64) {
        // Inference draws nothing at random: the latent is zero.
        self.interface.sequence = 0;
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        let state = self.interface.state(observation)?;
        let cloud = interface::cloud(&self.cloud, observation)?;
        let actions = self.actions(&cloud, &state);
        self.interface.chunks(observation, actions)
    }
}
