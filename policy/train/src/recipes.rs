//! Recipes: what learns from scratch here, and what the networks' authors published.
//!
//! Source: reference note on policies, sections 2.1, 3.1, 4 and 5.7.

use super::options::{Augmentation, Schedule, TrainOptions, TrainPrecision};
use trocar_nets::act::ActPreset;
use trocar_nets::dp3::MovingAverage;

impl TrainOptions {
    /// What suits `preset` from scratch. The original's learning rates of 1e-5 are for a network
    /// whose backbone was trained before; here they are tenfold.
    ///
    /// AdamW with betas of 0.9 and 0.999, 500 steps of warm-up, half a cosine to a hundredth of the
    /// rate, gradients clipped at 10, a moving average with a decay of 0.999.
    #[must_use]
    pub const fn preset(preset: ActPreset) -> Self {
        let small = Self {
            steps: 10_000,
            batch: 64,
            lr: 1e-4,
            lr_backbone: 1e-4,
            beta_1: 0.9,
            weight_decay: 1e-4,
            warm_up_steps: 500,
            schedule: Schedule::Cosine,
            clip_norm: 10.0,
            ema_decay: 0.999,
            ema_power: 0.0,
            validation_share: 0.0,
            log_every: 50,
            save_every: 0,
            precision: TrainPrecision::F32,
            augmentation: Augmentation {
                shift_px: 0,
                brightness: 0.0,
                contrast: 0.0,
                state_noise: 0.0,
                point_noise_m: 0.0,
                point_dropout: 0.0,
            },
            images_on_host: false,
            eager: false,
            threads: 2,
            seed: 1000,
        };
        match preset {
            ActPreset::Small | ActPreset::Compact => small,
            ActPreset::Paper | ActPreset::Lerobot => Self {
                steps: 40_000,
                batch: 32,
                ..small
            },
        }
    }

    /// `preset`'s recipe as its authors have it, where they say. It is meant for a backbone that
    /// was trained on ImageNet ([`Trainer::starting_from`](super::Trainer::starting_from));
    /// [`Self::preset`] is what learns from scratch.
    ///
    /// The original's epochs take one frame of every episode: 2000 of them on 50 episodes are these
    /// steps.
    #[must_use]
    pub const fn published(preset: ActPreset) -> Self {
        let steps = match preset {
            ActPreset::Paper | ActPreset::Small | ActPreset::Compact => 10_000,
            ActPreset::Lerobot => 100_000,
        };
        let clip_norm = match preset {
            ActPreset::Paper | ActPreset::Small | ActPreset::Compact => f64::INFINITY,
            ActPreset::Lerobot => 10.0,
        };
        Self {
            steps,
            batch: 8,
            lr: 1e-5,
            lr_backbone: 1e-5,
            warm_up_steps: 0,
            schedule: Schedule::Constant,
            clip_norm,
            ema_decay: 0.0,
            ..Self::preset(preset)
        }
    }

    /// The same for a backbone that was trained elsewhere: it moves at the rate that the authors of
    /// ACT give it, 1e-5, or slower if it did.
    #[must_use]
    pub const fn for_trained_backbone(self) -> Self {
        Self {
            lr_backbone: self.lr_backbone.min(1e-5),
            ..self
        }
    }

    /// PointCloudMatters' recipe; its batches of 8, two to a step, are ones of 16. Its 500 epochs
    /// are steps that depend on the dataset, so that their number is [`Self::preset`]'s.
    #[must_use]
    pub const fn point_cloud_matters() -> Self {
        Self {
            batch: 16,
            lr: 5e-5,
            lr_backbone: 5e-5,
            weight_decay: 0.05,
            warm_up_steps: 0,
            schedule: Schedule::OneCycle,
            clip_norm: f64::INFINITY,
            ema_decay: 0.0,
            ..Self::preset(ActPreset::Paper)
        }
    }

    /// DP3's published recipe over `steps` steps; its own number of them is 3000 times the frames
    /// over the batch.
    #[must_use]
    pub const fn dp3(steps: u64) -> Self {
        Self {
            steps,
            batch: 128,
            beta_1: 0.95,
            weight_decay: 1e-6,
            schedule: Schedule::CosineToZero,
            clip_norm: f64::INFINITY,
            ema_decay: MovingAverage::DECAY_MAX,
            ema_power: MovingAverage::POWER,
            ..Self::preset(ActPreset::Small)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Schedule, TrainOptions};
    use trocar_nets::act::ActPreset;

    #[test]
    fn published_recipes_are_those_of_their_authors() {
        // Infinite is no clipping.
        let numbers = |options: TrainOptions| {
            format!(
                "batch {} lr {:e} {:e} beta {} decay {:e} clip {} average {} warm-up {}",
                options.batch,
                options.lr,
                options.lr_backbone,
                options.beta_1,
                options.weight_decay,
                options.clip_norm,
                options.ema_decay,
                options.warm_up_steps
            )
        };
        let act = TrainOptions::published(ActPreset::Paper);
        assert_eq!((act.steps, act.schedule), (10_000, Schedule::Constant));
        assert_eq!(
            numbers(act),
            "batch 8 lr 1e-5 1e-5 beta 0.9 decay 1e-4 clip inf average 0 warm-up 0"
        );
        let lerobot = TrainOptions::published(ActPreset::Lerobot);
        assert_eq!(
            (lerobot.steps, lerobot.schedule),
            (100_000, Schedule::Constant)
        );
        assert_eq!(
            numbers(lerobot),
            "batch 8 lr 1e-5 1e-5 beta 0.9 decay 1e-4 clip 10 average 0 warm-up 0"
        );
        assert_eq!(
            numbers(TrainOptions::point_cloud_matters()),
            "batch 16 lr 5e-5 5e-5 beta 0.9 decay 5e-2 clip inf average 0 warm-up 0"
        );
        let small = TrainOptions::preset(ActPreset::Small).for_trained_backbone();
        assert_eq!(
            numbers(small),
            "batch 64 lr 1e-4 1e-5 beta 0.9 decay 1e-4 clip 10 average 0.999 warm-up 500"
        );
        assert_eq!(act.for_trained_backbone(), act);
        let dp3 = TrainOptions::dp3(1000);
        assert_eq!(
            (dp3.schedule, dp3.ema_power.to_bits()),
            (Schedule::CosineToZero, 0.75_f64.to_bits())
        );
        assert_eq!(
            numbers(dp3),
            "batch 128 lr 1e-4 1e-4 beta 0.95 decay 1e-6 clip inf average 0.9999 warm-up 500"
        );
    }
}
