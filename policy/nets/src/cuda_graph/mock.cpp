// libtorch's CUDA library as far as `shim.cpp` calls it, for a machine without one: it says which calls arrive, and fails at the one
// that `TROCAR_MOCK_FAILS` names.

#include <cstdio>
#include <cstdlib>
#include <string>

// As in `shim.cpp`.
#define C10_CUDA_NO_CMAKE_CONFIGURE_FILE
#define USE_CUDA
#include <ATen/cuda/CUDAGeneratorImpl.h>
#include <ATen/cuda/CUDAGraph.h>
#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/c/shim.h>

namespace {

bool capturing = false;
int of_the_pool;
void *current = nullptr;

bool fails(const char *call) {
    std::fprintf(stderr, "mock: %s\n", call);
    const char *failing = std::getenv("TROCAR_MOCK_FAILS");
    return failing != nullptr && std::string(failing) == call;
}

void arrives(const char *call) {
    TORCH_CHECK(!fails(call), call, " was told to fail");
}

} // namespace

namespace at::cuda {

CUDAGraph::CUDAGraph(bool keep_graph)
    : capture_stream_(CUDAStream::UNCHECKED, c10::Stream(c10::Stream::DEFAULT, c10::Device(c10::kCUDA, 0))), keep_graph_(keep_graph) {
    arrives(keep_graph ? "CUDAGraph(true)" : "CUDAGraph(false)");
}

CUDAGraph::~CUDAGraph() {
    fails("~CUDAGraph");
}

void CUDAGraph::capture_begin(MempoolId_t pool, cudaStreamCaptureMode mode) {
    arrives("capture_begin");
    TORCH_CHECK(pool == MempoolId_t(0, 0) && mode == cudaStreamCaptureModeThreadLocal && current == &of_the_pool);
    capturing = true;
}

void CUDAGraph::capture_end() {
    arrives("capture_end");
    capturing = false;
}

void CUDAGraph::replay() {
    arrives("replay");
}

cudaGraphExec_t CUDAGraph::raw_cuda_graph_exec() {
    arrives("raw_cuda_graph_exec");
    return reinterpret_cast<cudaGraphExec_t>(this);
}

} // namespace at::cuda

extern "C" {

AOTITorchError aoti_torch_get_current_cuda_stream(int32_t, void **stream) {
    *stream = current;
    return fails("current stream");
}

AOTITorchError torch_get_cuda_stream_from_pool(bool, int32_t, void **stream) {
    *stream = &of_the_pool;
    return fails("stream of the pool");
}

AOTITorchError torch_set_current_cuda_stream(void *stream, int32_t) {
    current = stream;
    return fails(stream == nullptr ? "the stream before" : "the stream of the pool");
}

const char *cudaGetErrorString(cudaError_t) {
    return "it was told to fail";
}

cudaError_t cudaDeviceSynchronize() {
    return fails("cudaDeviceSynchronize") ? cudaErrorUnknown : cudaSuccess;
}

cudaError_t cudaGetDevice(int *device) {
    *device = 0;
    return cudaSuccess;
}

cudaError_t cudaGetLastError() {
    fails("cudaGetLastError");
    return cudaSuccess;
}

cudaError_t cudaGraphLaunch(cudaGraphExec_t, cudaStream_t) {
    return fails("cudaGraphLaunch") ? cudaErrorUnknown : cudaSuccess;
}

cudaError_t cudaStreamEndCapture(cudaStream_t, cudaGraph_t *) {
    fails("cudaStreamEndCapture");
    capturing = false;
    return cudaSuccess;
}

cudaError_t cudaStreamIsCapturing(cudaStream_t stream, cudaStreamCaptureStatus *status) {
    *status = capturing && stream == static_cast<void *>(&of_the_pool) ? cudaStreamCaptureStatusActive : cudaStreamCaptureStatusNone;
    return cudaSuccess;
}
}
