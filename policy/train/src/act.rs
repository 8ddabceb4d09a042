//! Training of ACT from images.
//!
//! A step: indices of frames and draws for their images go to the device; there bytes are shifted,
//! normalised, recoloured and go through backbone and transformer; the loss's gradient goes back
//! through all of it, in bfloat16 on CUDA through the backbone by kernels of our own.

use tch::{Device, Kind, TchError, Tensor};

use super::augment;
use super::flat::{BackwardFn, ManualBackward};
use super::options::{TrainOptions, TrainPrecision};
use super::steps::{Learner, Losses, Split};
use super::trained::{Network, Prepared, Trained, check_arms, refuse};
use super::training_set::{TrainingSet, index_tensor};
use super::transfer::send;
use super::{AnyTrained, Progress, TrainError, Trainer, TrainingObserver};
use hal::random::SplitMix64;
use trocar_data::dataset::Dataset;
use trocar_nets::act::{Act, ActConfig, Demonstration, LossDenominator, l1_loss, losses};
use trocar_nets::checkpoint::FeatureStatistics;
use trocar_nets::kernels::Kernels;
use trocar_nets::normalise::ImageNormaliser;
use trocar_nets::parameters::{ParameterError, ParameterSource};

/// Frames whose images give a frozen batch normalisation its statistics, in a training from
/// scratch. Evenly spread over those that are trained on.
const STATISTICS_FRAMES: usize = 32;

impl Network for Act {
    type Config = ActConfig;
    type Statistics = FeatureStatistics;

    fn build(config: ActConfig, source: ParameterSource) -> Result<Self, ParameterError> {
        Self::new(config, source)
    }

    fn any(trained: Trained<Self>) -> AnyTrained {
        AnyTrained::Act(trained.into())
    }
}

impl Trainer {
    /// Trains the network `config` on `dataset` from a fresh start.
    ///
    /// Cameras of the configuration must be the dataset's, in its order, and its widths those of
    /// the dataset's arms. `watch` gets the number of decoded frames and every row of the loss
    /// curve. On the CPU two runs with the same options give the same bits; on CUDA they need not.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn run(
        &self,
        config: &ActConfig,
        options: &TrainOptions,
        dataset: &Dataset,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Trained<Act>, TrainError> {
        refuse(options.defect().or_else(|| config.defect()))?;
        check_cameras(config, dataset)?;
        check_arms([config.state_dim, config.action_dim], dataset.arms())?;
        self.begin(options);
        let set = TrainingSet::new(dataset, config, options, self.device, &mut |frames| {
            let of = dataset.len();
            watch.progress(&Progress::Read { frames, of });
        })?;
        let prepared = Prepared {
            split: Split {
                trained: &set.trained,
                held_out: &set.held_out,
            },
            cloud: None,
            features: [&set.statistics.state, &set.statistics.action],
            statistics: &set.statistics,
        };
        let images = ImageNormaliser::imagenet(self.device)?;
        let fresh = self.fresh(config, options, || {
            let frames = spread(&set.trained, STATISTICS_FRAMES);
            let (indices, sent) = (
                index_tensor(&frames, self.device)?,
                set.images.sent(&frames)?,
            );
            let bytes = set.images.batch(&indices, sent.as_ref())?;
            images.apply(&bytes)?.f_to_device(Device::Cpu)
        })?;
        let kernels = self.kernels(options, watch);
        let learner = |act| {
            Ok(Run {
                act,
                images,
                kernels,
                options,
                set: &set,
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

    /// Kernels of our own for the backbone, where there are some.
    ///
    /// None for another device or precision, and where they can't be compiled, which `watch` gets
    /// as [`Progress::Slower`].
    fn kernels(&self, options: &TrainOptions, watch: &mut dyn TrainingObserver) -> Option<Kernels> {
        if !self.device.is_cuda() || options.precision != TrainPrecision::Bf16 {
            return None;
        }
        match Kernels::new(self.device) {
            Ok(kernels) => Some(kernels),
            Err(error) => {
                let reason = error.to_string();
                watch.progress(&Progress::Slower { reason });
                None
            }
        }
    }
}

/// At most `count` of `frames`, evenly spread.
fn spread(frames: &[usize], count: usize) -> Vec<usize> {
    frames
        .iter()
        .copied()
        .step_by(frames.len().div_ceil(count).max(1))
        .collect()
}

/// The dataset must have the network's cameras, in the same order.
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

/// A run in progress.
struct Run<'a> {
    act: Act,
    images: ImageNormaliser,
    /// None where the library differentiates the backbone too.
    kernels: Option<Kernels>,
    options: &'a TrainOptions,
    /// All frames; batches are picked from it on the device.
    set: &'a TrainingSet,
}

impl Learner for Run<'_> {
    fn announce(&self, frames: &[usize]) {
        self.set.images.announce(frames);
    }

    /// Indices, what is drawn for the images, and the images that the device has not.
    fn inputs(&self, frames: &[usize], random: &mut SplitMix64) -> Result<Vec<Tensor>, TchError> {
        let drawn = augment::drawn(frames.len(), &self.options.augmentation, random)?;
        let indices = index_tensor(frames, self.set.device())?;
        let mut inputs = vec![indices, send(&drawn, self.set.device())?];
        inputs.extend(self.set.images.sent(frames)?);
        Ok(inputs)
    }

    fn losses(&self, inputs: &[Tensor]) -> Result<Losses<'_>, TchError> {
        let [indices, drawn, sent @ ..] = inputs else {
            return Err(TchError::Shape(format!("{} inputs", inputs.len())));
        };
        let batch = self.set.batch(indices, sent.first())?;
        let (config, augmentation) = (self.act.config(), &self.options.augmentation);
        let bytes = augment::shifted(batch.images, augmentation, drawn)?;
        let images = augment::coloured(self.images.apply(&bytes)?, augmentation, drawn)?;
        let state = augment::state(batch.state, augmentation)?;
        let noise = Tensor::f_randn(
            [state.size()[0], config.latent_dim],
            (Kind::Float, state.device()),
        )?;
        let demonstration = Demonstration {
            actions: &batch.actions,
            is_pad: &batch.is_pad,
            noise: &noise,
        };
        let (predicted, latent, below) = match &self.kernels {
            None => {
                let (predicted, latent) = self.act.train(&images, &state, &demonstration)?;
                (predicted, latent, None)
            }
            Some(kernels) => {
                let (features, kept) = self.act.features_by_hand(kernels, &images)?;
                let gave = features.f_detach()?.f_set_requires_grad(true)?;
                let (predicted, latent) = self.act.train_on(&gave, &state, &demonstration)?;
                let back: BackwardFn<'_> = Box::new(move |gradient| {
                    self.act.features_back_by_hand(kernels, gradient, &kept)
                });
                (predicted, latent, Some(ManualBackward { gave, back }))
            }
        };
        let parts = losses(
            config,
            &predicted,
            latent.as_ref(),
            &batch.actions,
            &batch.is_pad,
        )?;
        Ok(Losses {
            total: parts.total,
            l1: parts.l1,
            kl: parts.kl,
            below,
        })
    }

    /// By inference: no augmentation, no dropout, latent zero, only steps within the episode.
    fn error(&self, frames: &[usize]) -> Result<f64, TchError> {
        let indices = index_tensor(frames, self.set.device())?;
        let sent = self.set.images.sent(frames)?;
        let batch = self.set.batch(&indices, sent.as_ref())?;
        let images = self.images.apply(&batch.images)?;
        let predicted = self.act.infer(&images, &batch.state)?;
        let l1 = l1_loss(
            LossDenominator::Valid,
            &predicted,
            &batch.actions,
            &batch.is_pad,
        )?;
        l1.f_double_value(&[])
    }
}
