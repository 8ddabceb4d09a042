//! What libtorch has and tch does not pass on, called by its name: work on many tensors as one
//! piece, and the gradients of convolutions. Training steps are made of it.

#![expect(unsafe_code, reason = "libtorch's calls by name are functions of C")]

use std::ffi::{CStr, c_char, c_void};
use std::mem::ManuallyDrop;
use std::ptr::with_exposed_provenance_mut;

use hal::count;
use tch::{TchError, Tensor};

/// What the functions of libtorch's `torch/csrc/stable/c/shim.h` pass: a number, or a handle that
/// changes hands.
type Value = u64;

/// `TORCH_VERSION` 2.11 as that file writes it: the meaning of the values is that version's.
const WRITTEN_FOR: u64 = (2 << 56) | (11 << 48);

#[link(name = "torch_cpu")]
unsafe extern "C" {
    fn torch_call_dispatcher(
        operator: *const c_char,
        overload: *const c_char,
        stack: *mut Value,
        written_for: u64,
    ) -> i32;
    fn torch_new_list_reserve_size(size: usize, list: *mut *mut c_void) -> i32;
    fn torch_list_push_back(list: *mut c_void, value: Value) -> i32;
}

/// AdamW as one operation: what is the same at every step.
///
/// `theta -= lr * (m / (1 - beta_1^t) / (sqrt(v / (1 - beta_2^t)) + eps) + weight_decay * theta)`
/// with the moving means `m` of the gradient and `v` of its square (Loshchilov and Hutter 2019,
/// algorithm 2; that the learning rate multiplies the decay is PyTorch's).
#[derive(Clone, Copy, Debug)]
pub struct AdamW {
    /// How much of the first moment stays.
    pub beta_1: f64,
    /// How much of the second moment stays.
    pub beta_2: f64,
    /// The share of a parameter that goes at each step, times the learning rate.
    pub weight_decay: f64,
    /// What is added to the root of the second moment.
    pub eps: f64,
}

/// Parameters with the moments of their gradients, of one size each and of single precision.
#[derive(Clone, Copy, Debug)]
pub struct Moved<'a> {
    /// What the step changes.
    pub parameters: &'a Tensor,
    /// Their gradient.
    pub gradient: &'a Tensor,
    /// Moving mean of the gradient; the step changes it too.
    pub first_moment: &'a Tensor,
    /// Moving mean of its square; the step changes it too.
    pub second_moment: &'a Tensor,
}

impl AdamW {
    /// One step; `step`, from 1, and the learning rate `lr` are tensors of one number in single
    /// precision where the others are.
    ///
    /// # Errors
    /// The network library's.
    pub fn step(&self, moved: &Moved<'_>, step: &Tensor, lr: &Tensor) -> Result<(), TchError> {
        let mut stack = [
            tensors([moved.parameters])?,
            tensors([moved.gradient])?,
            tensors([moved.first_moment])?,
            tensors([moved.second_moment])?,
            // No greatest second moments: not AMSGrad.
            tensors([])?,
            tensors([step])?,
            handle(lr),
            self.beta_1.to_bits(),
            self.beta_2.to_bits(),
            self.weight_decay.to_bits(),
            self.eps.to_bits(),
            // Neither AMSGrad nor uphill; no scale of the gradient and no search for infinite ones.
            0,
            0,
            0,
            0,
        ];
        call(c"aten::_fused_adamw_", c"tensor_lr", &mut stack)
    }
}

/// Copies each of `from` to its one of `to`, as many, of the same shape and strides; their kinds
/// may differ. On an accelerator a few kernels copy all tensors. Empty lists are no error.
///
/// # Errors
/// The network library's.
pub fn copy_all(to: &[Tensor], from: &[Tensor]) -> Result<(), TchError> {
    if to.is_empty() {
        return Ok(());
    }
    // They wait for nothing on one device.
    let mut stack = [tensors(to)?, tensors(from)?, 0];
    call(c"aten::_foreach_copy_", c"", &mut stack)
}

/// The gradients of a convolution's input (none unless `of_input`) and of its `weight`, given that
/// of its answer. No bias.
pub(crate) fn convolution_backward(
    gradient: &Tensor,
    input: &Tensor,
    weight: &Tensor,
    [stride, padding]: [i64; 2],
    of_input: bool,
) -> Result<(Tensor, Tensor), TchError> {
    let mut stack = [
        handle(gradient),
        handle(input),
        handle(weight),
        // No sizes of a bias.
        0,
        list([stride.cast_unsigned(); 2])?,
        list([padding.cast_unsigned(); 2])?,
        list([1, 1])?,
        0,
        list([0, 0])?,
        1,
        list([u64::from(of_input), 1, 0])?,
    ];
    call(c"aten::convolution_backward", c"", &mut stack)?;
    let [of_input, of_weight, of_bias, ..] = stack.map(count::index);
    // SAFETY: the operator answers with three tensors, whose handles are ours from here; the last
    // one is undefined.
    drop(unsafe { Tensor::from_ptr(with_exposed_provenance_mut(of_bias)) });
    // SAFETY: as above.
    let of_input = unsafe { Tensor::from_ptr(with_exposed_provenance_mut(of_input)) };
    // SAFETY: as above.
    let of_weight = unsafe { Tensor::from_ptr(with_exposed_provenance_mut(of_weight)) };
    Ok((of_input, of_weight))
}

/// An owned handle of `tensor`, which the receiver releases.
fn handle(tensor: &Tensor) -> Value {
    let mut own = ManuallyDrop::new(tensor.shallow_clone());
    own.as_mut_ptr().expose_provenance() as Value
}

/// A list of tensors, which the receiver releases.
fn tensors<'a>(of: impl IntoIterator<Item = &'a Tensor>) -> Result<Value, TchError> {
    list(of.into_iter().map(handle))
}

/// A list, which the receiver releases.
fn list(of: impl IntoIterator<Item = Value>) -> Result<Value, TchError> {
    let mut list = std::ptr::null_mut();
    // SAFETY: it writes to a variable of ours.
    let code = unsafe { torch_new_list_reserve_size(0, &raw mut list) };
    checked(c"a list", code)?;
    for value in of {
        // SAFETY: the list was just made; the value is its own from here.
        let code = unsafe { torch_list_push_back(list, value) };
        checked(c"a list", code)?;
    }
    Ok(list.expose_provenance() as Value)
}

/// Calls `operator`; its answers take the places of what it was given.
fn call(operator: &CStr, overload: &CStr, stack: &mut [Value]) -> Result<(), TchError> {
    let (name, overload) = (operator.as_ptr(), overload.as_ptr());
    // SAFETY: names are C strings, and the values are those of the operator's schema: libtorch 2.11
    // takes them.
    let code = unsafe { torch_call_dispatcher(name, overload, stack.as_mut_ptr(), WRITTEN_FOR) };
    checked(operator, code)
}

/// The library's code as an error; it gives no text.
fn checked(what: &CStr, code: i32) -> Result<(), TchError> {
    if code == 0 {
        return Ok(());
    }
    let what = what.to_string_lossy();
    Err(TchError::Torch(format!("{what} failed with code {code}")))
}

#[cfg(test)]
mod tests {
    use super::convolution_backward;
    use tch::{Device, Kind, Tensor};

    #[test]
    fn gradients_of_a_convolution_are_those_of_the_library() {
        for (size, stride, padding) in [(3, 1, 1), (3, 2, 1), (1, 2, 0)] {
            let float = (Kind::Float, Device::Cpu);
            let input = Tensor::randn([2, 3, 7, 8], float).set_requires_grad(true);
            let weight = Tensor::randn([5, 3, size, size], float).set_requires_grad(true);
            let answer = input.conv2d::<&Tensor>(&weight, None, stride, padding, 1, 1);
            let gradient = Tensor::randn(answer.size(), float);
            let total = (&answer * &gradient).sum(Kind::Float);
            let wanted = Tensor::run_backward(&[total], &[&input, &weight], false, false);
            let (input, weight) = (input.detach(), weight.detach());
            let (of_input, of_weight) =
                convolution_backward(&gradient, &input, &weight, [stride, padding], true).unwrap();
            for (found, wanted) in [&of_input, &of_weight].into_iter().zip(&wanted) {
                let apart = (found - wanted).abs().max().double_value(&[]);
                assert!(apart < 1e-4, "{size} {stride}: {apart}");
            }
            let (none, alone) =
                convolution_backward(&gradient, &input, &weight, [stride, padding], false).unwrap();
            assert!(!none.defined());
            assert!((alone - of_weight).abs().max().double_value(&[]) < 1e-5);
        }
    }
}
