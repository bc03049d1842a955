// Vectors of the instruction set at hand, in the vector extensions of GCC and clang. For *_kernels.cpp files only.
#pragma once

#include <cstdint>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define SCOUP_INLINE __attribute__((always_inline)) inline

namespace scoup::SCOUP_ISA {
namespace {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = int32_t __attribute__((vector_size(4 * kLanes)));

SCOUP_INLINE Floats all(float x) { return x - Floats{}; }

// Unaligned, from and to memory.
SCOUP_INLINE Floats load(const float* from) {
    Floats x;
    __builtin_memcpy(&x, from, sizeof x);
    return x;
}
SCOUP_INLINE void store(float* to, Floats x) { __builtin_memcpy(to, &x, sizeof x); }

SCOUP_INLINE Floats only(Ints mask, Floats x) { return (Floats)((Ints)x & mask); }

// The smaller and the larger of each lane; `b` where `a` is not a number.
SCOUP_INLINE Floats smaller(Floats a, Floats b) {
#if defined(__AVX512F__)
    return (Floats)_mm512_maskz_min_ps(0xffff, (__m512)a, (__m512)b);  // the plain forms make GCC warn
#elif defined(__AVX2__)
    return (Floats)_mm256_min_ps((__m256)a, (__m256)b);
#elif defined(__SSE2__)
    return (Floats)_mm_min_ps((__m128)a, (__m128)b);
#else
    return a < b ? a : b;
#endif
}
SCOUP_INLINE Floats larger(Floats a, Floats b) {
#if defined(__AVX512F__)
    return (Floats)_mm512_maskz_max_ps(0xffff, (__m512)a, (__m512)b);
#elif defined(__AVX2__)
    return (Floats)_mm256_max_ps((__m256)a, (__m256)b);
#elif defined(__SSE2__)
    return (Floats)_mm_max_ps((__m128)a, (__m128)b);
#else
    return a > b ? a : b;
#endif
}

SCOUP_INLINE Floats sqrt(Floats x) {
#if defined(__AVX512F__)
    return (Floats)_mm512_maskz_sqrt_ps(0xffff, (__m512)x);
#elif defined(__AVX2__)
    return (Floats)_mm256_sqrt_ps((__m256)x);
#elif defined(__SSE2__)
    return (Floats)_mm_sqrt_ps((__m128)x);
#else
    for (int i = 0; i < kLanes; ++i) x[i] = __builtin_sqrtf(x[i]);
    return x;
#endif
}

// 2^x for -126 < x <= 0 to 2e-7 relative; anything for smaller x. By 2^round(x) times a polynomial of the rest, the minimax
// of degree 5 on [-1/2, 1/2].
SCOUP_INLINE Floats exp2(Floats x) {
    constexpr float kRound = 12582912.0f;  // 1.5 * 2^23: adding it leaves the rounded x in the low bits
    const Floats shifted = x + kRound;
    const Floats rest = x - (shifted - kRound);
    Floats p = rest * 1.326472731e-3f + 9.671512991e-3f;
    p = p * rest + 5.550733581e-2f;
    p = p * rest + 2.402224243e-1f;
    p = p * rest + 6.931470037e-1f;
    p = p * rest + 1.0f;
    using Words = uint32_t __attribute__((vector_size(4 * kLanes)));  // may wrap around, for x that has no answer
    return (Floats)((Words)p + ((Words)shifted << 23));
}

SCOUP_INLINE float sum(Floats x) {
    using Four = float __attribute__((vector_size(16)));
    Four parts[kLanes / 4];
    __builtin_memcpy(parts, &x, sizeof x);
    for (int step = kLanes / 8; step > 0; step /= 2)
        for (int i = 0; i < step; ++i) parts[i] += parts[i + step];
    return (parts[0][0] + parts[0][2]) + (parts[0][1] + parts[0][3]);
}

// The lanes of a mask that are set, as bits.
SCOUP_INLINE uint32_t bits(Ints mask) {
#if defined(__AVX512DQ__)
    return _mm512_movepi32_mask((__m512i)mask);
#elif defined(__AVX2__)
    return uint32_t(_mm256_movemask_ps((__m256)mask));
#elif defined(__SSE2__)
    return uint32_t(_mm_movemask_ps((__m128)mask));
#else
    const Ints places = mask & Ints{1, 2, 4, 8};
    return uint32_t(places[0] + places[1] + places[2] + places[3]);
#endif
}

// The mask of the lanes whose bits are set.
SCOUP_INLINE Ints mask_of(uint32_t set) {
#if defined(__AVX512DQ__)
    return (Ints)_mm512_movm_epi32(__mmask16(set));
#else
    Ints own;
    for (int lane = 0; lane < kLanes; ++lane) own[lane] = 1 << lane;
    return (own & int32_t(set)) != 0;
#endif
}

SCOUP_INLINE bool any(Ints mask) { return bits(mask) != 0; }

SCOUP_INLINE int smaller(int a, int b) { return a < b ? a : b; }

}  // namespace
}  // namespace scoup::SCOUP_ISA
