//! The options of `train`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::args::{ComputeDevice, TaskParser, count, delay, threads};

/// Networks that can be trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Network {
    /// Action chunking with transformers, from images.
    Act,
    /// Action chunking from point clouds; the dataset must be recorded with --depth.
    ActPc,
    /// Diffusion from point clouds; the dataset must be recorded with --depth.
    Dp3,
}

/// Hyperparameters: learning rates and schedules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum TrainingRecipe {
    /// What learns from scratch.
    Scratch,
    /// The authors' own.
    Published,
}

/// The normalisation layers of a backbone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(crate) enum Backbone {
    /// Trained with the rest, from random weights. LeRobot does not know it.
    GroupNorm,
    /// Batch normalisation whose statistics are fixed, as LeRobot's: those of --backbone-weights,
    /// or else of some images of the dataset before the first step.
    FrozenBatchNorm,
}

/// Options of `train`.
#[derive(Args, Debug)]
pub(crate) struct TrainArgs {
    /// The network.
    #[arg(long, value_enum, required_unless_present = "resume")]
    pub(crate) policy: Option<Network>,
    /// The dataset's directory. More than once: several datasets, such as demonstrations and
    /// interventions, are learned from as one, whose episodes are those of the first, then those of
    /// the next. They must agree in arms, fps, and the cameras that the network sees.
    #[arg(long, value_name = "DIR", required_unless_present = "resume")]
    pub(crate) data: Vec<PathBuf>,
    /// The checkpoint's directory; a new or an empty one.
    #[arg(long, required_unless_present = "resume")]
    pub(crate) out: Option<PathBuf>,
    /// Resume the training whose state is in this directory, with the options that it was begun
    /// with; only --json may go with it.
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = [
            "policy", "data", "out", "cameras", "preset", "recipe", "backbone", "backbone_weights", "steps", "batch",
            "device", "episodes", "validation_share", "bf16", "images_on_host", "eager", "threads", "augment", "query_every", "lr", "shift_px", "state_noise", "clouds", "save_every", "seed", "eval_every"
        ]
    )]
    pub(crate) resume: Option<PathBuf>,
    /// Checkpoint interval, steps: --resume goes on from the newest; 0 is never. An interrupted
    /// training keeps one too.
    #[arg(long, value_name = "STEPS", default_value_t = 10_000)]
    pub(crate) save_every: u64,
    /// Evaluate the weights every so many steps, and after the last one. Those that do best are
    /// kept in OUT/best, a checkpoint of its own (ties: the later ones); OUT itself gets the last
    /// ones. OUT/evaluations.csv has all.
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) eval_every: Option<u64>,
    /// The task of these evaluations, a built-in one by name, or the path of a folder; the
    /// dataset's, of several the first one's, if not given.
    #[arg(long, value_parser = TaskParser, requires = "eval_every")]
    pub(crate) eval_task: Option<String>,
    /// Trials of an evaluation.
    #[arg(long, default_value_t = 20, value_parser = count(), requires = "eval_every")]
    pub(crate) eval_trials: usize,
    /// Seed of their first trial. Choose others than those of the trials that are reported in the
    /// end, such as eval's.
    #[arg(long, default_value_t = 2_000_000, requires = "eval_every")]
    pub(crate) eval_seed: u64,
    /// Trials at a time.
    #[arg(long, default_value_t = 1, value_parser = threads(), requires = "eval_every")]
    pub(crate) eval_jobs: usize,
    /// Their delay from observation to chunk, ms, up to 10000.
    #[arg(long, value_name = "MS", value_parser = delay(), requires = "eval_every")]
    pub(crate) eval_latency_ms: Option<u64>,
    /// Which of the dataset's cameras the network sees: `single` (its first; of recordings with
    /// `single` or `multi` the paper's), `multi` (all, which must be the same in several datasets),
    /// or names with commas between them.
    #[arg(long, value_name = "single|multi|NAMES", default_value = "multi")]
    pub(crate) cameras: String,
    /// Sizes and recipe: of act, small (the default), compact, paper or lerobot; of act-pc, small
    /// (the default), paper or pcm; of dp3, paper (the default) or simple.
    #[arg(long, value_parser = ["small", "compact", "paper", "lerobot", "pcm", "simple"])]
    pub(crate) preset: Option<String>,
    /// Learning rates, batch, schedule and averaging of act and act-pc: what learns from scratch
    /// (the default), or the authors' own, meant for an ImageNet backbone. dp3 is always trained as
    /// published.
    #[arg(long, value_enum)]
    pub(crate) recipe: Option<TrainingRecipe>,
    /// Normalisation layers of act's backbone. A policy that LeRobot is to load needs
    /// frozen_batch_norm.
    #[arg(long, value_enum, default_value = "group_norm")]
    pub(crate) backbone: Backbone,
    /// Pretrained weights for a backbone with frozen_batch_norm: a safetensors file with
    /// torchvision's names of ResNet-18, as policy/convert/resnet18.py makes one, or the folder of
    /// an ACT policy in LeRobot's form.
    #[arg(long, value_name = "FILE|DIR")]
    pub(crate) backbone_weights: Option<PathBuf>,
    /// Optimiser steps; the preset's number if not given.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) steps: Option<u64>,
    /// Samples a step; the preset's number if not given.
    #[arg(long, value_parser = count())]
    pub(crate) batch: Option<usize>,
    /// Where the network computes.
    #[arg(long, value_enum, default_value = "cpu")]
    pub(crate) device: ComputeDevice,
    /// Use only the first episodes, of all datasets in their order.
    #[arg(long, value_parser = count())]
    pub(crate) episodes: Option<usize>,
    /// Validation split: the share of the episodes, the last ones of all datasets in their order,
    /// that is held out; 0 to 0.9.
    #[arg(long, default_value_t = 0.0)]
    pub(crate) validation_share: f64,
    /// Compute in 16 bits (bfloat16); for accelerators.
    #[arg(long)]
    pub(crate) bf16: bool,
    /// Keep decoded images in the host's memory and send each step's ahead of it, when the device
    /// has no room for all.
    #[arg(long)]
    pub(crate) images_on_host: bool,
    /// Run every step eagerly on CUDA instead of replaying a captured CUDA graph: slower.
    #[arg(long)]
    pub(crate) eager: bool,
    /// Threads that decode images, and compute on the CPU.
    #[arg(long, default_value_t = 2, value_parser = threads())]
    pub(crate) threads: usize,
    /// Data augmentation: random shift of images (up to 4 pixels), brightness, jitter and dropout
    /// of points, noise on states (0.02 of their standard deviation).
    #[arg(long)]
    pub(crate) augment: bool,
    /// Query interval in policy steps (LeRobot's n_action_steps), which the checkpoint recommends
    /// to `run` and `eval`: 25 of act and half a chunk of act-pc if not given, of dp3 as many as it
    /// predicts.
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) query_every: Option<u32>,
    /// Peak learning rate, in place of the recipe's; a pretrained backbone keeps its own.
    #[arg(long, value_name = "RATE")]
    pub(crate) lr: Option<f64>,
    /// Maximum random shift of an image, pixels of the network's image, in place of --augment's.
    /// Less of it leaves more precise policies where cameras stand still.
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(0..=64))]
    pub(crate) shift_px: Option<u32>,
    /// Standard deviation of the noise on states, in their own standard deviations, in place of
    /// --augment's.
    #[arg(long, value_name = "STD")]
    pub(crate) state_noise: Option<f64>,
    /// What point clouds are made of (box, instances, number of points) instead of the built-in
    /// config/clouds.toml.
    #[arg(long, value_name = "FILE")]
    pub(crate) clouds: Option<PathBuf>,
    /// Random seed: the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Write the result as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}
