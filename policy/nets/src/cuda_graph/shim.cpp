// libtorch's CUDA graphs as functions of C, whose types the compiler checks against libtorch's headers.
//
// A program is linked with whichever libtorch is there, and may run with another, which has CUDA or has not. References to CUDA are
// therefore weak: the dynamic linker sets those that it does not find to null. libtorch declares none weak, so macros add it here.

#include <stdexcept>
#include <string>

// libtorch for the CPU has the headers, but for one that says how its CUDA library was built, which matters on Windows alone.
#define C10_CUDA_NO_CMAKE_CONFIGURE_FILE
#define USE_CUDA
#include <ATen/Context.h>
#include <c10/cuda/CUDACachingAllocator.h>
#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/c/shim.h>
#include <torch/headeronly/version.h>

#define CUDAGraph(...) CUDAGraph(__VA_ARGS__) __attribute__((weak))
#define capture_begin(...) capture_begin(__VA_ARGS__) __attribute__((weak))
#define capture_end(...) capture_end(__VA_ARGS__) __attribute__((weak))
#define raw_cuda_graph_exec(...) raw_cuda_graph_exec(__VA_ARGS__) __attribute__((weak))
#define replay(...) replay(__VA_ARGS__) __attribute__((weak))
#include <ATen/cuda/CUDAGraph.h>
#undef CUDAGraph
#undef capture_begin
#undef capture_end
#undef raw_cuda_graph_exec
#undef replay

#pragma weak aoti_torch_get_current_cuda_stream
#pragma weak torch_get_cuda_stream_from_pool
#pragma weak torch_set_current_cuda_stream
#pragma weak cudaDeviceSynchronize
#pragma weak cudaGetDevice
#pragma weak cudaGetErrorString
#pragma weak cudaGetLastError
#pragma weak cudaGraphLaunch
#pragma weak cudaSetDeviceFlags
#pragma weak cudaStreamEndCapture
#pragma weak cudaStreamIsCapturing

#define TROCAR_TEXT(x) #x
#define TROCAR_VERSION(major, minor) TROCAR_TEXT(major) "." TROCAR_TEXT(minor)
#define TROCAR_TORCH TROCAR_VERSION(TORCH_VERSION_MAJOR, TORCH_VERSION_MINOR)

using at::cuda::CUDAGraph;

namespace {

template <class... Functions>
bool all(Functions... functions) {
    return ((functions != nullptr) && ...);
}

// Whether the libraries here have CUDA, all of it, in the version whose objects the headers describe. C++ has no addresses of
// constructors; that one is where the methods are.
bool here() {
    static const bool found = all(
        &CUDAGraph::capture_begin, &CUDAGraph::capture_end, &CUDAGraph::raw_cuda_graph_exec, &CUDAGraph::replay,
        &aoti_torch_get_current_cuda_stream, &torch_get_cuda_stream_from_pool, &torch_set_current_cuda_stream,
        &cudaDeviceSynchronize, &cudaGetDevice, &cudaGetErrorString, &cudaGetLastError, &cudaGraphLaunch, &cudaStreamEndCapture,
        &cudaStreamIsCapturing
    ) && aoti_torch_abi_version() >> 48 == TORCH_ABI_VERSION >> 48;
    return found;
}

// Null, or why `work` failed, which stays until this thread's next failure.
template <class Work>
const char *reason(Work work) noexcept {
    thread_local std::string said;
    try {
        if (!here()) throw std::runtime_error("the libraries here have no CUDA of libtorch " TROCAR_TORCH);
        work();
        return nullptr;
    } catch (const c10::Error &error) {
        said = error.what_without_backtrace();
    } catch (const std::exception &error) {
        said = error.what();
    } catch (...) {
        said = "an unknown exception";
    }
    return said.c_str();
}

void checked(const char *what, cudaError_t code) {
    if (code != cudaSuccess) throw std::runtime_error(std::string(what) + ": " + cudaGetErrorString(code));
}

void checked_torch(const char *what, AOTITorchError code) {
    if (code != 0) throw std::runtime_error(std::string(what) + " failed with code " + std::to_string(code));
}

void *current_stream(int32_t device) {
    void *stream = nullptr;
    checked_torch("the device's stream", aoti_torch_get_current_cuda_stream(device, &stream));
    return stream;
}

} // namespace

extern "C" {

// Matrix products of single precision on CUDA round their factors to TF32. If that fails they stay exact, which is slower.
void trocar_allow_tf32_products() noexcept {
    try {
        at::globalContext().setAllowTF32CuBLAS(true);
    } catch (const std::exception &) {
    }
}

// The thread's current device, the only one that libtorch captures; -1 without CUDA.
int32_t trocar_cuda_device() noexcept {
    int device = -1;
    return here() && cudaGetDevice(&device) == cudaSuccess ? device : -1;
}

// Threads that wait for a device sleep. If that is refused, they wait as they did.
void trocar_cuda_sleep_while_waiting() noexcept {
    if (cudaSetDeviceFlags != nullptr) cudaSetDeviceFlags(cudaDeviceScheduleBlockingSync);
}

const char *trocar_cuda_synchronise() noexcept {
    return reason([] { checked("cudaDeviceSynchronize", cudaDeviceSynchronize()); });
}

const char *trocar_cuda_stream(int32_t device, void **stream) noexcept {
    return reason([=] { *stream = current_stream(device); });
}

const char *trocar_cuda_stream_of_pool(int32_t device, void **stream) noexcept {
    return reason([=] { checked_torch("a stream of libtorch's pool", torch_get_cuda_stream_from_pool(false, device, stream)); });
}

const char *trocar_cuda_set_stream(int32_t device, void *stream) noexcept {
    return reason([=] { checked_torch("a stream of its own", torch_set_current_cuda_stream(stream, device)); });
}

bool trocar_cuda_is_capturing(void *stream) noexcept {
    cudaStreamCaptureStatus status = cudaStreamCaptureStatusNone;
    return here() && cudaStreamIsCapturing(static_cast<cudaStream_t>(stream), &status) == cudaSuccess &&
           status == cudaStreamCaptureStatusActive;
}

// Abandons a capture that failed, and its error, which libtorch's next call would take for its own. What CUDA answers is of no use:
// the capture is lost anyway.
void trocar_cuda_abandon(void *stream) noexcept {
    if (!here()) return;
    cudaGraph_t nothing = nullptr;
    cudaStreamEndCapture(static_cast<cudaStream_t>(stream), &nothing);
    cudaGetLastError();
}

const char *trocar_graph_new(CUDAGraph **graph) noexcept {
    return reason([=] { *graph = new CUDAGraph(false); });
}

// Only what this thread does enters the capture. Zeros allocate a pool of its own.
const char *trocar_graph_begin(CUDAGraph *const *graph) noexcept {
    return reason([=] { (*graph)->capture_begin({0, 0}, cudaStreamCaptureModeThreadLocal); });
}

// Also makes it ready to be launched.
const char *trocar_graph_end(CUDAGraph *const *graph) noexcept {
    return reason([=] { (*graph)->capture_end(); });
}

const char *trocar_graph_launch(CUDAGraph *const *graph, int32_t device) noexcept {
    return reason([=] {
        const auto stream = static_cast<cudaStream_t>(current_stream(device));
        checked("cudaGraphLaunch", cudaGraphLaunch((*graph)->raw_cuda_graph_exec(), stream));
    });
}

// The generator of random numbers draws on from its seed.
const char *trocar_graph_replay(CUDAGraph *const *graph) noexcept {
    return reason([=] { (*graph)->replay(); });
}

void trocar_graph_delete(CUDAGraph *graph) noexcept {
    delete graph;
}
}
