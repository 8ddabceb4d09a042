//! `shim.cpp` in a process of its own with a mock of libtorch's CUDA library, as a libtorch with
//! CUDA is preloaded.

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use tch::{Device, Kind, TchError, Tensor};

use super::Capture;
use super::functions::stream_of;

const TEST: &str = "cuda_graph::mock::calls_reach_a_preloaded_libtorch";
/// Tells the process which call is to fail, or [`NONE`].
const FAILS: &str = "TROCAR_MOCK_FAILS";
const NONE: &str = "none";

/// The calls of `captured_and_replayed`, in order.
const CALLS: [&str; 16] = [
    "current stream",
    "stream of the pool",
    "cudaDeviceSynchronize",
    "the stream of the pool",
    "cudaDeviceSynchronize",
    "CUDAGraph(false)",
    "capture_begin",
    "capture_end",
    "cudaDeviceSynchronize",
    "the stream before",
    "replay",
    "current stream",
    "raw_cuda_graph_exec",
    "cudaGraphLaunch",
    "cudaDeviceSynchronize",
    "~CUDAGraph",
];

/// Calls that fail, and what is called after them: a capture that failed is abandoned, and the
/// generator of random numbers sees the end of another, unless that fails too.
const FAILING: [(&str, &[&str]); 6] = [
    (
        "CUDAGraph(false)",
        &["cudaDeviceSynchronize", "the stream before"],
    ),
    (
        "capture_begin",
        &[
            "cudaStreamEndCapture",
            "cudaGetLastError",
            "CUDAGraph(false)",
            "capture_begin",
            "cudaDeviceSynchronize",
            "the stream before",
        ],
    ),
    (
        "capture_end",
        &[
            "cudaStreamEndCapture",
            "cudaGetLastError",
            "CUDAGraph(false)",
            "capture_begin",
            "capture_end",
            "cudaDeviceSynchronize",
            "the stream before",
        ],
    ),
    ("replay", &["cudaDeviceSynchronize", "~CUDAGraph"]),
    (
        "raw_cuda_graph_exec",
        &["cudaDeviceSynchronize", "~CUDAGraph"],
    ),
    ("cudaGraphLaunch", &["cudaDeviceSynchronize", "~CUDAGraph"]),
];

/// A graph is captured, replayed both ways and dropped. Tensors are the CPU's, which computes
/// during the capture, of zeros.
fn captured_and_replayed() -> Result<(), TchError> {
    let one = [Tensor::ones([1], (Kind::Float, Device::Cpu))];
    let capture = Capture::begin(Device::Cuda(0))?.unwrap();
    let mut captured = capture.capture(&one, |inputs| inputs[0].f_cos())?;
    let answer = captured.replay(&one)?;
    assert_eq!(answer, one[0]);
    captured.graph.replay()
}

/// The mock as a library in `folder`.
fn compiled(folder: &Path) -> PathBuf {
    let library = folder.join("libtorch_cuda.so");
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cuda_graph");
    let headers = Path::new(&env::var_os("LIBTORCH").unwrap()).join("include");
    let compiler = env::var_os("CXX").unwrap_or_else(|| OsString::from("c++"));
    let mut command = Command::new(compiler);
    command.args(["-std=c++17", "-fPIC", "-shared"]);
    command.arg("-I").arg(here.join("cuda"));
    command.arg("-isystem").arg(headers);
    command.arg(here.join("mock.cpp")).arg("-o").arg(&library);
    assert!(command.status().unwrap().success(), "{command:?}");
    library
}

/// The calls that arrived at the mock, in a process where `failing` fails.
fn calls(library: &Path, failing: &str) -> Vec<String> {
    let mut command = Command::new(env::current_exe().unwrap());
    command.args(["--exact", TEST, "--nocapture"]);
    command.env("LD_PRELOAD", library).env(FAILS, failing);
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{failing}: {said}");
    let lines = said.lines().filter_map(|line| line.strip_prefix("mock: "));
    lines.map(str::to_owned).collect()
}

/// Weak references are set when the program starts, and libtorch's exceptions and CUDA's codes
/// become errors.
#[test]
fn calls_reach_a_preloaded_libtorch() {
    if let Ok(failing) = env::var(FAILS) {
        match captured_and_replayed() {
            Ok(()) => assert_eq!(failing, NONE),
            Err(error) => assert!(error.to_string().contains(&failing), "{failing}: {error}"),
        }
        return;
    }
    if !Device::cuda_if_available().is_cuda() {
        assert!(Capture::begin(Device::Cuda(0)).unwrap().is_none());
        let error = stream_of(Device::Cuda(0)).unwrap_err().to_string();
        assert!(error.contains("no CUDA"), "{error}");
    }
    let folder = env::temp_dir().join(format!("trocar-mock-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let library = compiled(&folder);
    assert_eq!(calls(&library, NONE), CALLS);
    for (failing, after) in FAILING {
        let until = CALLS.iter().position(|&call| call == failing).unwrap();
        let expected = [&CALLS[..=until], after].concat();
        assert_eq!(calls(&library, failing), expected, "{failing}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
