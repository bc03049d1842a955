// Region sums of one tile: how much each Gaussian paints of each combination of regions.
#pragma once

#include <cstdint>

#include "isa.h"
#include "tile.h"

namespace scoup {

// The combination of regions of each pixel, [height, width]; -1 is none.
struct CombinationMap {
    const int32_t* numbers;
    int32_t width, height;
};

// Gaussian `id` paints `weight` of the pixels with combination number `combination`.
struct Record {
    uint32_t id;
    int32_t combination;
    float weight;
};

// A growing list of records. It is grown by the caller's function, so that kernels need no allocator of their own.
struct Records {
    Record* records = nullptr;
    int64_t count = 0, capacity = 0;
    void (*reserve)(Records&, int64_t more) = nullptr;  // make room for at least `more` further records
};

struct RegionKernels {
    // Appends the records of a tile, in the order of its Gaussians.
    void (*collect)(const Tile& tile, const CombinationMap& map, Records& out);
};

SCOUP_KERNEL_TABLE(RegionKernels, region_kernels)

}  // namespace scoup
