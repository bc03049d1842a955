// Values stretched to 0..1 between their smallest and their largest, the lower half cut off, and those above a threshold.
#pragma once

#include <cstdint>

#include "isa.h"

namespace scoup {

// Some of a row's values: those included, which is null where all are.
struct SomeValues {
    const float* values;
    const uint8_t* included;  // 0 and 1
    int64_t count;
};

// Of no value: infinity to minus infinity.
struct ValueSpan {
    float low, high;
    bool is_odd;  // one is not a number
};

struct SumAbove {
    int64_t count;
    double sum;
};

constexpr int kBins = 100;
constexpr int64_t kMostSelectionLanes = 16;

struct SelectionKernels {
    ValueSpan (*span)(const SomeValues& some);
    // Adds to bins [kBins] of 0..1 how many stretched values are in each; values below `least` are passed over.
    // Scratch [count + kMostSelectionLanes].
    void (*count)(const SomeValues& some, float low, float high, float least, int64_t* bins, float* scratch);
    // mask [count], 1 where a value is `least` or more; how many there are, and their sum in the order of the values.
    SumAbove (*above)(const SomeValues& some, float least, uint8_t* mask);
    // The smallest value from low to high whose stretched value is above the threshold; infinity if there is none.
    float (*first_above)(float low, float high, float threshold);
};

SCOUP_KERNEL_TABLE(SelectionKernels, selection_kernels)

}  // namespace scoup
