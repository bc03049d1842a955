// Slots by rising depth.
#pragma once

#include <cstdint>

#include "buffer.h"
#include "projected.h"
#include "threads.h"

namespace scoup {

// A slot under its depth: the bits of the (positive) depth as float in the upper half, the slot in the lower.
using DepthKey = uint64_t;

inline DepthKey depth_key(float depth, uint32_t slot) {
    uint32_t bits;
    __builtin_memcpy(&bits, &depth, sizeof bits);
    return uint64_t(bits) << 32 | slot;
}
inline uint32_t slot_of(DepthKey key) { return uint32_t(key); }

// Sorts `keys`, which come in rising order of slots, by (depth in double precision, slot).
void sort_by_depth(Buffer<DepthKey>& keys, const Projected* projected, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
