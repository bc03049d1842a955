#include "depth_sort.h"

#include <algorithm>
#include <utility>

namespace scoup {

void DepthSort::operator()(DepthKey* keys, int64_t n, uint32_t* slots) {
    sort(keys, n);
    for (int64_t i = 0; i < n; ++i) slots[i] = slot_of(keys[i]);
}

// Depths that are equal as floats may differ as doubles.
inline bool DepthSort::before(DepthKey a, DepthKey b) const {
    if (a >> 32 != b >> 32) return a < b;
    const Projected &pa = projected_[slot_of(a)], &pb = projected_[slot_of(b)];
    if (pa.depth != pb.depth) return pa.depth < pb.depth;
    return ties_ != nullptr ? ties_[pa.id] < ties_[pb.id] : pa.id < pb.id;
}

// Two passes of a radix sort order all but the last bits of the depths; what is left are short runs.
void DepthSort::sort(DepthKey* keys, int64_t n) {
    constexpr int64_t kFew = 48, kMany = 8192;
    const auto in_order = [this](DepthKey a, DepthKey b) { return before(a, b); };
    if (n < kFew) {
        std::sort(keys, keys + n, in_order);
        return;
    }
    DepthKey lowest = keys[0], highest = keys[0];
    for (int64_t i = 1; i < n; ++i) lowest = std::min(lowest, keys[i]), highest = std::max(highest, keys[i]);
    lowest = lowest >> 32 << 32;
    int bits = 0;
    while (bits < 32 && (highest - lowest) >> 32 >> bits != 0) ++bits;
    const int digit_bits = n < kMany ? 9 : 11;
    const int low_shift = 32 + std::max(0, bits - 2 * digit_bits), high_shift = low_shift + digit_bits;
    const size_t digits = size_t(1) << digit_bits;
    const auto low = [=](DepthKey key) { return size_t((key - lowest) >> low_shift) & (digits - 1); };
    const auto high = [=](DepthKey key) { return size_t((key - lowest) >> high_shift); };

    places_.assign(2 * digits, 0);
    uint32_t *const low_places = places_.data(), *const high_places = low_places + digits;
    for (int64_t i = 0; i < n; ++i) ++low_places[low(keys[i])], ++high_places[high(keys[i])];
    uint32_t low_place = 0, high_place = 0;
    for (size_t d = 0; d < digits; ++d) {
        low_place += std::exchange(low_places[d], low_place);
        high_place += std::exchange(high_places[d], high_place);
    }
    if (other_.size() < size_t(n)) other_.resize(size_t(n) + size_t(n) / 4);
    for (int64_t i = 0; i < n; ++i) other_[low_places[low(keys[i])]++] = keys[i];
    for (int64_t i = 0; i < n; ++i) keys[high_places[high(other_[size_t(i)])]++] = other_[size_t(i)];

    const auto same_run = [=](int64_t a, int64_t b) { return (keys[a] - lowest) >> low_shift == (keys[b] - lowest) >> low_shift; };
    for (int64_t i = 1; i < n; ++i) {
        if (keys[i - 1] >> 32 < keys[i] >> 32) continue;  // runs that happen to be in order are left alone
        int64_t first = i - 1, end = i + 1;
        while (first > 0 && same_run(first - 1, i)) --first;
        while (end < n && same_run(end, i)) ++end;
        std::sort(keys + first, keys + end, in_order);
        i = end;
    }
}

}  // namespace scoup
