// libtorch's headers include CUDA's for device code too, and use nothing of it.
#pragma once

#include "cuda_runtime_api.h"
