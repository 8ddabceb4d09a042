//! Trained weights that a backbone with fixed statistics starts from.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use tch::{Device, Tensor};

use super::WEIGHTS;
use super::error::{Cause, CheckpointError};
use super::tensors::{self, Plain};
use crate::act::{BACKBONE_PREFIX, check_frozen_backbone};

/// What torchvision's file has that a backbone has no use for: its classifier, and a count of each
/// normalisation.
const NOT_OF_THE_BACKBONE: [&str; 2] = ["fc.weight", "fc.bias"];
/// What the key of a normalisation's count of batches ends with.
const COUNT: &str = ".num_batches_tracked";

/// A ResNet-18 with the statistics of its batch normalisations, trained elsewhere.
#[derive(Debug)]
pub struct BackboneWeights {
    /// By the network's key, `model.backbone.` first; checked to be a whole backbone.
    tensors: BTreeMap<String, Tensor>,
}

impl BackboneWeights {
    /// Reads `path`: a safetensors file with torchvision's names of ResNet-18 (`conv1.weight` to
    /// `layer4.1.bn2.running_var`; its classifier is not read), or the folder of a policy in
    /// LeRobot's form, whose backbone is taken.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and the tensor: one that is missing, left over, of
    /// another shape, not finite, or a negative variance; what to do instead if the file is one of
    /// torch's own, a policy's without its folder, or of a backbone with group normalisation.
    pub fn load(path: &Path) -> Result<Self, CheckpointError> {
        let (file, prefix) = if path.is_dir() {
            (path.join(WEIGHTS), BACKBONE_PREFIX)
        } else {
            (path.to_path_buf(), "")
        };
        let wanted = |key: &str| {
            key.starts_with(prefix)
                && !key.ends_with(COUNT)
                && (!prefix.is_empty() || !NOT_OF_THE_BACKBONE.contains(&key))
        };
        let read = tensors::read_some(&file, wanted).map_err(|error| explained(error, &file))?;
        let whole = |key: &String| key.starts_with(BACKBONE_PREFIX);
        if prefix.is_empty() && read.keys().any(whole) {
            let folder = file.parent().filter(|it| !it.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new("."));
            return Err(Cause::WholePolicy(folder.to_path_buf()).in_file(&file));
        }
        let has = |part: &str| read.keys().any(|key| key.ends_with(part));
        if has("bn1.weight") && !has(".running_mean") && !has(".running_var") {
            return Err(Cause::GroupNormalised.in_file(&file));
        }
        let mut tensors = BTreeMap::new();
        for (key, plain) in read {
            check_values(&key, &plain).map_err(|cause| cause.in_file(&file))?;
            let tensor = plain
                .to_tensor(Device::Cpu)
                .map_err(|error| Cause::Parameter(error.into()).in_file(&file))?;
            let name = key.strip_prefix(prefix).unwrap_or(&key);
            tensors.insert(format!("{BACKBONE_PREFIX}{name}"), tensor);
        }
        check_frozen_backbone(&tensors).map_err(|error| {
            let named = error.with_keys(|key| match key.strip_prefix(BACKBONE_PREFIX) {
                Some(name) => format!("{prefix}{name}"),
                None => key.to_owned(),
            });
            Cause::Parameter(named).in_file(&file)
        })?;
        Ok(Self { tensors })
    }

    /// The backbone's tensors by the network's keys, on the CPU.
    #[must_use]
    pub const fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.tensors
    }
}

/// The error of reading `file`, or a better one if the file is one of torch's own: an archive, or,
/// of old, a pickle.
fn explained(error: CheckpointError, file: &Path) -> CheckpointError {
    const ARCHIVE: &[u8] = b"PK\x03\x04";
    const PICKLE: &[u8] = b"\x80\x02";
    if !matches!(error.cause, Cause::Safetensors(_)) {
        return error;
    }
    let mut start = Vec::new();
    let read = File::open(file).and_then(|it| it.take(4).read_to_end(&mut start));
    if read.is_ok() && (start.starts_with(ARCHIVE) || start.starts_with(PICKLE)) {
        return Cause::Pickled(file.to_path_buf()).in_file(file);
    }
    error
}

/// All numbers finite, no variance below 0.
fn check_values(key: &str, plain: &Plain) -> Result<(), Cause> {
    let defect = |what: &str| Err(Cause::Inconsistent(format!("tensor {key} {what}")));
    if !plain.values.iter().all(|value| value.is_finite()) {
        return defect("has a number that is not finite");
    }
    if key.ends_with(".running_var") && plain.values.iter().any(|&value| value < 0.0) {
        return defect("has a negative variance");
    }
    Ok(())
}
