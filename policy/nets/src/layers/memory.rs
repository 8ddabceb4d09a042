//! The numbers of the network library's tensors, where they are.
//!
//! Reading a tensor by copy would cost as much as a small product. Callers hold a reference to the
//! tensor while they read, and write only to tensors that were made here.

#![expect(unsafe_code, reason = "the library has no safe way to them but a copy")]

use std::slice;

use crate::dimension::dimension;
use tch::{Device, Kind, TchError, Tensor};

/// The numbers of `tensor`, which is contiguous, on the CPU and in single precision. They must not
/// change meanwhile, not through another tensor that shares them either; no gradient passes.
pub(super) fn numbers(tensor: &Tensor) -> Result<&[f32], TchError> {
    check(tensor)?;
    let count = tensor.numel();
    if count == 0 {
        return Ok(&[]);
    }
    // SAFETY: a contiguous tensor of `count` numbers in single precision has them one after the
    // other from `data_ptr` on, aligned, as long as it lives. Nothing here writes to a tensor that
    // anything else may see: `filled` gives its tensor away only after it is filled, and layers
    // apply to tensors that are not changed meanwhile.
    Ok(unsafe { slice::from_raw_parts(tensor.data_ptr().cast::<f32>(), count) })
}

/// A new tensor of two dimensions, filled by `fill`, which writes every number before it reads it.
pub(super) fn filled(shape: [usize; 2], fill: impl FnOnce(&mut [f32])) -> Result<Tensor, TchError> {
    let sides = shape.map(dimension);
    let tensor = Tensor::f_empty(sides, (Kind::Float, Device::Cpu))?;
    check(&tensor)?;
    let count = tensor.numel();
    if count > 0 {
        // SAFETY: as above, and there is no other reference to this tensor yet. Its memory is
        // another language's, which this one takes for written, and any bytes are a number.
        fill(unsafe { slice::from_raw_parts_mut(tensor.data_ptr().cast::<f32>(), count) });
    }
    Ok(tensor)
}

/// On the CPU, single precision, dense and contiguous.
fn check(tensor: &Tensor) -> Result<(), TchError> {
    let fits = tensor.device() == Device::Cpu
        && tensor.kind() == Kind::Float
        && !tensor.is_sparse()
        && tensor.is_contiguous();
    if fits {
        return Ok(());
    }
    let text = format!("{tensor:?} is not contiguous, on the CPU and in single precision");
    Err(TchError::Kind(text))
}
