// Region sums of a view: A[i, c] = sum of e_i over the pixels of combination c.
#pragma once

#include <cstdint>

#include "buffer.h"
#include "region_records.h"
#include "threads.h"
#include "projection.h"

namespace scoup {

// Entries sorted by Gaussian, then combination; each pair once, weights positive.
struct RegionSums {
    Buffer<int32_t> gaussian, combination;
    Buffer<float> weight;
};

// The same whatever the number of threads.
RegionSums region_sums(const Projection& projection, const CombinationMap& map, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
