// float16 as float32. For *_kernels.cpp files only.
#pragma once

#include <cstdint>

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

SCOUP_INLINE float from_half(uint16_t half) {
    const uint32_t sign = uint32_t(half & 0x8000) << 16;
    const uint32_t rest = uint32_t(half & 0x7fff) << 13;
    // The exponent is rebiased by a product, which is right for subnormal numbers, too.
    const uint32_t bits = rest >= 0x0f800000 ? rest | 0x7f800000 : rest;
    float value;
    __builtin_memcpy(&value, &bits, sizeof value);
    value = rest >= 0x0f800000 ? value : value * 0x1p112f;
    uint32_t out;
    __builtin_memcpy(&out, &value, sizeof out);
    out |= sign;
    __builtin_memcpy(&value, &out, sizeof value);
    return value;
}

// Stored weights as float32: where they lie, or written to `out`.
SCOUP_INLINE const float* from_stored(const float* weights, int, float*) { return weights; }
SCOUP_INLINE const float* from_stored(const uint16_t* halves, int count, float* out) {
    int i = 0;
#if defined(__F16C__)
    for (; i + 8 <= count; i += 8) _mm256_storeu_ps(out + i, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i*)(halves + i))));
    if (i + 4 <= count) {
        _mm_storeu_ps(out + i, _mm_cvtph_ps(_mm_loadl_epi64((const __m128i*)(halves + i))));
        i += 4;
    }
#endif
    for (; i < count; ++i) out[i] = from_half(halves[i]);
    return out;
}

}  // namespace
}  // namespace scoup::SCOUP_ISA
