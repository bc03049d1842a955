// Unaligned vectors from and to memory. For *_kernels.cpp files only.
#pragma once

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

SCOUP_INLINE Floats load(const float* from) {
    Floats x;
    __builtin_memcpy(&x, from, sizeof x);
    return x;
}

SCOUP_INLINE void store(float* to, Floats x) { __builtin_memcpy(to, &x, sizeof x); }

}  // namespace
}  // namespace scoup::SCOUP_ISA
