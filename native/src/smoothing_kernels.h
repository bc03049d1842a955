// Box means and masks of one map, by rows.
#pragma once

#include <cstdint>

#include "isa.h"

namespace scoup {

// A box of `kernel` x `kernel` pixels about every pixel of a map, worked out once for all maps of a size.
//
// Along each axis the map is thought of as padded: `zeros` zeros, then `n_values` pixels of the map, then zeros up to
// size + kernel entries. The mean of a box is a difference of two running sums, `kernel` entries apart.
struct BoxAxis {
    int32_t size, kernel, zeros, n_values;
    const int32_t* source;  // [n_values] pixels along the axis
    const double* count;    // [size] what each difference is divided by
};

struct BoxScratch {
    float* nothing;  // [width] zeros
    double* sums;    // [kRowsAtOnce, width + kernel] running sums along rows
    double* down;    // [kernel + 1, width] running sums of the latest row means, down the columns
};

constexpr int32_t kRowsAtOnce = 4;  // additions of one row wait for each other; those of four rows do not

// How relevancy becomes a mask.
struct MaskRule {
    float threshold;
    int32_t smoothing;  // side of the box that smooths the mask
};

struct MaskScratch {
    uint8_t* above;   // [height, width]
    int32_t* counts;  // [width] of pixels above in the box's rows
    int32_t* sums;    // [width + 1] running sums of those
};

// Of one level: the largest smoothed relevancy, pixels of the mask, and the sum of smoothed relevancy over them.
struct LevelSums {
    float peak;
    int64_t area;
    double sum;
};

struct SmoothingKernels {
    void (*box_mean)(const float* map, const BoxAxis& across, const BoxAxis& along, const BoxScratch& scratch, float* out);
    // smoothed = the mean of relevancy and its box mean; mask = the majority of pixels that are above the threshold.
    void (*mask)(const float* relevancy, const float* averaged, int32_t width, int32_t height, const MaskRule& rule,
                 const MaskScratch& scratch, float* smoothed, uint8_t* mask);
    LevelSums (*sums)(const float* smoothed, const uint8_t* mask, int64_t pixels);
};

SCOUP_KERNEL_TABLE(SmoothingKernels, smoothing_kernels)

}  // namespace scoup
