//! Networks that say which tissue each voxel of a CT is: a 3-D U-Net of our own, or a TorchScript
//! model as MONAI exports them.
//!
//! Both see windows of a volume that has the spacing they were trained with, one after another
//! ([`Segmenter::classify`]).

mod axis;
mod file;
mod settings;
mod slab;
mod sliding;
#[cfg(test)]
mod tests;
mod unet;

use std::path::Path;

use tch::{CModule, Device, Kind, TchError, Tensor};

pub use file::{load_segmenter, save_segmenter};
pub use settings::{SegmenterSettings, SettingsDefect, Weighting};
pub use slab::BACKGROUND;
pub use sliding::Image;
pub use unet::{UNet, UNetConfig};

use crate::checkpoint::{Cause, CheckpointError};
use crate::dimension::dimension;

/// Most voxels of a scan as the network sees it: 4 GB.
const VOXELS_MAX: f64 = 1e9;

/// Why a volume can't be classified.
#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    /// The model does not do what its settings say.
    #[error("the model {0}")]
    Model(String),
    /// The bound on memory is too low.
    #[error(
        "the sums of {classes} classes need {needed_gb:.1} GB at least, and {allowed_gb:.1} GB are allowed"
    )]
    Memory {
        /// Classes of the model.
        classes: usize,
        /// What a strip of one row needs.
        needed_gb: f64,
        /// The bound.
        allowed_gb: f64,
    },
    /// The scan in the network's voxels is too large.
    #[error(
        "at the model's voxel size the scan has {voxels:.1e} voxels, and {VOXELS_MAX:.1e} at most are read"
    )]
    Large {
        /// How many they would be.
        voxels: f64,
    },
    /// The network library failed.
    #[error("the model fails: {0}")]
    Torch(#[from] TchError),
}

/// Both take `(1, 1, x, y, z)` and give `(1, classes, x, y, z)`.
#[derive(Debug)]
enum Network {
    Own(UNet),
    Script(CModule),
}

/// A network with what it wants to be shown.
#[derive(Debug)]
pub struct Segmenter {
    network: Network,
    settings: SegmenterSettings,
    device: Device,
}

impl Segmenter {
    /// A network of our own, by its file.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn own(file: &Path, device: Device) -> Result<Self, CheckpointError> {
        let (network, settings) = load_segmenter(file, device)?;
        Ok(Self::new(network, settings, device))
    }

    /// `network`, which is on `device`.
    #[must_use]
    pub const fn new(network: UNet, settings: SegmenterSettings, device: Device) -> Self {
        Self {
            network: Network::Own(network),
            settings,
            device,
        }
    }

    /// The TorchScript model in `file`: `(1, 1, x, y, z)` to `(1, classes, x, y, z)`.
    ///
    /// TorchScript is a program; it computes with tensors only, but a hostile one may use all
    /// memory or never end.
    ///
    /// # Errors
    /// [`CheckpointError`] if the network library can't read it.
    pub fn script(
        file: &Path,
        settings: SegmenterSettings,
        device: Device,
    ) -> Result<Self, CheckpointError> {
        let unreadable = |error: TchError| {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or("unreadable").to_owned();
            Cause::Config(format!("no TorchScript model: {first}")).in_file(file)
        };
        if !file.is_file() {
            return Err(Cause::Missing.in_file(file));
        }
        let mut module = CModule::load_on_device(file, device).map_err(unreadable)?;
        module.f_set_eval().map_err(unreadable)?;
        Ok(Self {
            network: Network::Script(module),
            settings,
            device,
        })
    }

    /// What it wants to be shown, and what its classes are.
    #[must_use]
    pub const fn settings(&self) -> &SegmenterSettings {
        &self.settings
    }

    /// The same with windows that overlap by `overlap` and are weighted by `weighting`.
    #[must_use]
    pub const fn with_windows(mut self, overlap: f64, weighting: Weighting) -> Self {
        self.settings.overlap = overlap;
        self.settings.weighting = weighting;
        self
    }

    /// Scores `(classes, x, y, z)` of a window `(x, y, z)`, in single precision, on the device.
    fn scores(&self, window: &Tensor) -> Result<Tensor, SegmentError> {
        let input = window
            .f_to_device(self.device)?
            .f_contiguous()?
            .f_view(&[&[1, 1], window.size().as_slice()].concat()[..])?;
        let scores = match &self.network {
            Network::Own(network) => network.forward(&input)?,
            Network::Script(module) => module.forward_ts(&[input])?,
        };
        let classes = dimension(self.settings.classes.len());
        let expected = [&[1, classes], window.size().as_slice()].concat();
        if scores.size() != expected {
            return Err(SegmentError::Model(format!(
                "answers a window with {:?} numbers, its settings say {expected:?}: one, classes, x, y, z",
                scores.size()
            )));
        }
        Ok(scores.f_squeeze_dim(0)?.f_to_kind(Kind::Float)?)
    }
}
