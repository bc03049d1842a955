// Region sums of one tile: how much each Gaussian paints of each combination of regions.
#pragma once

#include <cstdint>

#include "isa.h"
#include "tile.h"

namespace scoup {

// Label maps of all levels, [levels, height, width]; -1 is no region.
struct LabelMaps {
    const int32_t* labels;
    int32_t levels;
    int32_t width, height;

    int64_t plane() const { return int64_t(width) * height; }
};

// A pixel has one region (or none) at each level. Gaussian `id` paints `weight` of the pixels with combination
// number `combination`.
struct Record {
    uint32_t id;
    uint32_t combination;
    float weight;
};

// Growing lists of records and of combinations (one label a level each). The lists are grown by the caller's
// functions, so that kernels need no allocator of their own.
struct Records {
    Record* records = nullptr;
    int64_t n_records = 0, records_capacity = 0;
    int32_t* combinations = nullptr;
    int64_t n_combinations = 0, combinations_capacity = 0;
    // Make room for at least `more` further entries.
    void (*reserve_records)(Records&, int64_t more) = nullptr;
    void (*reserve_combinations)(Records&, int64_t more, int32_t levels) = nullptr;
};

struct RegionKernels {
    // Appends the records of a tile, in the order of its Gaussians, and the combinations they refer to.
    void (*collect)(const Tile& tile, const LabelMaps& maps, Records& out);
};

SCOUP_KERNEL_TABLE(RegionKernels, region_kernels)

}  // namespace scoup
