// What the coder does for each instruction set; coder.cpp cuts the work and owns the memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "isa.h"

namespace scoup {

constexpr int kPad = 32;       // rows of Gram space are padded to multiples of this
constexpr int kMaxSlots = 64;  // most atoms of a code

// The atoms in Gram space. Rows of L numbers are padded to `stride`, a multiple of every vector length, so that kernels
// need no tails; the padding is zeros, except in `floor`.
struct CodeProblem {
    const float* gram;   // [L, stride]
    const float* norms;  // [stride] squared norms of the atoms, the diagonal of gram
    const float* floor;  // [stride] an atom with no more than this left of its squared norm depends on those chosen
    int64_t n_atoms, stride;
    int slots, swap_passes;
};

// Scratch of one worker: `left` and `residual` [stride], `directions` [slots, stride].
struct CoderScratch {
    float *left, *residual, *directions;
};

struct CoderKernels {
    // Codes one row from its similarities [stride]; see CodesOut and code_similarities for support, weights and warm.
    // Returns the norm of what is explained.
    float (*code)(const CodeProblem& problem, const CoderScratch& scratch, const float* similarities,
                  const int32_t* warm, int32_t* support, float* weights);
};

struct ProductKernels {
    // Columns of a panel, a divisor of kPad: `others` are packed as [panels, depth, panel].
    int panel;
    // Packs rows [count, depth] into whole panels, the last filled up with zeros.
    void (*pack)(const float* rows, int64_t count, int64_t depth, float* packed);
    // out[r, c] = sum over d of rows[r, d] others[c, d], summed in rising d for every number alike. out has room for
    // whole panels: `stride` is a multiple of the panel.
    void (*multiply)(const float* rows, int64_t count, int64_t depth, const float* packed, int64_t n_panels, float* out,
                     int64_t stride);
    // The same products for a few others, not packed, summed in another order: out is [count, n_others].
    void (*dots)(const float* rows, int64_t count, int64_t depth, const float* others, int64_t n_others, float* out);
    // sums[support[r, k], :] += scale[r] weights[r, k] rows[r, first ..] over `width` columns, in the order of
    // rows. sums is [L, width].
    void (*pull)(const float* rows, int64_t count, int64_t depth, int64_t first, int64_t width, const int32_t* support,
                 const float* weights, int slots, const float* scale, float* sums);
    // Lower Cholesky factor of matrix [size, size] in place. False if it is not positive definite.
    bool (*factor)(double* matrix, int64_t size);
    // Solves with that factor for `width` columns of right, rows `stride` apart, in place.
    void (*substitute)(const double* factor, int64_t size, double* right, int64_t stride, int64_t width);
};

SCOUP_KERNEL_TABLE(CoderKernels, coder_kernels)
SCOUP_KERNEL_TABLE(ProductKernels, coder_product_kernels)

}  // namespace scoup
