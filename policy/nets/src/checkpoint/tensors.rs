//! Safetensors files: tensors by key, stored in half or single precision, always single precision
//! in memory.
//!
//! Layout of the format: eight bytes with the header's length, little-endian, the header in JSON
//! (`dtype`, `shape`, `data_offsets` of each tensor, texts under `__metadata__`), then the numbers,
//! row-major and little-endian. Reading runs no code.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use hal::files;
use half::{bf16, f16};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, TchError, Tensor};

use super::error::{Cause, CheckpointError};
use crate::dimension::length;

/// Element type of stored weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// 16 bits, 11 of them significant.
    F16,
    /// 32 bits.
    #[default]
    F32,
}

/// A tensor outside the network library: shape and values, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Plain {
    /// Empty for a scalar.
    pub(super) shape: Vec<usize>,
    /// As many as the shape's product; half precision and bfloat16 are widened, which is exact.
    pub(super) values: Vec<f32>,
}

/// Most bytes of a safetensors file, which is read whole.
const SIZE_MAX: u64 = 4 << 30;

fn read_bytes(file: &Path) -> Result<Vec<u8>, CheckpointError> {
    let bytes = files::read(file, "a safetensors file", SIZE_MAX);
    bytes.map_err(|error| Cause::io(error).in_file(file))
}

/// All tensors of `file`.
pub(crate) fn read(file: &Path) -> Result<BTreeMap<String, Plain>, CheckpointError> {
    read_some(file, |_| true)
}

/// The tensors of `file` whose key is `wanted`; what the others are does not matter.
pub(super) fn read_some(
    file: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<BTreeMap<String, Plain>, CheckpointError> {
    let bytes = read_bytes(file)?;
    let container = SafeTensors::deserialize(&bytes)
        .map_err(|error| Cause::Safetensors(error).in_file(file))?;
    let mut tensors = BTreeMap::new();
    for (key, view) in container.iter() {
        if !wanted(key) {
            continue;
        }
        let plain = plain_of(key, &view).map_err(|cause| cause.in_file(file))?;
        tensors.insert(key.to_owned(), plain);
    }
    Ok(tensors)
}

/// The values of the tensor `key` in single precision.
fn plain_of(key: &str, view: &TensorView<'_>) -> Result<Plain, Cause> {
    let values = values_of(view).ok_or_else(|| Cause::ElementType {
        key: key.to_owned(),
        kind: format!("{:?}", view.dtype()),
    })?;
    Ok(Plain {
        shape: view.shape().to_vec(),
        values,
    })
}

/// The text in the description of `file` under `key`.
pub(crate) fn read_about(file: &Path, key: &str) -> Result<Option<String>, CheckpointError> {
    let bytes = read_bytes(file)?;
    let (_, about) = SafeTensors::read_metadata(&bytes)
        .map_err(|error| Cause::Safetensors(error).in_file(file))?;
    let texts = about.metadata().as_ref();
    Ok(texts.and_then(|texts| texts.get(key)).cloned())
}

/// None for an element type that weights do not have.
fn values_of(view: &TensorView<'_>) -> Option<Vec<f32>> {
    let (pairs, _) = view.data().as_chunks::<2>();
    let (quads, _) = view.data().as_chunks::<4>();
    if view.dtype() == Dtype::F32 {
        Some(quads.iter().map(|quad| f32::from_le_bytes(*quad)).collect())
    } else if view.dtype() == Dtype::F16 {
        Some(
            pairs
                .iter()
                .map(|pair| f16::from_le_bytes(*pair).to_f32())
                .collect(),
        )
    } else if view.dtype() == Dtype::BF16 {
        Some(
            pairs
                .iter()
                .map(|pair| bf16::from_le_bytes(*pair).to_f32())
                .collect(),
        )
    } else {
        None
    }
}

/// Writes `tensors` to `file`, by way of a file beside it, so that a cut-off leaves no half file
/// behind.
pub(super) fn write(
    file: &Path,
    tensors: &BTreeMap<String, Plain>,
    precision: Precision,
) -> Result<(), CheckpointError> {
    write_about(file, tensors, precision, None)
}

/// The same with a text in the file's description, under a key.
pub(crate) fn write_about(
    file: &Path,
    tensors: &BTreeMap<String, Plain>,
    precision: Precision,
    about: Option<(&str, String)>,
) -> Result<(), CheckpointError> {
    let dtype = match precision {
        Precision::F16 => Dtype::F16,
        Precision::F32 => Dtype::F32,
    };
    let values = tensors.values();
    let encoded: Vec<Vec<u8>> = values
        .map(|plain| encode(&plain.values, precision))
        .collect();
    let mut views = Vec::with_capacity(encoded.len());
    for ((key, plain), bytes) in tensors.iter().zip(&encoded) {
        let view = TensorView::new(dtype, plain.shape.clone(), bytes);
        let view = view.map_err(|error| Cause::Safetensors(error).in_file(file))?;
        views.push((key.as_str(), view));
    }
    let about = about.map(|(key, text)| [(key.to_owned(), text)].into_iter().collect());
    let bytes = safetensors::serialize(views, about)
        .map_err(|error| Cause::Safetensors(error).in_file(file))?;
    replace(file, &bytes)
}

/// Little-endian bytes; to half precision by rounding to nearest, beyond its range to infinity.
fn encode(values: &[f32], precision: Precision) -> Vec<u8> {
    match precision {
        Precision::F32 => values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
        Precision::F16 => values
            .iter()
            .flat_map(|value| f16::from_f32(*value).to_le_bytes())
            .collect(),
    }
}

/// Puts `bytes` in the place of `file` at once.
pub(super) fn replace(file: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
    let part = file.with_extension("part");
    fs::write(&part, bytes).map_err(|error| Cause::io(error).in_file(&part))?;
    fs::rename(&part, file).map_err(|error| Cause::io(error).in_file(file))
}

impl Plain {
    /// A copy of `tensor`, from wherever it is.
    pub(crate) fn from_tensor(tensor: &Tensor) -> Result<Self, TchError> {
        let shape = tensor.size().iter().map(|&side| length(side)).collect();
        let flat = tensor
            .f_detach()?
            .f_to_kind(Kind::Float)?
            .f_to_device(Device::Cpu)?
            .f_reshape([-1])?;
        Ok(Self {
            shape,
            values: Vec::<f32>::try_from(&flat)?,
        })
    }

    /// The tensor on `device`. Filters have their channels last in memory, as the images that meet
    /// them.
    pub(crate) fn to_tensor(&self, device: Device) -> Result<Tensor, TchError> {
        let shape: Vec<i64> = self
            .shape
            .iter()
            .map(|&side| i64::try_from(side).unwrap_or(i64::MAX))
            .collect();
        let tensor = Tensor::f_from_slice(&self.values)?.f_reshape(&shape)?;
        let tensor = if let &[outputs, inputs, high, wide] = shape.as_slice() {
            let flat = tensor.f_permute([0, 2, 3, 1])?.f_reshape([-1])?;
            flat.f_view([outputs, high, wide, inputs])?
                .f_permute([0, 3, 1, 2])?
        } else {
            tensor
        };
        tensor.f_to_device(device)
    }
}
