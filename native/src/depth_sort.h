// Slots by rising depth.
#pragma once

#include <cstdint>
#include <vector>

#include "projected.h"

namespace scoup {

// A slot under its depth: the bits of the (positive) depth as float in the upper half, the slot in the lower.
using DepthKey = uint64_t;

inline DepthKey depth_key(float depth, uint32_t slot) {
    uint32_t bits;
    __builtin_memcpy(&bits, &depth, sizeof bits);
    return uint64_t(bits) << 32 | slot;
}
inline uint32_t slot_of(DepthKey key) { return uint32_t(key); }

// Sorts one list after the other; each worker needs its own.
class DepthSort {
  public:
    // Slots go by their depth in double precision; equal ones by `ties` of their rows in the scene, or where that is
    // null by the rows themselves.
    DepthSort(const Projected* projected, const int64_t* ties) : projected_(projected), ties_(ties) {}

    // Sorts `n` keys and writes their slots.
    void operator()(DepthKey* keys, int64_t n, uint32_t* slots);

  private:
    bool before(DepthKey a, DepthKey b) const;
    void sort(DepthKey* keys, int64_t n);

    const Projected* projected_;
    const int64_t* ties_;
    std::vector<DepthKey> other_;
    std::vector<uint32_t> places_;
};

}  // namespace scoup
