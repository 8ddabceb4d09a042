//! What is needed of libtorch's CUDA graphs, which are C++: `shim.cpp` beside this, as functions
//! that Rust may call as they are.
//!
//! Whether there is CUDA shows in the running process: the libtorch that a program was linked with
//! need not have it. Without, each function says so.

#![expect(
    unsafe_code,
    reason = "libtorch has graphs for C++ alone, and tch passes none of them on"
)]

use std::ffi::{CStr, c_char, c_void};
use std::ptr::{self, NonNull};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tch::{Device, TchError};

/// A stream of libtorch's, which lives as long as the process. Null is the default one.
#[repr(transparent)]
#[derive(Clone, Copy, Debug)]
pub(super) struct Stream(*mut c_void);

/// An `at::cuda::CUDAGraph`, of which libtorch keeps the address. Unless it is
/// [deleted](Self::delete) it stays for as long as the process.
#[repr(transparent)]
#[derive(Debug)]
pub(super) struct Object(NonNull<c_void>);

// SAFETY: a graph belongs to no thread; CUDA asks that one thread at a time uses it, and it is
// neither copied nor shared.
unsafe impl Send for Object {}

/// Null, or why it failed, which stays until this thread's next failure.
#[repr(transparent)]
struct Answer(*const c_char);

// SAFETY: the types are those of `shim.cpp`, which catches exceptions and asks whether there is
// CUDA. Streams and objects come from it alone.
unsafe extern "C" {
    safe fn trocar_allow_tf32_products();
    safe fn trocar_cuda_device() -> i32;
    safe fn trocar_cuda_sleep_while_waiting();
    safe fn trocar_cuda_synchronise() -> Answer;
    safe fn trocar_cuda_stream(device: i32, stream: &mut Stream) -> Answer;
    safe fn trocar_cuda_stream_of_pool(device: i32, stream: &mut Stream) -> Answer;
    safe fn trocar_cuda_set_stream(device: i32, stream: Stream) -> Answer;
    safe fn trocar_cuda_is_capturing(stream: Stream) -> bool;
    safe fn trocar_cuda_abandon(stream: Stream);
    safe fn trocar_graph_new(object: &mut Option<Object>) -> Answer;
    safe fn trocar_graph_begin(object: &mut Object) -> Answer;
    safe fn trocar_graph_end(object: &mut Object) -> Answer;
    safe fn trocar_graph_launch(object: &mut Object, device: i32) -> Answer;
    safe fn trocar_graph_replay(object: &mut Object) -> Answer;
    safe fn trocar_graph_delete(object: Object);
}

impl Answer {
    fn checked(self) -> Result<(), TchError> {
        if self.0.is_null() {
            return Ok(());
        }
        // SAFETY: it is a C string of this thread's, where nothing has failed since.
        let reason = unsafe { CStr::from_ptr(self.0) };
        Err(TchError::Torch(reason.to_string_lossy().into_owned()))
    }
}

/// libtorch keeps a list of all captures without a lock, and waiting for the whole device
/// invalidates those in progress: graphs are captured and dropped one at a time.
pub(super) fn one_at_a_time() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Has threads that wait for a device sleep instead of asking it over and over, if there is CUDA
/// here.
pub fn sleep_while_waiting() {
    trocar_cuda_sleep_while_waiting();
}

/// Has matrix products of single precision on CUDA round their factors to TF32 (10 bits of
/// mantissa; sums stay in single precision), as cuDNN's convolutions do unasked: for the whole
/// process from now on, and nothing on the CPU.
pub fn allow_tf32_products() {
    trocar_allow_tf32_products();
}

/// Whether `device` is this thread's current one, the only one that libtorch captures. None is
/// without CUDA.
pub(super) fn is_current(device: i32) -> bool {
    trocar_cuda_device() == device
}

/// Waits for all work of the thread's current device. Only under [`one_at_a_time`].
pub(super) fn synchronise() -> Result<(), TchError> {
    trocar_cuda_synchronise().checked()
}

/// The thread's current stream on `device`, as CUDA's functions take it.
pub(crate) fn stream_of(device: Device) -> Result<*mut c_void, TchError> {
    let Device::Cuda(device) = device else {
        return Err(TchError::Torch(format!("{device:?} has no streams")));
    };
    let device = i32::try_from(device).unwrap_or(i32::MAX);
    Ok(Stream::current(device)?.0)
}

impl Stream {
    /// The thread's current one on `device`.
    pub(super) fn current(device: i32) -> Result<Self, TchError> {
        let mut stream = Self(ptr::null_mut());
        trocar_cuda_stream(device, &mut stream).checked()?;
        Ok(stream)
    }

    /// One of libtorch's pool.
    pub(super) fn of_pool(device: i32) -> Result<Self, TchError> {
        let mut stream = Self(ptr::null_mut());
        trocar_cuda_stream_of_pool(device, &mut stream).checked()?;
        Ok(stream)
    }

    /// Makes it the thread's current one on its `device`.
    pub(super) fn set_current(self, device: i32) -> Result<(), TchError> {
        trocar_cuda_set_stream(device, self).checked()
    }

    /// Whether a capture on it has begun and not ended.
    pub(super) fn is_capturing(self) -> bool {
        trocar_cuda_is_capturing(self)
    }

    /// Abandons a capture that failed, and its error, which the next call of libtorch would take
    /// for its own.
    pub(super) fn abandon(self) {
        trocar_cuda_abandon(self);
    }
}

impl Object {
    pub(super) fn new() -> Result<Self, TchError> {
        let mut object = None;
        trocar_graph_new(&mut object).checked()?;
        object.ok_or_else(|| TchError::Torch("libtorch made no graph".to_owned()))
    }

    /// From here on the thread's current stream, which must not be the default one, is captured.
    /// What other threads do meanwhile does not enter the capture.
    pub(super) fn begin(&mut self) -> Result<(), TchError> {
        trocar_graph_begin(self).checked()
    }

    /// Ends the capture, and makes it ready to be launched.
    pub(super) fn end(&mut self) -> Result<(), TchError> {
        trocar_graph_end(self).checked()
    }

    /// Launches it on the thread's current stream of `device`.
    pub(super) fn launch(&mut self, device: i32) -> Result<(), TchError> {
        trocar_graph_launch(self, device).checked()
    }

    /// The same, and the generator of random numbers draws on from its seed.
    pub(super) fn replay(&mut self) -> Result<(), TchError> {
        trocar_graph_replay(self).checked()
    }

    /// Its capture has ended, or never began: otherwise libtorch would end a capture that there is
    /// not.
    pub(super) fn delete(self) {
        trocar_graph_delete(self);
    }
}
