#![doc = include_str!("../README.md")]

mod act;
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
mod launch;
mod options;
mod plot;
mod recipes;
#[cfg(test)]
mod resume_tests;
mod run_state;
mod segmenter;
mod steps;
#[cfg(test)]
mod tests;
mod trained;
mod training_set;
mod transfer;
mod watch;

pub use curve::{CurveRow, LossCurve};
pub use error::TrainError;
pub use options::{Augmentation, Schedule, TrainOptions, TrainPrecision};
pub use run_state::RunState;
pub use segmenter::{LabelledScan, SegmenterTraining};
pub use trained::{AnyTrained, Network, Trained, Trainer};
pub use watch::{Progress, TrainingObserver};
