// Box means of maps and the masks that relevancy makes: what scoup/query/smoothing.py says in torch, to the last bit. Each map
// is one chunk of work.
#pragma once

#include <cstdint>

#include "smoothing_kernels.h"
#include "threads.h"

namespace scoup {

// [count, height, width]
struct Maps {
    const float* values;
    int64_t count;
    int32_t height, width;

    int64_t pixels() const { return int64_t(height) * width; }
};

constexpr int32_t kMostKernel = 1024;  // scratch is kernel + 1 rows, and counts of pixels are compared in 32 bits

// out [count, height, width]. With `reflect` the image is mirrored at its edge pixels; otherwise the mean is over the
// pixels of the box inside.
void box_means(const Maps& maps, int32_t kernel, bool reflect, float* out, int n_threads, const Interrupted& interrupted);

// thresholds [count]; smoothed and masks [count, height, width]
void level_masks(const Maps& relevancy, const float* averaged, const float* thresholds, int32_t smoothing,
                 float* smoothed, uint8_t* masks, int n_threads, const Interrupted& interrupted);

// out [count]
void level_sums(const Maps& smoothed, const uint8_t* masks, LevelSums* out, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
