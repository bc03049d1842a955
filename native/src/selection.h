// Values above a threshold, row by row: what scoup/query/selection.py says in torch, to the last bit but for sums.
#pragma once

#include <cstdint>

#include "selection_kernels.h"
#include "threads.h"

namespace scoup {

// [count, length]; included is null where all are.
struct ValueRows {
    const float* values;
    const uint8_t* included;
    int64_t count, length;
};

// spans [count, 2]: infinity and minus infinity of no value, NaN where a value is not a number. bins [count, kBins]: of
// values from low + share (high - low) - 1e-6 on; zeros where the span is not finite.
void count_stretched(const ValueRows& rows, float share, float* spans, int64_t* bins, int n_threads, const Interrupted& interrupted);

// masks [count, length]: values that, stretched over their row's span [count, 2], are above its threshold [count].
void above_thresholds(const ValueRows& rows, const float* spans, const float* thresholds, uint8_t* masks, SumAbove* found,
                      int n_threads, const Interrupted& interrupted);

}  // namespace scoup
