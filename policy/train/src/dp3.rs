//! Training of DP3: the published recipe, but that every frame begins a sample, also the last ones
//! of an episode.
//!
//! Source: reference note on policies, section 5.7.

use tch::{Device, Kind, TchError, Tensor};

use super::augment;
use super::cloud_set::CloudSet;
use super::options::{Augmentation, TrainOptions};
use super::steps::{Learner, Losses};
use super::trained::{Network, Trained, check_arms, refuse};
use super::training_set::{index_tensor, raw_numbers};
use super::{AnyTrained, TrainError, Trainer, TrainingObserver};
use hal::random::SplitMix64;
use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_nets::checkpoint::CloudStatistics;
use trocar_nets::dimension::length;
use trocar_nets::dp3::{CloudObservation, Dp3, Dp3Config, LimitsError, LimitsNormaliser};
use trocar_nets::parameters::{ParameterError, ParameterSource};

impl Network for Dp3 {
    type Config = Dp3Config;
    type Statistics = CloudStatistics;

    fn build(config: Dp3Config, source: ParameterSource) -> Result<Self, ParameterError> {
        Self::new(config, source)
    }

    fn any(trained: Trained<Self>) -> AnyTrained {
        AnyTrained::Dp3(trained.into())
    }
}

impl Trainer {
    /// Trains the DP3 network `config` on the clouds that `cloud` makes of `dataset`, from a fresh
    /// start.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn run_dp3(
        &self,
        config: &Dp3Config,
        cloud: &CloudRecipe,
        options: &TrainOptions,
        dataset: &Dataset,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Trained<Dp3>, TrainError> {
        refuse(options.defect().or_else(|| config.defect()))?;
        check_arms([config.state_dim, config.action_dim], dataset.arms())?;
        self.begin(options);
        let steps = [config.n_obs_steps - 1, config.horizon].map(length);
        let set = CloudSet::new(dataset, cloud, steps, options, watch)?;
        let source = ParameterSource::seeded(options.seed, Device::Cpu);
        let fresh = Dp3::new(config.clone(), source)?;
        let place = (options.augmentation, self.device);
        let learner = |dp3| Run::new(dp3, dataset, &set, place);
        let fresh = (config, fresh.parameters());
        self.train(fresh, &set.prepared(cloud), options, learner, watch)
    }
}

/// A run in progress: everything normalised and on the training device.
struct Run {
    dp3: Dp3,
    /// `(frames, points, 3)`.
    points: Tensor,
    /// `(frames, state)`.
    states: Tensor,
    /// `(frames, horizon, action)`.
    actions: Tensor,
    /// Indices of what is observed at each frame, oldest first: `(frames, observations)`. At the
    /// beginning of an episode its first frame takes the place of those before it.
    observed: Tensor,
    /// What a metre is in normalised points, for each coordinate.
    metre: Tensor,
    augmentation: Augmentation,
    device: Device,
}

impl Run {
    /// Normalises everything once, by the limits of the trained frames.
    fn new(
        dp3: Dp3,
        dataset: &Dataset,
        set: &CloudSet,
        (augmentation, device): (Augmentation, Device),
    ) -> Result<Self, TrainError> {
        let CloudStatistics {
            state,
            action,
            points,
        } = &set.statistics;
        let limits = |min: &[f32], max: &[f32]| {
            let normaliser = LimitsNormaliser::new(min, max).map_err(|error| match error {
                LimitsError::Torch(error) => TrainError::Torch(error),
                LimitsError::Count { .. } | LimitsError::Order { .. } => {
                    TrainError::Dataset(error.to_string())
                }
            })?;
            Ok::<_, TrainError>(normaliser.to_device(device)?)
        };
        let (states, actions) = raw_numbers(dataset, &set.rows)?;
        let horizon = dp3.config().horizon;
        let actions = actions.f_view([-1, horizon, dp3.config().action_dim])?;
        let observations = length(dp3.config().n_obs_steps);
        let observed: Vec<usize> = set
            .episode_start
            .iter()
            .enumerate()
            .flat_map(|(frame, &start)| {
                // The first frame again, before there was one.
                (0..observations)
                    .rev()
                    .map(move |back| frame.saturating_sub(back).max(start))
            })
            .collect();
        let to_points = limits(&points[0], &points[1])?;
        let (kind, origin) = (Kind::Float, [1, 3].as_slice());
        let metre = to_points
            .apply(&Tensor::f_ones(origin, (kind, device))?)?
            .f_sub(&to_points.apply(&Tensor::f_zeros(origin, (kind, device))?)?)?;
        Ok(Self {
            points: to_points.apply(&set.points(device)?)?,
            metre,
            augmentation,
            states: limits(&state.min, &state.max)?.apply(&states.f_to_device(device)?)?,
            actions: limits(&action.min, &action.max)?.apply(&actions.f_to_device(device)?)?,
            observed: index_tensor(&observed, device)?.f_view([-1, dp3.config().n_obs_steps])?,
            dp3,
            device,
        })
    }

    /// Points and states that are observed at the frames `indices`, and the actions from there.
    fn batch(&self, indices: &Tensor) -> Result<[Tensor; 3], TchError> {
        let observed = self.observed.f_index_select(0, indices)?;
        let shape = observed.size();
        let flat = observed.f_view([-1])?;
        let points = self.points.f_index_select(0, &flat)?;
        let points = points.f_view([shape[0], shape[1], -1, 3])?;
        let states = self.states.f_index_select(0, &flat)?;
        let states = states.f_view([shape[0], shape[1], -1])?;
        Ok([points, states, self.actions.f_index_select(0, indices)?])
    }
}

impl Learner for Run {
    fn inputs(&self, frames: &[usize], _random: &mut SplitMix64) -> Result<Vec<Tensor>, TchError> {
        Ok(vec![index_tensor(frames, self.device)?])
    }

    fn losses(&self, inputs: &[Tensor]) -> Result<Losses<'_>, TchError> {
        let [points, states, actions] = self.batch(&inputs[0])?;
        let points = augment::points(points, &self.augmentation, Some(&self.metre), true)?;
        let states = augment::state(states, &self.augmentation)?;
        let observation = CloudObservation {
            points: &points,
            state: &states,
        };
        let noise = actions.f_randn_like()?;
        let timesteps = self.dp3.config().num_train_timesteps;
        let timestep =
            Tensor::f_randint(timesteps, [actions.size()[0]], (Kind::Int64, self.device))?;
        let total = self.dp3.loss(&observation, &actions, &noise, &timestep)?;
        Ok(Losses {
            l1: total.f_detach()?,
            kl: total.f_zeros_like()?.f_detach()?,
            total,
            below: None,
        })
    }

    /// Mean absolute error of the executed steps, after the whole diffusion of inference.
    fn error(&self, frames: &[usize]) -> Result<f64, TchError> {
        let indices = index_tensor(frames, self.device)?;
        let [points, states, actions] = self.batch(&indices)?;
        let observation = CloudObservation {
            points: &points,
            state: &states,
        };
        let config = self.dp3.config();
        // The same noise for every frame and every row of the curve.
        let noise = config.start_noise(0, 0)?.f_to_device(self.device)?;
        let noise = noise.f_expand(actions.size(), false)?.f_contiguous()?;
        let predicted = self.dp3.infer(&observation, &noise)?;
        let error = self.dp3.executed(&predicted)?;
        let error = error.f_sub(&self.dp3.executed(&actions)?)?;
        error.f_abs()?.f_mean(Kind::Double)?.f_double_value(&[])
    }
}
