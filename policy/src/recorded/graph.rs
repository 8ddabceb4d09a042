//! CUDA graphs by the functions of libtorch 2.11 and of the CUDA runtime that are found in the running process: the libtorch
//! that a program was linked with need not have CUDA. But for a look at tensors' numbers (`layers/memory.rs`) all unsafe
//! code of this crate is here.

#![expect(
    unsafe_code,
    reason = "libtorch has graphs for C++ alone, and tch passes none of them on"
)]

use std::ffi::{CStr, c_int, c_void};
use std::fmt;
use std::ptr::{self, NonNull};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use tch::TchError;

type Stream = *mut c_void;

/// `cudaStreamCaptureModeThreadLocal`: what other threads do meanwhile does not enter the recording.
const THIS_THREAD: c_int = 1;
/// `cudaStreamCaptureStatusActive`.
const RECORDING: c_int = 1;
/// Words for an `at::cuda::CUDAGraph`, which takes fewer than fifty.
const OBJECT_WORDS: usize = 128;

/// libtorch keeps a list of all recordings without a lock, and whoever waits for the whole device spoils those under way: they
/// are made and dropped one at a time.
fn one_at_a_time() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What is needed of the two libraries. `object` is memory of [`OBJECT_WORDS`].
#[derive(Clone, Copy)]
struct Functions {
    /// `CUDAGraph::CUDAGraph(bool keep_graph)`.
    create: unsafe extern "C-unwind" fn(object: *mut u64, keep: bool),
    /// `CUDAGraph::~CUDAGraph()`.
    destroy: unsafe extern "C-unwind" fn(object: *mut u64),
    /// `capture_begin(MempoolId_t, cudaStreamCaptureMode)`; the id is a pair of numbers, and zeros ask for memory of its own.
    begin: unsafe extern "C-unwind" fn(object: *mut u64, pool: u64, of: u64, mode: c_int),
    /// `capture_end()`, which also makes it ready to be launched.
    end: unsafe extern "C-unwind" fn(object: *mut u64),
    /// `raw_cuda_graph_exec()`.
    executable: unsafe extern "C-unwind" fn(object: *mut u64) -> *mut c_void,
    /// `aoti_torch_get_current_cuda_stream(int32_t device, void** stream)`.
    current_stream: unsafe extern "C" fn(device: i32, stream: *mut Stream) -> i32,
    /// `torch_get_cuda_stream_from_pool(bool high_priority, int32_t device, void** stream)`.
    stream_from_pool: unsafe extern "C" fn(high: bool, device: i32, stream: *mut Stream) -> i32,
    /// `torch_set_current_cuda_stream(void* stream, int32_t device)`.
    set_stream: unsafe extern "C" fn(stream: Stream, device: i32) -> i32,
    /// `cudaGetDevice(int*)`.
    device: unsafe extern "C" fn(device: *mut c_int) -> c_int,
    /// `cudaGetLastError()`, which also forgets it.
    last_error: unsafe extern "C" fn() -> c_int,
    /// `cudaDeviceSynchronize()`.
    synchronize: unsafe extern "C" fn() -> c_int,
    /// `cudaStreamIsCapturing(cudaStream_t, cudaStreamCaptureStatus*)`.
    status: unsafe extern "C" fn(stream: Stream, status: *mut c_int) -> c_int,
    /// `cudaStreamEndCapture(cudaStream_t, cudaGraph_t*)`.
    abandon: unsafe extern "C" fn(stream: Stream, graph: *mut *mut c_void) -> c_int,
    /// `cudaGraphLaunch(cudaGraphExec_t, cudaStream_t)`.
    launch: unsafe extern "C" fn(executable: *mut c_void, stream: Stream) -> c_int,
}

/// The function called `name`.
///
/// # Safety
/// `F` must be the type of a pointer to that function.
unsafe fn function<F: Copy>(name: &CStr) -> Option<F> {
    const { assert!(size_of::<F>() == size_of::<*mut c_void>()) };
    // SAFETY: the name is a C string.
    let found = unsafe { libc::dlsym(libc::RTLD_DEFAULT, name.as_ptr()) };
    if found.is_null() {
        return None;
    }
    // SAFETY: both are pointers of one size, and the caller vouches for the type.
    Some(unsafe { std::mem::transmute_copy(&found) })
}

impl Functions {
    /// None where the libraries have no CUDA, or not all of it.
    #[expect(
        clippy::multiple_unsafe_ops_per_block,
        reason = "the same for each, for the same reason"
    )]
    fn found() -> Option<Self> {
        static FOUND: OnceLock<Option<Functions>> = OnceLock::new();
        *FOUND.get_or_init(|| {
            // SAFETY: names and types are those of the headers of libtorch 2.11 (`ATen/cuda/CUDAGraph.h`,
            // `torch/csrc/stable/c/shim.h`, `torch/csrc/inductor/aoti_torch/c/shim.h`) and of CUDA 12 and 13. Methods take
            // their object first, and a pair of two words in two registers, on x86-64 and on 64-bit Arm alike.
            unsafe {
                Some(Self {
                    create: function(c"_ZN2at4cuda9CUDAGraphC1Eb")?,
                    destroy: function(c"_ZN2at4cuda9CUDAGraphD1Ev")?,
                    begin: function(
                        c"_ZN2at4cuda9CUDAGraph13capture_beginESt4pairIyyE21cudaStreamCaptureMode",
                    )?,
                    end: function(c"_ZN2at4cuda9CUDAGraph11capture_endEv")?,
                    executable: function(c"_ZN2at4cuda9CUDAGraph19raw_cuda_graph_execEv")?,
                    current_stream: function(c"aoti_torch_get_current_cuda_stream")?,
                    stream_from_pool: function(c"torch_get_cuda_stream_from_pool")?,
                    set_stream: function(c"torch_set_current_cuda_stream")?,
                    device: function(c"cudaGetDevice")?,
                    last_error: function(c"cudaGetLastError")?,
                    synchronize: function(c"cudaDeviceSynchronize")?,
                    status: function(c"cudaStreamIsCapturing")?,
                    abandon: function(c"cudaStreamEndCapture")?,
                    launch: function(c"cudaGraphLaunch")?,
                })
            }
        })
    }

    /// Whether `device` is this thread's current one, the only one that libtorch records.
    fn is_current(self, device: i32) -> bool {
        let mut current = -1;
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (self.device)(&raw mut current) };
        code == 0 && current == device
    }

    /// The thread's current stream on `device`.
    fn stream(self, device: i32) -> Result<Stream, TchError> {
        let mut stream = ptr::null_mut();
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (self.current_stream)(device, &raw mut stream) };
        checked("the device's stream", code)?;
        Ok(stream)
    }

    fn synchronise(self) -> Result<(), TchError> {
        // SAFETY: it takes nothing.
        let code = unsafe { (self.synchronize)() };
        checked("cudaDeviceSynchronize", code)
    }
}

fn checked(what: &str, code: c_int) -> Result<(), TchError> {
    if code == 0 {
        Ok(())
    } else {
        Err(TchError::Torch(format!("{what} failed with code {code}")))
    }
}

/// What a device was told to do, to be told again with one call. The memory that it works in is its own.
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

/// A stream of libtorch's pool as this thread's current one, until it is dropped: the default stream can't be recorded.
struct Aside {
    functions: Functions,
    device: i32,
    before: Stream,
    stream: Stream,
}

impl Aside {
    fn new(functions: Functions, device: i32) -> Result<Self, TchError> {
        let before = functions.stream(device)?;
        let mut stream = ptr::null_mut();
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (functions.stream_from_pool)(false, device, &raw mut stream) };
        checked("a stream of libtorch's pool", code)?;
        functions.synchronise()?;
        // SAFETY: the stream is libtorch's own, of this device.
        let code = unsafe { (functions.set_stream)(stream, device) };
        checked("a stream of its own", code)?;
        Ok(Self {
            functions,
            device,
            before,
            stream,
        })
    }

    fn is_recording(&self) -> bool {
        let mut status = 0;
        // SAFETY: the stream lives as long as the process; the status is a variable of ours.
        let code = unsafe { (self.functions.status)(self.stream, &raw mut status) };
        code == 0 && status == RECORDING
    }

    /// Lets go of a recording that failed, and of its error, which the next call of libtorch would take for its own.
    fn abandon(&self) {
        let mut nothing = ptr::null_mut();
        // SAFETY: the stream lives as long as the process; the graph is a variable of ours. What it answers is of no use: the
        // recording is lost anyway.
        let _code = unsafe { (self.functions.abandon)(self.stream, &raw mut nothing) };
        // SAFETY: it takes nothing.
        let _forgotten = unsafe { (self.functions.last_error)() };
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        // SAFETY: the stream that was current before. It fails only if there is no such device.
        let _code = unsafe { (self.functions.set_stream)(self.before, self.device) };
    }
}

impl Graph {
    /// What `work` has `device` do, and what it answered, which each [`Self::replay`] overwrites. None if the libraries here
    /// have no CUDA, `device` is not the thread's current one, or this work can't be recorded. `work` runs twice before, so that
    /// what the libraries set up at first is done.
    ///
    /// libtorch's own exceptions end the process here: no answer was asked for yet, and nothing moves.
    pub(super) fn record<T>(
        device: i32,
        mut work: impl FnMut() -> Result<T, TchError>,
    ) -> Result<Option<(Self, T)>, TchError> {
        let Some(functions) = Functions::found().filter(|found| found.is_current(device)) else {
            return Ok(None);
        };
        let _alone = one_at_a_time();
        let aside = Aside::new(functions, device)?;
        for _ in 0..2 {
            let _answer = work()?;
        }
        functions.synchronise()?;
        let object = NonNull::from(Box::leak(Box::new([0_u64; OBJECT_WORDS]))).cast::<u64>();
        // SAFETY: the memory is more than the object needs, and aligned to words.
        unsafe { (functions.create)(object.as_ptr(), false) };
        // SAFETY: the object was made; the current stream is not the default one.
        unsafe { (functions.begin)(object.as_ptr(), 0, 0, THIS_THREAD) };
        let (Ok(answer), true) = (work(), aside.is_recording()) else {
            // libtorch still knows the object, and its destructor would ask for the end of a recording that there is not: it
            // stays for as long as the process. Random numbers on the device are not to be had any more.
            aside.abandon();
            return Ok(None);
        };
        // SAFETY: it is recording.
        unsafe { (functions.end)(object.as_ptr()) };
        // SAFETY: the recording has ended.
        let executable = unsafe { (functions.executable)(object.as_ptr()) };
        let graph = Self {
            functions,
            object,
            executable,
            device,
        };
        Ok(Some((graph, answer)))
    }

    /// Has the device do it again, after all that this thread has asked of it before.
    pub(super) fn replay(&mut self) -> Result<(), TchError> {
        let stream = self.functions.stream(self.device)?;
        // SAFETY: the executable lives as long as the object; its memory is its own, but for the answer and what the caller
        // keeps.
        let code = unsafe { (self.functions.launch)(self.executable, stream) };
        checked("cudaGraphLaunch", code)
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        let _alone = one_at_a_time();
        // What it was told to do may not be done yet; if the device fails there is nothing to wait for.
        let _done = self.functions.synchronise();
        // SAFETY: the object was made, and is used no more.
        unsafe { (self.functions.destroy)(self.object.as_ptr()) };
        // SAFETY: the memory came from a box of this form, and nothing points to it any more.
        drop(unsafe { Box::from_raw(self.object.cast::<[u64; OBJECT_WORDS]>().as_ptr()) });
    }
}
