// libtorch's headers ask for the driver's API too, and use nothing of it.
#pragma once

#include "cuda_runtime_api.h"
