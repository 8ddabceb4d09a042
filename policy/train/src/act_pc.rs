//! Training of ACT-PC: ACT's recipe, its clouds and what belongs together in them made once.
//!
//! Centres and neighbours are found on the CPU before the first step and stay as they are; noise
//! moves points but does not change which are neighbours.

use tch::{Device, Kind, TchError, Tensor};

use super::augment;
use super::cloud_set::CloudSet;
use super::options::{Augmentation, TrainOptions, TrainPrecision};
use super::steps::{Learner, Losses};
use super::trained::{Network, Trained, check_arms, refuse};
use super::training_set::{index_tensor, numbers};
use super::{AnyTrained, TrainError, Trainer, TrainingObserver};
use hal::random::SplitMix64;
use trocar_data::dataset::Dataset;
use trocar_data::perception::{CloudRecipe, Point};
use trocar_nets::act::{Demonstration, LossDenominator, l1_loss};
use trocar_nets::act_pc::{ActPc, ActPcConfig, Clouds, CloudsError};
use trocar_nets::checkpoint::CloudStatistics;
use trocar_nets::dimension::length;
use trocar_nets::parameters::{ParameterError, ParameterSource};

impl Network for ActPc {
    type Config = ActPcConfig;
    type Statistics = CloudStatistics;

    fn build(config: ActPcConfig, source: ParameterSource) -> Result<Self, ParameterError> {
        Self::new(config, source)
    }

    fn any(trained: Trained<Self>) -> AnyTrained {
        AnyTrained::ActPc(trained.into())
    }
}

impl Trainer {
    /// Trains the ACT-PC network `config` on the clouds that `cloud` makes of `dataset`, from a
    /// fresh start.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn run_act_pc(
        &self,
        config: &ActPcConfig,
        cloud: &CloudRecipe,
        options: &TrainOptions,
        dataset: &Dataset,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Trained<ActPc>, TrainError> {
        refuse(options.defect().or_else(|| config.defect()))?;
        if options.precision != TrainPrecision::F32 {
            let defect = "ACT-PC is trained in single precision".to_owned();
            return Err(TrainError::Options(defect));
        }
        check_arms(
            [config.act.state_dim, config.act.action_dim],
            dataset.arms(),
        )?;
        self.begin(options);
        let steps = length(config.act.chunk_size);
        let set = CloudSet::new(dataset, cloud, [0, steps], options, watch)?;
        let prepared = set.prepared(cloud);
        let source = ParameterSource::seeded(options.seed, Device::Cpu);
        let fresh = ActPc::new(config.clone(), source)?;
        let [states, actions, is_pad] =
            numbers(dataset, &set.rows, steps, prepared.features, self.device)?;
        let learner = |network| {
            Ok(Run {
                clouds: all_clouds(&set.clouds, config, options.threads, self.device)?,
                network,
                states,
                actions,
                is_pad,
                augmentation: options.augmentation,
            })
        };
        self.train(
            (config, fresh.parameters()),
            &prepared,
            options,
            learner,
            watch,
        )
    }
}

/// Every frame's cloud with its tokens' centres and neighbours, found by `threads` threads. The
/// order is that of the frames, whatever the threads do.
fn all_clouds(
    clouds: &[Vec<Point>],
    config: &ActPcConfig,
    threads: usize,
    device: Device,
) -> Result<Clouds, TrainError> {
    let share = clouds.len().div_ceil(threads.max(1)).max(1);
    let parts = std::thread::scope(|scope| {
        let workers: Vec<_> = clouds
            .chunks(share)
            .map(|part| {
                scope.spawn(move || {
                    let part: Vec<&[Point]> = part.iter().map(Vec::as_slice).collect();
                    Clouds::new(&part, config, Device::Cpu)
                })
            })
            .collect();
        let joined = workers.into_iter().map(|worker| {
            worker
                .join()
                .map_err(|_| TrainError::Dataset("a thread failed".to_owned()))?
                .map_err(|error| match error {
                    CloudsError::Torch(error) => TrainError::Torch(error),
                    CloudsError::Count { .. } | CloudsError::Perception(_) => {
                        TrainError::Dataset(error.to_string())
                    }
                })
        });
        joined.collect::<Result<Vec<Clouds>, TrainError>>()
    })?;
    let join = |of: fn(&Clouds) -> &Tensor| {
        let parts: Vec<&Tensor> = parts.iter().map(of).collect();
        Tensor::f_cat(&parts, 0)?.f_to_device(device)
    };
    Ok(Clouds {
        points: join(|part| &part.points)?,
        centres: join(|part| &part.centres)?,
        neighbours: join(|part| &part.neighbours)?,
    })
}

/// A run in progress: everything on the training device.
struct Run {
    network: ActPc,
    /// `(frames, ..)`, of all frames.
    clouds: Clouds,
    /// `(frames, state)`, normalised.
    states: Tensor,
    /// `(frames, steps, action)`, normalised.
    actions: Tensor,
    /// `(frames, steps)`, true past the end of the episode.
    is_pad: Tensor,
    augmentation: Augmentation,
}

/// What a step sees.
struct Batch {
    clouds: Clouds,
    state: Tensor,
    actions: Tensor,
    is_pad: Tensor,
}

impl Run {
    /// The frames `indices` `(batch)` of all that is on the device.
    fn batch(&self, indices: &Tensor) -> Result<Batch, TchError> {
        let of = |tensor: &Tensor| tensor.f_index_select(0, indices);
        Ok(Batch {
            clouds: Clouds {
                points: of(&self.clouds.points)?,
                centres: of(&self.clouds.centres)?,
                neighbours: of(&self.clouds.neighbours)?,
            },
            state: of(&self.states)?,
            actions: of(&self.actions)?,
            is_pad: of(&self.is_pad)?,
        })
    }
}

impl Learner for Run {
    fn inputs(&self, frames: &[usize], _random: &mut SplitMix64) -> Result<Vec<Tensor>, TchError> {
        Ok(vec![index_tensor(frames, self.states.device())?])
    }

    fn losses(&self, inputs: &[Tensor]) -> Result<Losses<'_>, TchError> {
        let mut batch = self.batch(&inputs[0])?;
        // A hidden point may be a token's centre, so that all stay.
        let points = batch.clouds.points.shallow_clone();
        batch.clouds.points = augment::points(points, &self.augmentation, None, false)?;
        let state = batch.state.shallow_clone();
        batch.state = augment::state(state, &self.augmentation)?;
        let noise = Tensor::f_randn(
            [batch.state.size()[0], self.network.config().act.latent_dim],
            (Kind::Float, batch.state.device()),
        )?;
        let (actions, is_pad) = (&batch.actions, &batch.is_pad);
        let demonstration = Demonstration {
            actions,
            is_pad,
            noise: &noise,
        };
        let (predicted, latent) =
            self.network
                .train(&batch.clouds, &batch.state, &demonstration)?;
        let parts = self
            .network
            .losses(&predicted, latent.as_ref(), actions, is_pad)?;
        Ok(Losses {
            total: parts.total,
            l1: parts.action,
            kl: parts.kl,
            below: None,
        })
    }

    fn error(&self, frames: &[usize]) -> Result<f64, TchError> {
        let batch = self.batch(&index_tensor(frames, self.states.device())?)?;
        let predicted = self.network.infer(&batch.clouds, &batch.state)?;
        let denominator = LossDenominator::Valid;
        l1_loss(denominator, &predicted, &batch.actions, &batch.is_pad)?.f_double_value(&[])
    }
}
