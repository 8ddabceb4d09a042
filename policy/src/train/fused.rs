//! AdamW as one piece of work: libtorch has it, but tch passes it on no more than anything else that changes lists of tensors,
//! so that it is called by its name.

#![expect(
    unsafe_code,
    reason = "libtorch's calls by name are functions of C"
)]

use std::ffi::{CStr, c_char, c_void};
use std::mem::ManuallyDrop;

use tch::{TchError, Tensor};

/// What the functions of libtorch's `torch/csrc/stable/c/shim.h` pass: a number, or a handle that changes hands.
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

/// What is the same at every step.
#[derive(Clone, Copy, Debug)]
pub(super) struct AdamW {
    pub(super) beta_1: f64,
    pub(super) beta_2: f64,
    pub(super) weight_decay: f64,
    pub(super) eps: f64,
}

/// Parameters with the moments of their gradients, of one size each and of single precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved<'a> {
    pub(super) parameters: &'a Tensor,
    pub(super) gradient: &'a Tensor,
    pub(super) first_moment: &'a Tensor,
    pub(super) second_moment: &'a Tensor,
}

impl AdamW {
    /// One step; `step`, from 1, and the learning rate `lr` are tensors of one number where the others are.
    pub(super) fn step(
        &self,
        moved: &Moved<'_>,
        step: &Tensor,
        lr: &Tensor,
    ) -> Result<(), TchError> {
        let mut stack = [
            list(Some(moved.parameters))?,
            list(Some(moved.gradient))?,
            list(Some(moved.first_moment))?,
            list(Some(moved.second_moment))?,
            // No greatest second moments: not AMSGrad.
            list(None)?,
            list(Some(step))?,
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

/// A handle of its own of `tensor`, for whom it is given to.
fn handle(tensor: &Tensor) -> Value {
    let mut own = ManuallyDrop::new(tensor.shallow_clone());
    own.as_mut_ptr() as Value
}

/// A list of one tensor or of none, for whom it is given to.
fn list(of: Option<&Tensor>) -> Result<Value, TchError> {
    let mut list = std::ptr::null_mut();
    // SAFETY: it writes to a variable of ours.
    let code = unsafe { torch_new_list_reserve_size(1, &raw mut list) };
    checked(c"a list", code)?;
    if let Some(tensor) = of {
        let tensor = handle(tensor);
        // SAFETY: the list was just made; the tensor is its own from here.
        let code = unsafe { torch_list_push_back(list, tensor) };
        checked(c"a list", code)?;
    }
    Ok(list as Value)
}

/// Calls `operator`, which returns nothing.
fn call(operator: &CStr, overload: &CStr, stack: &mut [Value]) -> Result<(), TchError> {
    let (name, overload) = (operator.as_ptr(), overload.as_ptr());
    // SAFETY: names are C strings, and the values are those of the operator's schema: libtorch 2.11 takes them.
    let code = unsafe { torch_call_dispatcher(name, overload, stack.as_mut_ptr(), WRITTEN_FOR) };
    checked(operator, code)
}

fn checked(what: &CStr, code: i32) -> Result<(), TchError> {
    if code == 0 {
        return Ok(());
    }
    let what = what.to_string_lossy();
    Err(TchError::Torch(format!("{what} failed with code {code}")))
}
