//! Options of a training run, and a preset for each network.
//!
//! `recipes` has the presets; the command line starts from one and changes single options. A
//! checkpoint's `trocar.json` keeps them, all but `eager`.

use serde::{Deserialize, Serialize};

/// Samples that a step may have: more than any device has room for, and few enough to be counted.
const BATCH_MAX: usize = 1 << 16;
/// The most threads.
const THREADS_MAX: usize = 1024;
/// Pixels by which images are shifted at most: no image is larger.
const SHIFT_PX_MAX: u32 = 4096;

/// Number format of the forward and backward pass; the master copy of the weights is always single
/// precision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrainPrecision {
    /// 32 bits; on CUDA the factors of convolutions and matrix products are rounded to TF32.
    #[default]
    F32,
    /// 16 bits with the range of 32; for accelerators.
    Bf16,
}

/// How the learning rate runs after the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Schedule {
    /// It stays.
    Constant,
    /// It falls to a hundredth along half a cosine.
    #[default]
    Cosine,
    /// It falls to nothing along half a cosine.
    CosineToZero,
    /// It rises from a hundredth over a tenth of the steps and falls to a hundred-thousandth, both
    /// along half a cosine; there is no other warm-up. PyTorch's `OneCycleLR` with
    /// PointCloudMatters' numbers.
    OneCycle,
}

/// Random changes of what is trained on, each frame its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Augmentation {
    /// Greatest shift in either direction, pixels of the network's image; edges repeat. 0 is off.
    pub shift_px: u32,
    /// Greatest relative change of brightness. 0 is off.
    pub brightness: f64,
    /// Greatest relative change of contrast about the image's mean. 0 is off.
    pub contrast: f64,
    /// Standard deviation of noise on the normalised state. 0 is off.
    pub state_noise: f64,
    /// Standard deviation of noise on every coordinate of a point, m. 0 is off.
    pub point_noise_m: f64,
    /// Share of a cloud's points that are hidden: the first takes their place, which a maximum does
    /// not see. 0 is off.
    pub point_dropout: f64,
}

/// All options of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainOptions {
    /// Optimiser steps.
    pub steps: u64,
    /// Frames in a batch.
    pub batch: usize,
    /// Learning rate of everything but the backbone.
    pub lr: f64,
    /// Learning rate of the backbone.
    pub lr_backbone: f64,
    /// How much of the gradients' mean stays at a step.
    pub beta_1: f64,
    /// Weight decay (decoupled).
    ///
    /// AdamW's: it shrinks the weight itself, times the learning rate, and not through the
    /// gradient.
    pub weight_decay: f64,
    /// Steps over which the learning rate rises from 0.
    pub warm_up_steps: u64,
    /// How it runs from there.
    pub schedule: Schedule,
    /// Greatest norm of the gradient; longer ones are shortened to it. Infinite is off. Over all
    /// parameters together.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights, which is what is kept at the end. 0 keeps the
    /// last weights.
    pub ema_decay: f64,
    /// How the decay grows to its greatest: DP3's `1 - n^-power` after `n` updates; 0 is `(1 + n) /
    /// (10 + n)`.
    pub ema_power: f64,
    /// Share of the episodes, the last ones, that is held out for validation. 0 is none.
    pub validation_share: f64,
    /// Steps between two rows of the loss curve.
    pub log_every: u64,
    /// Steps between two times that the state is kept, so that the run can go on from there. 0 is
    /// never.
    pub save_every: u64,
    /// Number format of the passes.
    pub precision: TrainPrecision,
    /// Random changes of the images.
    pub augmentation: Augmentation,
    /// Keep the images in the host's memory and send each step's ahead of it, for what the device
    /// has no room for.
    pub images_on_host: bool,
    /// Launch the kernels of every step one by one, instead of capturing a step as a CUDA graph
    /// after the first few and replaying it.
    #[serde(skip)]
    pub eager: bool,
    /// Threads that decode images, and that compute if training is on the CPU.
    pub threads: usize,
    /// The seed of everything random.
    pub seed: u64,
}

impl TrainOptions {
    /// What makes these options impossible, if anything does.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        self.range_defect().or_else(|| self.count_defect())
    }

    /// The first number outside of its range: keys, values, least and greatest.
    fn range_defect(&self) -> Option<String> {
        let of = &self.augmentation;
        let ranges = [
            ("lr", self.lr, 0.0, 1.0),
            ("lr_backbone", self.lr_backbone, 0.0, 1.0),
            ("weight_decay", self.weight_decay, 0.0, 1.0),
            ("clip_norm", self.clip_norm, 1e-6, f64::INFINITY),
            ("beta_1", self.beta_1, 0.0, 0.999_999),
            ("ema_decay", self.ema_decay, 0.0, 0.999_999),
            ("ema_power", self.ema_power, 0.0, 1.0),
            ("validation_share", self.validation_share, 0.0, 0.9),
            ("augmentation.brightness", of.brightness, 0.0, 1.0),
            ("augmentation.contrast", of.contrast, 0.0, 1.0),
            ("augmentation.state_noise", of.state_noise, 0.0, 1.0),
            ("augmentation.point_noise_m", of.point_noise_m, 0.0, 0.1),
            ("augmentation.point_dropout", of.point_dropout, 0.0, 0.9),
        ];
        let mut ranges = ranges.into_iter();
        let outside = ranges.find(|(_, value, low, high)| !(*low..=*high).contains(value));
        outside
            .map(|(name, value, low, high)| format!("{name} = {value} is outside [{low}, {high}]"))
    }

    /// The first count that is too large or zero.
    fn count_defect(&self) -> Option<String> {
        for (name, value, most) in [
            ("batch", self.batch, BATCH_MAX),
            ("threads", self.threads, THREADS_MAX),
        ] {
            if value > most {
                return Some(format!("{name} = {value} is outside [1, {most}]"));
            }
        }
        if self.augmentation.shift_px > SHIFT_PX_MAX {
            let pixels = self.augmentation.shift_px;
            return Some(format!(
                "augmentation.shift_px = {pixels} is outside [0, {SHIFT_PX_MAX}]"
            ));
        }
        let positive = [
            ("batch", self.batch == 0),
            ("steps", self.steps == 0),
            ("log_every", self.log_every == 0),
        ];
        positive
            .iter()
            .find(|(_, zero)| *zero)
            .map(|(name, _)| format!("{name} = 0 is no positive number"))
    }

    /// The factor on both learning rates at `step`, from 0.
    ///
    /// In the warm-up `(step + 1) / warm_up_steps`; then by the schedule, over the steps that are
    /// left ([`Schedule::OneCycle`]: over all steps).
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    pub fn lr_factor(&self, step: u64) -> f64 {
        if step < self.warm_up_steps {
            return (step + 1) as f64 / self.warm_up_steps as f64;
        }
        match self.schedule {
            Schedule::OneCycle => self.one_cycle(step),
            Schedule::Constant => 1.0,
            Schedule::Cosine => 0.01 + 0.99 * self.cosine(step),
            Schedule::CosineToZero => self.cosine(step),
        }
    }
}

impl TrainOptions {
    /// See [`Schedule::OneCycle`].
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    fn one_cycle(&self, step: u64) -> f64 {
        let last = self.steps.saturating_sub(1).max(1) as f64;
        let peak = (0.1 * self.steps as f64 - 1.0).max(0.0);
        let step = step as f64;
        let (from, to, share) = if step <= peak {
            (0.01, 1.0, step / peak.max(1e-9))
        } else {
            (1.0, 1e-5, (step - peak) / (last - peak).max(1e-9))
        };
        to + 0.5 * (from - to) * (1.0 + (core::f64::consts::PI * share.min(1.0)).cos())
    }

    /// Half a cosine from 1 at the end of the warm-up to 0 at the last step.
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    fn cosine(&self, step: u64) -> f64 {
        let span = self.steps.saturating_sub(self.warm_up_steps).max(1) as f64;
        let share = (step.saturating_sub(self.warm_up_steps) as f64 / span).min(1.0);
        0.5 * (1.0 + (core::f64::consts::PI * share).cos())
    }
}

#[cfg(test)]
mod tests {
    use super::TrainOptions;
    use trocar_nets::act::ActPreset;

    #[test]
    fn learning_rate_rises_then_falls_to_a_hundredth() {
        let options = TrainOptions::preset(ActPreset::Small);
        assert!((options.lr_factor(0) - 1.0 / 500.0).abs() < 1e-12);
        assert!((options.lr_factor(500) - 1.0).abs() < 1e-12);
        assert!((options.lr_factor(options.steps) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn one_cycle_is_the_library_s() {
        let options = TrainOptions {
            steps: 1000,
            ..TrainOptions::point_cloud_matters()
        };
        // torch.optim.lr_scheduler.OneCycleLR(max_lr=1, total_steps=1000, pct_start=0.1,
        // div_factor=100, final_div_factor=1000).
        let library = [
            (0, 0.01),
            (50, 0.512_853_652_098_23),
            (99, 1.0),
            (100, 0.999_996_953_859_356_9),
            (549, 0.500_005),
            (999, 1e-5),
        ];
        for (step, factor) in library {
            let error = (options.lr_factor(step) - factor).abs();
            assert!(error < 1e-9, "step {step}: off by {error:e}");
        }
    }

    #[test]
    fn impossible_options_are_named() {
        let good = TrainOptions::preset(ActPreset::Paper);
        assert_eq!(good.defect(), None);
        assert!(
            TrainOptions {
                lr: f64::NAN,
                ..good
            }
            .defect()
            .unwrap()
            .starts_with("lr =")
        );
        for (options, defect) in [
            (TrainOptions { batch: 0, ..good }, "batch = 0"),
            (
                TrainOptions {
                    batch: usize::MAX,
                    ..good
                },
                "batch = 18446744073709551615 is outside [1, 65536]",
            ),
            (
                TrainOptions {
                    threads: 1 << 40,
                    ..good
                },
                "threads = 1099511627776 is outside [1, 1024]",
            ),
        ] {
            let found = options.defect().unwrap();
            assert!(found.starts_with(defect), "{found}");
        }
    }
}
