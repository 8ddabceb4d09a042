//! What is needed of libtorch 2.11 and of the CUDA runtime, as it is found in the running process: the libtorch that a program
//! was linked with need not have CUDA.

#![expect(
    unsafe_code,
    reason = "libtorch has graphs for C++ alone, and tch passes none of them on"
)]

use std::ffi::{CStr, c_int, c_void};
use std::ptr;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use tch::{Device, TchError};

pub(crate) type Stream = *mut c_void;

/// libtorch keeps a list of all captures without a lock, and waiting for the whole device invalidates those in progress: graphs
/// are captured and dropped one at a time.
pub(super) fn one_at_a_time() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The functions. `object` is memory of [`OBJECT_WORDS`](super::graph::OBJECT_WORDS).
#[derive(Clone, Copy, Debug)]
pub(super) struct Functions {
    /// `CUDAGraph::CUDAGraph(bool keep_graph)`.
    pub(super) create: unsafe extern "C-unwind" fn(object: *mut u64, keep: bool),
    /// `CUDAGraph::~CUDAGraph()`.
    pub(super) destroy: unsafe extern "C-unwind" fn(object: *mut u64),
    /// `capture_begin(MempoolId_t, cudaStreamCaptureMode)`; the id is a pair of numbers, and zeros allocate a pool of its own.
    pub(super) begin:
        unsafe extern "C-unwind" fn(object: *mut u64, pool: u64, of: u64, mode: c_int),
    /// `capture_end()`, which also makes it ready to be launched.
    pub(super) end: unsafe extern "C-unwind" fn(object: *mut u64),
    /// `replay()`: has the generator of random numbers draw on from its seed, and launches.
    pub(super) replay: unsafe extern "C-unwind" fn(object: *mut u64),
    /// `raw_cuda_graph_exec()`.
    pub(super) executable: unsafe extern "C-unwind" fn(object: *mut u64) -> *mut c_void,
    /// `aoti_torch_get_current_cuda_stream(int32_t device, void** stream)`.
    pub(super) current_stream: unsafe extern "C" fn(device: i32, stream: *mut Stream) -> i32,
    /// `torch_get_cuda_stream_from_pool(bool high_priority, int32_t device, void** stream)`.
    pub(super) stream_from_pool:
        unsafe extern "C" fn(high: bool, device: i32, stream: *mut Stream) -> i32,
    /// `torch_set_current_cuda_stream(void* stream, int32_t device)`.
    pub(super) set_stream: unsafe extern "C" fn(stream: Stream, device: i32) -> i32,
    /// `cudaGetDevice(int*)`.
    pub(super) device: unsafe extern "C" fn(device: *mut c_int) -> c_int,
    /// `cudaGetLastError()`, which also forgets it.
    pub(super) last_error: unsafe extern "C" fn() -> c_int,
    /// `cudaDeviceSynchronize()`.
    pub(super) synchronize: unsafe extern "C" fn() -> c_int,
    /// `cudaStreamIsCapturing(cudaStream_t, cudaStreamCaptureStatus*)`.
    pub(super) status: unsafe extern "C" fn(stream: Stream, status: *mut c_int) -> c_int,
    /// `cudaStreamEndCapture(cudaStream_t, cudaGraph_t*)`.
    pub(super) abandon: unsafe extern "C" fn(stream: Stream, graph: *mut *mut c_void) -> c_int,
    /// `cudaGraphLaunch(cudaGraphExec_t, cudaStream_t)`.
    pub(super) launch: unsafe extern "C" fn(executable: *mut c_void, stream: Stream) -> c_int,
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

/// The thread's current stream on `device`.
pub(crate) fn stream_of(device: Device) -> Result<Stream, TchError> {
    let missing = || TchError::Torch("the libraries here have no CUDA".to_owned());
    let Device::Cuda(device) = device else {
        return Err(missing());
    };
    let device = i32::try_from(device).unwrap_or(i32::MAX);
    Functions::found().ok_or_else(missing)?.stream(device)
}

/// Has threads that wait for a device sleep instead of asking it over and over, if there is CUDA here.
pub fn sleep_while_waiting() {
    /// `cudaDeviceScheduleBlockingSync`.
    const SLEEPING: u32 = 4;
    type SetFlags = unsafe extern "C" fn(flags: u32) -> c_int;
    // SAFETY: this is the type in CUDA's header.
    let Some(set_flags) = (unsafe { function::<SetFlags>(c"cudaSetDeviceFlags") }) else {
        return;
    };
    // SAFETY: it takes a number. If it is refused, threads wait as they did.
    let _code = unsafe { set_flags(SLEEPING) };
}

/// Has matrix products of single precision on CUDA round their factors to TF32 (10 bits of mantissa; sums stay in single precision), as
/// cuDNN's convolutions do unasked: for the whole process from now on, and nothing on the CPU.
pub fn allow_tf32_products() {
    type GlobalContext = unsafe extern "C-unwind" fn() -> *mut c_void;
    type Allow = unsafe extern "C-unwind" fn(context: *mut c_void, allow: bool);
    // SAFETY: `at::globalContext()` answers a reference, which is a pointer; `ATen/Context.h` of libtorch 2.11 has the type.
    let context = unsafe { function::<GlobalContext>(c"_ZN2at13globalContextEv") };
    // SAFETY: `at::Context::setAllowTF32CuBLAS(bool)`, of the same header; a method takes its object first.
    let allow = unsafe { function::<Allow>(c"_ZN2at7Context18setAllowTF32CuBLASEb") };
    let (Some(context), Some(allow)) = (context, allow) else {
        return;
    };
    // SAFETY: it takes nothing, and what it answers lives as long as the process.
    let context = unsafe { context() };
    // SAFETY: the object is libtorch's own.
    unsafe { allow(context, true) };
}

impl Functions {
    /// None where the libraries have no CUDA, or not all of it.
    #[expect(
        clippy::multiple_unsafe_ops_per_block,
        reason = "the same for each, for the same reason"
    )]
    pub(super) fn found() -> Option<Self> {
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
                    replay: function(c"_ZN2at4cuda9CUDAGraph6replayEv")?,
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
    pub(super) fn is_current(self, device: i32) -> bool {
        let mut current = -1;
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (self.device)(&raw mut current) };
        code == 0 && current == device
    }

    /// The thread's current stream on `device`.
    pub(super) fn stream(self, device: i32) -> Result<Stream, TchError> {
        let mut stream = ptr::null_mut();
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (self.current_stream)(device, &raw mut stream) };
        checked("the device's stream", code)?;
        Ok(stream)
    }

    pub(super) fn synchronise(self) -> Result<(), TchError> {
        // SAFETY: it takes nothing.
        let code = unsafe { (self.synchronize)() };
        checked("cudaDeviceSynchronize", code)
    }
}

pub(super) fn checked(what: &str, code: c_int) -> Result<(), TchError> {
    if code == 0 {
        Ok(())
    } else {
        Err(TchError::Torch(format!("{what} failed with code {code}")))
    }
}
