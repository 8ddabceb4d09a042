//! DP3: diffusion over actions, conditioned on a point cloud and the state (Ze et al. 2024), and
//! its smaller sibling SimpleDP3, with the published parameter names.
//!
//! Inputs and outputs are normalised by [`LimitsNormaliser`]; nothing in here knows units. Noise is
//! an argument: with [`Dp3Config::start_noise`] the same seed gives the same actions for the same
//! observation, which published code does not do.
//!
//! Source: reference note on policies, section 5; checked against golden numbers in
//! `tests/golden/`.

mod blocks;
mod config;
mod diffusion;
mod ema;
mod encoder;
mod folded;
mod limits;
#[cfg(test)]
mod tests;
mod unet;

use tch::{Kind, Reduction, TchError, Tensor};

pub use config::{Dp3Config, Dp3Preset};
pub use diffusion::Diffusion;
pub use ema::MovingAverage;
pub use folded::FoldedDp3;
pub use limits::{LimitsError, LimitsNormaliser};

use crate::parameters::{ParameterError, ParameterSource, Parameters};
use encoder::Encoder;
use hal::random::SplitMix64;
use unet::UNet;

/// A DP3 network.
#[derive(Debug)]
pub struct Dp3 {
    config: Dp3Config,
    encoder: Encoder,
    unet: UNet,
    diffusion: Diffusion,
    parameters: Parameters,
}

/// What the network sees: as many observations as its configuration says, the newest last,
/// normalised.
#[derive(Clone, Copy, Debug)]
pub struct CloudObservation<'a> {
    /// `(batch, observations, points, 3)`.
    pub points: &'a Tensor,
    /// `(batch, observations, state)`.
    pub state: &'a Tensor,
}

impl Dp3Config {
    /// The noise that the diffusion starts from at a policy's `answer`th answer under `seed`:
    /// standard normal, `(1, horizon, action)`, on the CPU.
    ///
    /// # Errors
    /// The network library's.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "networks compute in single precision"
    )]
    pub fn start_noise(&self, seed: u64, answer: u64) -> Result<Tensor, TchError> {
        let mut random = SplitMix64::named(&format!("dp3/noise/{answer}"), seed);
        let noise: Vec<f32> = (0..self.horizon * self.action_dim)
            .map(|_| random.normal() as f32)
            .collect();
        Tensor::f_from_slice(&noise)?.f_view([1, self.horizon, self.action_dim])
    }
}

impl Dp3 {
    /// Builds the network of `config`, which has no [`Dp3Config::defect`], from `source`.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    pub fn new(config: Dp3Config, mut source: ParameterSource) -> Result<Self, ParameterError> {
        let encoder = Encoder::new(&mut source, "obs_encoder", &config)?;
        let unet = UNet::new(&mut source, "model", &config)?;
        let diffusion = Diffusion::new(config.num_train_timesteps, config.num_inference_steps)?
            .on(unet.device())?;
        Ok(Self {
            encoder,
            unet,
            diffusion,
            parameters: source.finish()?,
            config,
        })
    }

    /// What the network was built from.
    #[must_use]
    pub const fn config(&self) -> &Dp3Config {
        &self.config
    }

    /// Its tensors by key.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Features of each observation: `(batch * observations, features)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn features(&self, observation: &CloudObservation<'_>) -> Result<Tensor, TchError> {
        let points = observation.points.f_flatten(0, 1)?;
        self.encoder
            .forward(&points, &observation.state.f_flatten(0, 1)?)
    }

    /// What the network takes for the clean actions behind `noisy` ones, both `(batch, horizon,
    /// action)`.
    ///
    /// `timestep` is `(batch)`, whole numbers; `condition` holds the features of all observations
    /// in one row, `(batch, features)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn denoise(
        &self,
        noisy: &Tensor,
        timestep: &Tensor,
        condition: &Tensor,
    ) -> Result<Tensor, TchError> {
        self.unet.forward(noisy, timestep, condition)
    }

    /// The actions that `noise` leads to, both `(batch, horizon, action)`; the first is due when
    /// the first of the observations was taken.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(
        &self,
        observation: &CloudObservation<'_>,
        noise: &Tensor,
    ) -> Result<Tensor, TchError> {
        let batch = noise.size()[0];
        let condition = self.features(observation)?.f_view([batch, -1])?;
        self.diffusion.sample(noise, |noisy, timestep| {
            let timestep = Tensor::f_full([batch], timestep, (Kind::Int64, noise.device()))?;
            self.denoise(noisy, &timestep, &condition)
        })
    }

    /// Of predicted `actions` those that are executed: from the newest observation on.
    ///
    /// # Errors
    /// The network library's, if there are too few.
    pub fn executed(&self, actions: &Tensor) -> Result<Tensor, TchError> {
        actions.f_narrow(1, self.config.n_obs_steps - 1, self.config.n_action_steps)
    }

    /// The loss of training: mean square of what the network gets wrong about the clean `actions`
    /// `(batch, horizon, action)` under standard normal `noise` at each one's `timestep`
    /// (`(batch)`, whole numbers).
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn loss(
        &self,
        observation: &CloudObservation<'_>,
        actions: &Tensor,
        noise: &Tensor,
        timestep: &Tensor,
    ) -> Result<Tensor, TchError> {
        let batch = actions.size()[0];
        let condition = self.features(observation)?.f_view([batch, -1])?;
        let noisy = self.diffusion.add_noise(actions, noise, timestep)?;
        self.denoise(&noisy, timestep, &condition)?
            .f_mse_loss(actions, Reduction::Mean)
    }
}
