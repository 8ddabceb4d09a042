//! From the host to the device.

use tch::{Device, TchError, Tensor};

/// `tensor` of the host's memory on `device`, without waiting for the device.
pub(super) fn send(tensor: &Tensor, device: Device) -> Result<Tensor, TchError> {
    tensor.f_to_dtype_layout((tensor.kind(), device), true, false)
}
