// Region sums of a view: A[i, r] = sum of e_i over the pixels of region r.
#pragma once

#include <cstdint>

#include "buffer.h"
#include "region_records.h"
#include "threads.h"
#include "view.h"

namespace scoup {

// Triplets sorted by Gaussian, then key = level * stride + region; each pair once.
struct RegionWeights {
    int64_t count = 0;
    Buffer<int64_t> gaussian, key;  // only the first `count` entries are written
    Buffer<float> weight;
};

RegionWeights region_weights(const View& view, const LabelMaps& maps, int64_t stride, int n_threads,
                             const Interrupted& interrupted);

}  // namespace scoup
