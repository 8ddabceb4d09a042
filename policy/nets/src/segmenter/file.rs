//! A segmenter in one safetensors file: weights in half precision, and its settings in the file's
//! description.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tch::Device;

use super::{SegmenterSettings, UNet, UNetConfig};
use crate::checkpoint::tensors::{self, Plain};
use crate::checkpoint::{Cause, CheckpointError, Precision};
use crate::dimension::dimension;
use crate::parameters::ParameterSource;

/// The key of the settings in the file's description.
const KEY: &str = "trocar_segmenter";

/// Most bytes of a segmenter's file.
const SIZE_MAX: u64 = 1 << 30;

/// The JSON text under [`KEY`] in the header's `__metadata__`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    network: UNetConfig,
    settings: SegmenterSettings,
}

/// Saves a segmenter as `file`.
///
/// # Errors
/// [`CheckpointError`] if it cannot be written.
pub fn save_segmenter(
    file: &Path,
    network: &UNet,
    settings: &SegmenterSettings,
) -> Result<(), CheckpointError> {
    let mut weights = BTreeMap::new();
    for (key, tensor) in network.parameters().iter() {
        let plain = Plain::from_tensor(tensor);
        let plain = plain.map_err(|error| Cause::Parameter(error.into()).in_file(file))?;
        weights.insert(key.to_owned(), plain);
    }
    let about = About {
        network: network.config().clone(),
        settings: settings.clone(),
    };
    let about = serde_json::to_string(&about).map_err(|error| Cause::Json(error).in_file(file))?;
    tensors::write_about(file, &weights, Precision::F16, Some((KEY, about)))
}

/// Reads and checks the segmenter in `file`; it computes in single precision.
///
/// # Errors
/// [`CheckpointError`] naming what is wrong with it.
pub fn load_segmenter(
    file: &Path,
    device: Device,
) -> Result<(UNet, SegmenterSettings), CheckpointError> {
    let size = std::fs::metadata(file).map_err(|error| Cause::io(error).in_file(file))?;
    let refuse = |text: String| Cause::Config(text).in_file(file);
    if size.len() > SIZE_MAX {
        return Err(refuse(format!(
            "{} bytes; a segmenter has at most 2^30",
            size.len()
        )));
    }
    let about = tensors::read_about(file, KEY)?.ok_or_else(|| {
        refuse("a safetensors file of another kind, not a segmenter's".to_owned())
    })?;
    let About { network, settings } =
        serde_json::from_str(&about).map_err(|error| Cause::Json(error).in_file(file))?;
    if let Some(defect) = settings.defect() {
        return Err(refuse(defect.to_string()));
    }
    if let Some(defect) = network.defect() {
        return Err(refuse(defect));
    }
    let (multiple, classes) = (network.multiple(), dimension(settings.classes.len()));
    if settings.patch.iter().any(|side| side % multiple > 0) || network.classes != classes {
        return Err(refuse(format!(
            "patch = {:?} and {classes} classes do not fit a network with {} classes and windows of multiples of {multiple}",
            settings.patch, network.classes
        )));
    }
    let mut given = BTreeMap::new();
    for (key, plain) in tensors::read(file)? {
        let tensor = plain.to_tensor(device);
        let tensor = tensor.map_err(|error| Cause::Parameter(error.into()).in_file(file))?;
        given.insert(key, tensor);
    }
    let network = UNet::new(network, ParameterSource::given(given))
        .map_err(|error| Cause::Parameter(error).in_file(file))?;
    let finite = network.parameters().are_finite();
    match finite.map_err(|error| Cause::Parameter(error.into()).in_file(file))? {
        true => Ok((network, settings)),
        false => Err(Cause::NotFinite.in_file(file)),
    }
}
