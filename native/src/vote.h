// The vote: the k largest entries of each accumulator, scaled to sum 1.
#pragma once

#include <cstdint>

#include "threads.h"

namespace scoup {

// sums [rows, n_atoms] -> indices [rows, k] (one of the two forms) and weights [rows, k]: positive entries only, largest
// first, equal ones by rising atom; the rest is zero. Needs 1 <= k <= n_atoms.
struct Vote {
    const float* sums;
    int64_t rows;
    int32_t n_atoms, k;
    uint8_t* indices8;
    uint16_t* indices16;
    float* weights;
};

void vote(const Vote& task, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
