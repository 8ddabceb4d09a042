//! CUDA graphs. But for a look at tensors' numbers (`layers/memory.rs`), calls by name (`by_name.rs`) and kernels (`kernels/`) all
//! unsafe code of this crate is here and in the two files beside this.

#![expect(
    unsafe_code,
    reason = "libtorch has graphs for C++ alone, and tch passes none of them on"
)]

use crate::dimension::length;
use std::ffi::{c_int, c_void};
use std::fmt;
use std::ptr::NonNull;

use tch::{Device, Kind, TchError, Tensor};

use super::aside::SideStream;
use super::functions::{Functions, checked, one_at_a_time};

/// `cudaStreamCaptureModeThreadLocal`: what other threads do meanwhile does not enter the capture.
const THIS_THREAD: c_int = 1;
/// Words for an `at::cuda::CUDAGraph`, which takes fewer than fifty.
pub(super) const OBJECT_WORDS: usize = 128;

/// Captured work of a device, launched again with one call. Its memory is its own.
pub(super) struct Graph {
    functions: Functions,
    /// The `at::cuda::CUDAGraph`, of which libtorch keeps the address.
    object: NonNull<u64>,
    executable: *mut c_void,
    device: i32,
}

// SAFETY: a graph belongs to no thread; CUDA asks that one thread at a time uses it, and `replay` takes it mutably.
unsafe impl Send for Graph {}

impl fmt::Debug for Graph {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = formatter.debug_struct("Graph");
        shown.field("device", &self.device).finish_non_exhaustive()
    }
}

impl Graph {
    /// What `work` has `device` do, and what it answered, which each [`Self::replay`] overwrites. None if the libraries here
    /// have no CUDA, `device` is not the thread's current one, or this work can't be captured. `work` runs twice before, so that
    /// what the libraries set up at first is done.
    ///
    /// libtorch's own exceptions end the process here: no action was requested yet, and nothing moves.
    pub(super) fn capture<T>(
        device: i32,
        mut work: impl FnMut() -> Result<T, TchError>,
    ) -> Result<Option<(Self, T)>, TchError> {
        let Some(aside) = SideStream::of(device)? else {
            return Ok(None);
        };
        for _ in 0..2 {
            let _answer = work()?;
        }
        Ok(Self::captured_on(&aside, work).ok())
    }

    /// What `work` would have the device do, and what it answered; it does nothing of it yet. The error says why it can't be
    /// captured; everything then is as before.
    ///
    /// Whatever the libraries set up at first must be done, on `aside`.
    pub(super) fn captured_on<T>(
        aside: &SideStream,
        work: impl FnOnce() -> Result<T, TchError>,
    ) -> Result<(Self, T), TchError> {
        let functions = aside.functions;
        let alone = one_at_a_time();
        functions.synchronise()?;
        let object = NonNull::from(Box::leak(Box::new([0_u64; OBJECT_WORDS]))).cast::<u64>();
        // SAFETY: the memory is more than the object needs, and aligned to words.
        unsafe { (functions.create)(object.as_ptr(), false) };
        // SAFETY: the object was made; the current stream is not the default one.
        unsafe { (functions.begin)(object.as_ptr(), 0, 0, THIS_THREAD) };
        let answer = work();
        if !aside.is_capturing() {
            // libtorch still knows the object, and its destructor would end a capture that there is not: it
            // stays for as long as the process.
            aside.abandon();
            Self::let_draw(aside);
            return Err(answer.err().unwrap_or_else(|| {
                TchError::Torch("something of it waits for the device".to_owned())
            }));
        }
        // SAFETY: it is capturing.
        unsafe { (functions.end)(object.as_ptr()) };
        // SAFETY: the capture has ended.
        let executable = unsafe { (functions.executable)(object.as_ptr()) };
        let graph = Self {
            functions,
            object,
            executable,
            device: aside.device,
        };
        drop(alone);
        Ok((graph, answer?))
    }

    /// Has the generator of random numbers, which takes its draws for captured, see the end of a capture.
    fn let_draw(aside: &SideStream) {
        let functions = aside.functions;
        let mut object = [0_u64; OBJECT_WORDS];
        // SAFETY: the memory is more than the object needs, and aligned to words.
        unsafe { (functions.create)(object.as_mut_ptr(), false) };
        // SAFETY: the object was made; the current stream is not the default one.
        unsafe { (functions.begin)(object.as_mut_ptr(), 0, 0, THIS_THREAD) };
        // An empty one is warned of.
        let device = Device::Cuda(length(aside.device.into()));
        let _something = Tensor::f_zeros([1], (Kind::Float, device));
        // SAFETY: it is capturing: nothing was done that could have ended it.
        unsafe { (functions.end)(object.as_mut_ptr()) };
        // SAFETY: the object was made, and is used no more.
        unsafe { (functions.destroy)(object.as_mut_ptr()) };
    }

    /// Has the device do it again, after all that this thread has asked of it before.
    pub(super) fn replay(&mut self) -> Result<(), TchError> {
        let stream = self.functions.stream(self.device)?;
        // SAFETY: the executable lives as long as the object; its memory is its own, but for the answer and what the caller
        // keeps.
        let code = unsafe { (self.functions.launch)(self.executable, stream) };
        checked("cudaGraphLaunch", code)
    }

    /// The same for work that draws random numbers: it draws on from where the generator of its device stands.
    ///
    /// libtorch's own exceptions, which a device that fails raises, end the process.
    pub(super) fn replay_drawing(&mut self) {
        // SAFETY: the capture has ended; otherwise as in `replay`.
        unsafe { (self.functions.replay)(self.object.as_ptr()) };
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        let _alone = one_at_a_time();
        // What was launched may still run; if the device fails there is nothing to wait for.
        let _done = self.functions.synchronise();
        // SAFETY: the object was made, and is used no more.
        unsafe { (self.functions.destroy)(self.object.as_ptr()) };
        // SAFETY: the memory came from a box of this form, and nothing points to it any more.
        drop(unsafe { Box::from_raw(self.object.cast::<[u64; OBJECT_WORDS]>().as_ptr()) });
    }
}
