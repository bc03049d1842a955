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

// Sorts `keys` by depth in double precision; equal ones by `ties` of their rows in the scene, or where that is null by
// the rows themselves.
void sort_by_depth(Buffer<DepthKey>& keys, const Projected* projected, const int64_t* ties, int n_threads,
                   const Interrupted& interrupted);

}  // namespace scoup
