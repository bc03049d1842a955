// How much work a view is: for the benchmarks, and to know what bounds the others.
#pragma once

#include "isa.h"
#include "tile.h"

namespace scoup {

struct TileCounts {
    int64_t pairs;        // of a Gaussian and a tile that were looked at
    int64_t blocks;       // vectors of pixels evaluated
    int64_t evaluations;  // pixels painted: alpha >= 1/255, before the stop
};

struct CountKernels {
    int lanes;  // pixels in a vector
    TileCounts (*count)(const Tile& tile);
};

SCOUP_KERNEL_TABLE(CountKernels, count_kernels)

}  // namespace scoup
