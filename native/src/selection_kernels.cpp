#include "selection_kernels.h"

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

using Bytes = int8_t __attribute__((vector_size(kLanes)));

// All lanes, or those of 0 and 1 that are 1.
SCOUP_INLINE Ints members(const uint8_t* included, int64_t i) {
    if (included == nullptr) return ~Ints{};
    Bytes bytes;
    __builtin_memcpy(&bytes, included + i, sizeof bytes);
    return -__builtin_convertvector(bytes, Ints);
}

SCOUP_INLINE bool member(const SomeValues& some, int64_t i) { return some.included == nullptr || some.included[i] != 0; }

// In float64, in which 1e-9 does not vanish beside the range.
SCOUP_INLINE float stretched(float value, double low, double range) {
    const double twice = 2 * ((double(value) - low) / range) - 1;
    return float(twice < 0 ? 0.0 : twice > 1 ? 1.0 : twice);
}

SCOUP_INLINE double range_of(float low, float high) { return double(high) - double(low) + 1e-9; }

ValueSpan span(const SomeValues& some) {
    const float infinity = __builtin_inff();
    Floats lows = all(infinity), highs = all(-infinity);
    Ints odd{};
    int64_t i = 0;
    for (; i + kLanes <= some.count; i += kLanes) {
        const Ints own = members(some.included, i);
        const Floats value = load(some.values + i);
        lows = smaller(only(own, value) + only(~own, all(infinity)), lows);
        highs = larger(only(own, value) - only(~own, all(infinity)), highs);
        odd |= own & (value != value);
    }
    ValueSpan found{infinity, -infinity, any(odd)};
    for (int lane = 0; lane < kLanes; ++lane) {
        found.low = lows[lane] < found.low ? lows[lane] : found.low;
        found.high = highs[lane] > found.high ? highs[lane] : found.high;
    }
    for (; i < some.count; ++i) {
        if (!member(some, i)) continue;
        const float value = some.values[i];
        found.low = value < found.low ? value : found.low;
        found.high = value > found.high ? value : found.high;
        found.is_odd |= value != value;
    }
    return found;
}

// Values that count, one after the other.
int64_t gather_from(const SomeValues& some, float least, float* out) {
    int64_t count = 0, i = 0;
    for (; i + kLanes <= some.count; i += kLanes) {
        const Floats value = load(some.values + i);
        uint32_t lanes = bits(members(some.included, i) & (value >= least));
#if defined(__AVX512F__)
        if (lanes == 0) continue;
        _mm512_storeu_ps(out + count, _mm512_maskz_compress_ps(__mmask16(lanes), (__m512)value));
        count += __builtin_popcount(lanes);
#else
        for (; lanes != 0; lanes &= lanes - 1) out[count++] = some.values[i + __builtin_ctz(lanes)];
#endif
    }
    for (; i < some.count; ++i)
        if (member(some, i) && some.values[i] >= least) out[count++] = some.values[i];
    return count;
}

void count(const SomeValues& some, float low, float high, float least, int64_t* bins, float* scratch) {
    const int64_t found = gather_from(some, least, scratch);
    const double range = range_of(low, high);
    for (int64_t i = 0; i < found; ++i) scratch[i] = stretched(scratch[i], low, range) * float(kBins);
    int32_t counts[2][kBins] = {};  // two by turns: neighbours often fall into the same bin, and would wait for each other
    for (int64_t i = 0; i < found; ++i) {
        const auto bin = int32_t(scratch[i]);
        ++counts[i % 2][bin < kBins ? bin : kBins - 1];
    }
    for (int bin = 0; bin < kBins; ++bin) bins[bin] += counts[0][bin] + counts[1][bin];
}

SumAbove above(const SomeValues& some, float least, uint8_t* mask) {
    SumAbove found{0, 0};
    int64_t i = 0;
    for (; i + kLanes <= some.count; i += kLanes) {
        const Ints own = members(some.included, i) & (load(some.values + i) >= least);
        const Bytes ones = -__builtin_convertvector(own, Bytes);
        __builtin_memcpy(mask + i, &ones, sizeof ones);
        for (uint32_t lanes = bits(own); lanes != 0; lanes &= lanes - 1, ++found.count)
            found.sum += double(some.values[i + __builtin_ctz(lanes)]);
    }
    for (; i < some.count; ++i) {
        mask[i] = member(some, i) && some.values[i] >= least;
        if (mask[i] != 0) ++found.count, found.sum += double(some.values[i]);
    }
    return found;
}

// Floats in order, as whole numbers.
SCOUP_INLINE int64_t place_of(float value) {
    int32_t bits;
    __builtin_memcpy(&bits, &value, sizeof bits);
    return bits >= 0 ? bits : int64_t(-0x7fffffff) - 1 - bits;
}
SCOUP_INLINE float value_at(int64_t place) {
    const auto bits = int32_t(place >= 0 ? place : int64_t(-0x7fffffff) - 1 - place);
    float value;
    __builtin_memcpy(&value, &bits, sizeof value);
    return value;
}

float first_above(float low, float high, float threshold) {
    const double range = range_of(low, high);
    if (!(stretched(high, low, range) > threshold)) return __builtin_inff();
    // Stretching keeps the order, with all of its roundings.
    int64_t below = place_of(low) - 1, from = place_of(high);
    while (from - below > 1) {
        const int64_t middle = below + (from - below) / 2;
        (stretched(value_at(middle), low, range) > threshold ? from : below) = middle;
    }
    return value_at(from);
}

}  // namespace

const SelectionKernels selection_kernels = {span, count, above, first_above};

}  // namespace scoup::SCOUP_ISA
