// Label maps of several levels as one map of combinations: a pixel has one region, or none, at each level.
#pragma once

#include <cstdint>
#include <vector>

#include "buffer.h"
#include "threads.h"

namespace scoup {

struct Combinations {
    Buffer<int32_t> map;         // [pixels] number of the combination, -1 where no level has a region
    std::vector<int32_t> table;  // [count, levels] labels; -1 for no region
    int64_t count = 0;
};

// Combinations are numbered in the order in which their first pixels come. `labels`: [levels, pixels]; every number
// below 0 is no region.
Combinations combine(const int32_t* labels, int32_t levels, int64_t pixels, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
