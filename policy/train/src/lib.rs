#![doc = include_str!("../README.md")]

mod act_pc;
#[cfg(test)]
mod act_pc_tests;
mod augment;
mod backbone;
#[cfg(test)]
mod backbone_tests;
mod cloud_set;
mod curve;
mod dp3;
#[cfg(test)]
mod dp3_tests;
mod error;
mod flat;
mod frame_images;
mod frame_order;
mod options;
mod plot;
mod recipes;
#[cfg(test)]
mod resume_tests;
mod run_state;
mod steps;
#[cfg(test)]
mod tests;
mod told;
mod training_set;

use serde::Serialize;
use tch::{Device, Kind, TchError, Tensor};

pub use act_pc::TrainedActPc;
pub use curve::{CurveRow, LossCurve};
pub use dp3::TrainedDp3;
pub use error::TrainError;
pub use options::{Augmentation, Schedule, TrainOptions, TrainPrecision};
pub use run_state::RunState;

use flat::FlatParameters;
use hal::random::SplitMix64;
use steps::{Back, Below, Learner, Losses, Split, Steps};
use training_set::{TrainingSet, index_tensor, send};
use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_nets::act::{Act, ActConfig, Demonstration, LossDenominator, l1_loss, losses};
use trocar_nets::checkpoint::{BackboneWeights, FeatureStatistics};
use trocar_nets::kernels::Kernels;
use trocar_nets::normalise::{ImageNormaliser, Statistics};
use trocar_nets::parameters::ParameterSource;
use trocar_nets::recorded::{allow_tf32_products, sleep_while_waiting};

/// Where a run stands.
#[derive(Clone, Debug)]
pub enum Progress {
    /// Frames are being decoded.
    Read {
        /// Frames done.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
    },
    /// Clouds are made; in some frames nothing wanted was in view, and their clouds lie at the origin.
    Unseen {
        /// Frames without a point.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
    },
    /// The steps begin.
    Begin {
        /// Steps taken before, by the run that this one goes on with.
        step: u64,
        /// Steps of the whole run.
        steps: u64,
    },
    /// A step was taken that the watcher wants to hear of: see [`Watch::wants_step`].
    Step {
        /// Steps done.
        step: u64,
        /// Steps of the whole run.
        steps: u64,
        /// What is minimised, of this step alone.
        loss: f64,
    },
    /// Steps take longer than they could.
    Slower {
        /// Why.
        reason: String,
    },
    /// A row of the loss curve is there.
    Row {
        /// Steps of the whole run.
        steps: u64,
        /// The newest row.
        row: CurveRow,
    },
}

/// Who watches a run. A function of [`Progress`] is one that never stops it and keeps nothing.
pub trait Watch {
    /// Hears where the run stands.
    fn progress(&mut self, progress: &Progress);

    /// Whether it wants to hear of the step after which `step` are done; asked after every step. Its loss is then waited for,
    /// which holds up a device whose work is queued ahead.
    fn wants_step(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Whether it wants the network as it is after `step` steps; asked after every step, and where a run is gone on with.
    fn wants_network(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Gets what the run would come to if it ended after `step` steps. The run goes on to the same bits whatever is done with it,
    /// provided that the network library's number of threads is left as it was.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn network(&mut self, step: u64, trained: AnyTrained) -> Result<(), TrainError> {
        drop((step, trained));
        Ok(())
    }

    /// Whether the run should keep its state and stop; asked after every step.
    fn wants_stop(&mut self) -> bool {
        false
    }

    /// Keeps the state, every [`TrainOptions::save_every`] steps and when the run is stopped.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn keep(&mut self, state: RunState) -> Result<(), TrainError> {
        drop(state);
        Ok(())
    }
}

impl<F: FnMut(&Progress)> Watch for F {
    fn progress(&mut self, progress: &Progress) {
        self(progress);
    }
}

/// What must be the same in a run that goes on with another one's state, as JSON.
fn run_of(
    config: &impl Serialize,
    cloud: Option<&CloudRecipe>,
    options: &TrainOptions,
    trained: &[usize],
    [state, action]: [&Statistics; 2],
) -> String {
    let dataset = serde_json::json!({
        "frames": trained.len(),
        "state": [state.mean, state.std],
        "action": [action.mean, action.std],
    });
    // Where images lie and how often the state is kept changes no number.
    let options = TrainOptions {
        images_on_host: false,
        save_every: 0,
        ..*options
    };
    serde_json::json!({
        "network": config,
        "cloud": cloud,
        "options": options,
        "dataset": dataset,
    })
    .to_string()
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

/// The outcome of a run of any network.
#[derive(Debug)]
pub enum AnyTrained {
    /// ACT.
    Act(Box<Trained>),
    /// ACT-PC.
    ActPc(Box<TrainedActPc>),
    /// DP3.
    Dp3(Box<TrainedDp3>),
}

impl AnyTrained {
    /// The losses along the way.
    #[must_use]
    pub const fn curve(&self) -> &LossCurve {
        match self {
            Self::Act(trained) => &trained.curve,
            Self::ActPc(trained) => &trained.curve,
            Self::Dp3(trained) => &trained.curve,
        }
    }

    /// Frames trained on.
    #[must_use]
    pub const fn frames(&self) -> usize {
        match self {
            Self::Act(trained) => trained.frames,
            Self::ActPc(trained) => trained.frames,
            Self::Dp3(trained) => trained.frames,
        }
    }
}

/// Trains networks on one device.
#[derive(Debug)]
pub struct Trainer {
    device: Device,
    from: Option<RunState>,
    backbone: Option<BackboneWeights>,
}

impl Trainer {
    /// A trainer on `device`.
    #[must_use]
    pub const fn new(device: Device) -> Self {
        Self {
            device,
            from: None,
            backbone: None,
        }
    }

    /// The same, but that a run goes on from `state` instead of starting: on the CPU, and with the same options, dataset and
    /// number of threads, to the same bits as one that was never stopped.
    #[must_use]
    pub fn resuming(self, state: RunState) -> Self {
        Self {
            from: Some(state),
            ..self
        }
    }

    const fn device(&self) -> Device {
        self.device
    }

    /// Sets what the network library keeps for the whole process: threads, and on CUDA that it may try which kernels are
    /// the fastest (every step has the same shapes) and that matrix products of single precision are TF32, as convolutions are. Waiting
    /// takes no core from other trainings.
    fn begin(&self, options: &TrainOptions) {
        tch::set_num_threads(i32::try_from(options.threads.max(1)).unwrap_or(1));
        if self.device.is_cuda() {
            sleep_while_waiting();
            allow_tf32_products();
            tch::Cuda::cudnn_set_benchmark(true);
        }
    }

    /// Kernels of our own for the backbone, where there are some.
    fn kernels(&self, options: &TrainOptions, watch: &mut dyn Watch) -> Option<Kernels> {
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

    /// Trains the network `config` on `dataset` from a fresh start.
    ///
    /// Cameras of the configuration must be the dataset's, in its order, and its widths those of the dataset's arms.
    /// `watch` hears of decoded frames and of every row of the loss curve.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn run(
        &self,
        config: &ActConfig,
        options: &TrainOptions,
        dataset: &Dataset,
        watch: &mut dyn Watch,
    ) -> Result<Trained, TrainError> {
        if let Some(defect) = options.defect().or_else(|| config.defect()) {
            return Err(TrainError::Options(defect));
        }
        check_cameras(config, dataset)?;
        check_arms(config, dataset.arms())?;
        self.begin(options);
        let set = TrainingSet::new(dataset, config, options, self.device, &mut |frames| {
            let of = dataset.len();
            watch.progress(&Progress::Read { frames, of });
        })?;
        let fresh = self.fresh(config, options)?;
        let mut flat = FlatParameters::new(fresh.parameters(), self.device, options)?;
        let working = ParameterSource::given(flat.working_tensors());
        let run = Run {
            act: Act::new(config.clone(), working)?,
            images: ImageNormaliser::imagenet(self.device)?,
            kernels: self.kernels(options, watch),
            options,
            set: &set,
        };
        let statistics = [&set.statistics.state, &set.statistics.action];
        let trained = |flat: &FlatParameters, curve: LossCurve| {
            let averaged = ParameterSource::given(flat.averaged_tensors()?);
            Ok::<_, TrainError>(Trained {
                act: Act::new(config.clone(), averaged)?,
                frames: set.trained.len(),
                statistics: set.statistics.clone(),
                curve,
            })
        };
        let steps = Steps {
            learner: &run,
            options,
            split: Split {
                trained: &set.trained,
                held_out: &set.held_out,
            },
            run: run_of(config, None, options, &set.trained, statistics),
            so_far: &|flat, curve| Ok(AnyTrained::Act(trained(flat, curve)?.into())),
        };
        let curve = steps.take(&mut flat, self.from.as_ref(), watch)?;
        trained(&flat, curve)
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
    kernels: Option<Kernels>,
    options: &'a TrainOptions,
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
                let back: Back<'_> = Box::new(move |gradient| {
                    self.act.features_back_by_hand(kernels, gradient, &kept)
                });
                (predicted, latent, Some(Below { gave, back }))
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
