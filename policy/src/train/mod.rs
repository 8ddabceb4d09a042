//! Training of ACT on recorded demonstrations.
//!
//! Everything is decoded once and kept on the training device; a step draws frames, not episodes. On the CPU, with one
//! seed and one number of threads, two runs give the same bits, provided that nothing else in the process draws from
//! the network library's random numbers meanwhile (dropout and the latent do).

mod augment;
mod curve;
mod error;
mod flat;
mod frame_order;
mod options;
#[cfg(test)]
mod tests;
mod training_set;

use tch::{Device, Kind, TchError, Tensor};

pub use curve::{CurveRow, LossCurve};
pub use error::TrainError;
pub use options::{Augmentation, Schedule, TrainOptions, TrainPrecision};

use crate::act::{Act, ActConfig, Demonstration, LossDenominator, l1_loss, losses};
use crate::checkpoint::FeatureStatistics;
use crate::dataset::Dataset;
use crate::normalise::ImageNormaliser;
use crate::parameters::ParameterSource;
use crate::rng::SplitMix64;
use flat::FlatParameters;
use frame_order::FrameOrder;
use training_set::{Batch, TrainingSet};

/// Where a run stands, once a row of the loss curve.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Steps of the whole run.
    pub steps: u64,
    /// The newest row.
    pub row: CurveRow,
}

impl Progress {
    /// Time that is left, given the time that steps have taken so far, seconds.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    pub fn seconds_left(&self, seconds_so_far: f64) -> f64 {
        let done = self.row.step.max(1) as f64;
        seconds_so_far * (self.steps as f64 - done).max(0.0) / done
    }
}

/// The outcome of a run.
#[derive(Debug)]
pub struct Trained {
    /// The network with averaged weights, on the training device.
    pub act: Act,
    /// Statistics of the frames trained on.
    pub statistics: FeatureStatistics,
    /// The losses along the way.
    pub curve: LossCurve,
    /// Frames trained on.
    pub frames: usize,
}

/// Trains networks on one device.
#[derive(Clone, Copy, Debug)]
pub struct Trainer {
    device: Device,
}

impl Trainer {
    /// A trainer on `device`.
    #[must_use]
    pub const fn new(device: Device) -> Self {
        Self { device }
    }

    /// Trains the network `config` on `dataset` from a fresh start.
    ///
    /// Cameras of the configuration must be the dataset's, in its order, and its widths those of the dataset's arms.
    /// `on_progress` hears of every row of the loss
    /// curve.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn run(
        &self,
        config: &ActConfig,
        options: &TrainOptions,
        dataset: &Dataset,
        on_progress: &mut dyn FnMut(&Progress),
    ) -> Result<Trained, TrainError> {
        if let Some(defect) = options.defect().or_else(|| config.defect()) {
            return Err(TrainError::Options(defect));
        }
        check_cameras(config, dataset)?;
        check_arms(config, dataset.arms())?;
        tch::set_num_threads(i32::try_from(options.threads.max(1)).unwrap_or(1));
        tch::manual_seed(options.seed.cast_signed());
        let set = TrainingSet::new(
            dataset,
            config,
            options.validation_share,
            options.threads,
            self.device,
        )?;
        let fresh = Act::new(
            config.clone(),
            ParameterSource::seeded(options.seed, Device::Cpu),
        )?;
        let mut flat = FlatParameters::new(fresh.parameters(), self.device, options)?;
        let working = ParameterSource::given(flat.working_tensors(fresh.parameters())?);
        let run = Run {
            act: Act::new(config.clone(), working)?,
            images: ImageNormaliser::imagenet(self.device)?,
            options,
            set: &set,
        };
        let curve = run.all_steps(&mut flat, on_progress)?;
        let averaged = ParameterSource::given(flat.averaged_tensors(fresh.parameters())?);
        let act = Act::new(config.clone(), averaged)?;
        Ok(Trained {
            act,
            frames: set.trained.len(),
            statistics: set.statistics,
            curve,
        })
    }
}

fn check_cameras(config: &ActConfig, dataset: &Dataset) -> Result<(), TrainError> {
    let recorded: Vec<String> = dataset
        .camera_names()
        .iter()
        .map(|name| format!("observation.images.{name}"))
        .collect();
    if recorded == config.cameras {
        return Ok(());
    }
    Err(TrainError::Dataset(format!(
        "it has the cameras {recorded:?}, the network {:?}",
        config.cameras
    )))
}

fn check_arms(config: &ActConfig, arms: usize) -> Result<(), TrainError> {
    let fitting = config.clone().for_arms(arms);
    if *config == fitting {
        return Ok(());
    }
    Err(TrainError::Dataset(format!(
        "it has {arms} arms, {} numbers of state and of action, the network {} and {}",
        fitting.state_dim, config.state_dim, config.action_dim
    )))
}

/// A run in progress.
struct Run<'a> {
    act: Act,
    images: ImageNormaliser,
    options: &'a TrainOptions,
    set: &'a TrainingSet,
}

impl Run<'_> {
    fn all_steps(
        &self,
        flat: &mut FlatParameters,
        on_progress: &mut dyn FnMut(&Progress),
    ) -> Result<LossCurve, TrainError> {
        let options = self.options;
        let mut random = SplitMix64::named("train", options.seed);
        let mut order = FrameOrder::new(&self.set.trained);
        let mut curve = LossCurve::default();
        let mut since_row = Vec::new();
        for step in 0..options.steps {
            let batch = self.set.batch(&order.next(options.batch, &mut random))?;
            let factor = options.lr_factor(step);
            since_row.push(self.step(&batch, factor, flat, &mut random)?);
            let done = step + 1;
            if done.is_multiple_of(options.log_every) || done == options.steps {
                let means = Tensor::f_stack(&since_row, 0)?.f_mean_dim(
                    [0].as_slice(),
                    false,
                    Kind::Double,
                )?;
                let means = Vec::<f64>::try_from(&means)?;
                since_row.clear();
                let [loss, l1, kl, gradient_norm] = [means[0], means[1], means[2], means[3]];
                if !(loss.is_finite() && gradient_norm.is_finite()) {
                    return Err(TrainError::Diverged { step: done, loss });
                }
                let validation_l1 = self.validate()?;
                let row = CurveRow {
                    step: done,
                    loss,
                    l1,
                    kl,
                    gradient_norm,
                    lr: options.lr * factor,
                    validation_l1,
                };
                curve.rows.push(row);
                on_progress(&Progress {
                    steps: options.steps,
                    row,
                });
            }
        }
        Ok(curve)
    }

    /// One step; loss, its parts and the gradient's norm in one tensor, not yet waited for.
    fn step(
        &self,
        batch: &Batch,
        lr_factor: f64,
        flat: &mut FlatParameters,
        random: &mut SplitMix64,
    ) -> Result<Tensor, TchError> {
        let config = self.act.config();
        let images = self.images.apply(&batch.images)?;
        let images = augment::images(images, &self.options.augmentation, random)?;
        let state = augment::state(batch.state.shallow_clone(), &self.options.augmentation)?;
        let noise = Tensor::f_randn(
            [state.size()[0], config.latent_dim],
            (Kind::Float, state.device()),
        )?;
        let demonstration = Demonstration {
            actions: &batch.actions,
            is_pad: &batch.is_pad,
            noise: &noise,
        };
        let (predicted, latent) = self.act.train(&images, &state, &demonstration)?;
        let parts = losses(
            config,
            &predicted,
            latent.as_ref(),
            &batch.actions,
            &batch.is_pad,
        )?;
        let lr = [
            self.options.lr_backbone * lr_factor,
            self.options.lr * lr_factor,
        ];
        let norm = flat.step(&parts.total, lr, self.options)?;
        Tensor::f_stack(
            &[
                parts.total.f_detach()?,
                parts.l1.f_detach()?,
                parts.kl.f_detach()?,
                norm,
            ],
            0,
        )
    }

    /// Mean absolute error of held-out frames as inference sees them, normalised; none without such frames. At most 256
    /// frames, evenly spread, by the weights as they are.
    fn validate(&self) -> Result<Option<f64>, TchError> {
        let held_out = &self.set.held_out;
        if held_out.is_empty() {
            return Ok(None);
        }
        let stride = held_out.len().div_ceil(256);
        let frames: Vec<usize> = held_out.iter().copied().step_by(stride).collect();
        tch::no_grad(|| {
            let (mut sum, mut parts) = (0.0, 0.0);
            for frames in frames.chunks(self.options.batch) {
                let batch = self.set.batch(frames)?;
                let predicted = self
                    .act
                    .infer(&self.images.apply(&batch.images)?, &batch.state)?;
                let l1 = l1_loss(
                    LossDenominator::Valid,
                    &predicted,
                    &batch.actions,
                    &batch.is_pad,
                )?;
                sum += l1.f_double_value(&[])?;
                parts += 1.0;
            }
            Ok(Some(sum / parts))
        })
    }
}
