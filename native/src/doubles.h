// A register of doubles. For *_kernels.cpp files only.
#pragma once

#include <cstdint>

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr int kGroup = kLanes / 2;  // longer vectors than registers are converted number by number
using Doubles = double __attribute__((vector_size(8 * kGroup)));
using Longs = int64_t __attribute__((vector_size(8 * kGroup)));
using Singles = float __attribute__((vector_size(4 * kGroup)));
using Halves = int32_t __attribute__((vector_size(4 * kGroup)));

SCOUP_INLINE Doubles doubles(const float* from) {
    Singles x;
    __builtin_memcpy(&x, from, sizeof x);
    return __builtin_convertvector(x, Doubles);
}
SCOUP_INLINE void store_singles(float* to, Doubles x) {
    const Singles singles = __builtin_convertvector(x, Singles);
    __builtin_memcpy(to, &singles, sizeof singles);
}

SCOUP_INLINE Doubles load(const double* from) {
    Doubles x;
    __builtin_memcpy(&x, from, sizeof x);
    return x;
}
SCOUP_INLINE void store(double* to, Doubles x) { __builtin_memcpy(to, &x, sizeof x); }

// The lanes of a mask that are set, as bits.
SCOUP_INLINE uint32_t bits(Longs mask) {
#if defined(__AVX512DQ__)
    return _mm512_movepi64_mask((__m512i)mask);
#elif defined(__AVX2__)
    return uint32_t(_mm256_movemask_pd((__m256d)mask));
#elif defined(__SSE2__)
    return uint32_t(_mm_movemask_pd((__m128d)mask));
#else
    return uint32_t((mask[0] & 1) + (mask[1] & 2));
#endif
}

template <double (*function)(double)>
SCOUP_INLINE Doubles each(Doubles x) {
    for (int i = 0; i < kGroup; ++i) x[i] = function(x[i]);
    return x;
}
SCOUP_INLINE double root(double x) { return __builtin_sqrt(x); }
SCOUP_INLINE Doubles sqrt(Doubles x) { return each<root>(x); }
SCOUP_INLINE Doubles at_least(Doubles x, Doubles low) { return x > low ? x : low; }
SCOUP_INLINE Doubles at_most(Doubles x, Doubles high) { return x < high ? x : high; }

}  // namespace
}  // namespace scoup::SCOUP_ISA
