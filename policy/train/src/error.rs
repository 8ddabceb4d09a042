//! Why a training run ends early.

use tch::TchError;

use trocar_data::dataset::DatasetError;
use trocar_nets::images::ImageError;
use trocar_nets::parameters::ParameterError;

/// Why a training run ended early. It can be resumed from the last state that it kept.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// An option or the network's configuration is impossible.
    #[error("{0}")]
    Options(String),
    /// The dataset has no frame.
    #[error("the dataset has no frame to train on")]
    Empty,
    /// The dataset does not fit.
    #[error("the dataset does not fit: {0}")]
    Dataset(String),
    /// The dataset could not be read.
    #[error(transparent)]
    Read(#[from] DatasetError),
    /// An image has the wrong size.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A part of the loss, or the gradient, is NaN or infinite.
    #[error(
        "the {term} is {value} at step {step}: look for absurd numbers in the dataset, or take lower learning rates, as ACT's \
         recipe `published` has"
    )]
    Diverged {
        /// The first step with such a number, counted from 1; it is noticed at the next row of the
        /// loss curve, or before the state is kept.
        step: u64,
        /// The first such number of that step: `l1`, `kl`, `loss` or `gradient`.
        term: &'static str,
        /// Its value.
        value: f64,
    },
    /// It was cancelled; the state was kept.
    #[error("stopped after step {step}")]
    Stopped {
        /// Steps taken.
        step: u64,
    },
    /// The observer of the run failed.
    #[error("{0}")]
    Watch(String),
    /// The state of an earlier run can't be written, read or resumed.
    #[error("{0}")]
    State(String),
    /// The network could not be built.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The network library failed.
    #[error(transparent)]
    Torch(#[from] TchError),
}
