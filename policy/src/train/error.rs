//! Why a training run ends early.

use tch::TchError;

use crate::dataset::DatasetError;
use crate::images::ImageError;
use crate::parameters::ParameterError;

/// Why a training run ended early.
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
    /// The loss is NaN or infinite.
    #[error(
        "the loss is {loss} by step {step}: lower the learning rate or the gradient's greatest norm"
    )]
    Diverged {
        /// Step at which it was noticed; it happened at most one row of the loss curve earlier.
        step: u64,
        /// The loss.
        loss: f64,
    },
    /// The network could not be built.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The network library failed.
    #[error(transparent)]
    Torch(#[from] TchError),
}
