// Sums over the codes of single Gaussians, without rendering.
#pragma once

#include <cstdint>

#include "code_kernels.h"
#include "isa.h"

namespace scoup {

// The score of each atom in each column, [columns, levels, index_values()] unless said otherwise: zeros beyond the atoms.
struct ScoreTable {
    const float* values;
    int32_t columns;
};

// What relevancy is made of beside the scores, each [N, levels].
struct KnownCosines {
    const float* inverse_norms;
    const float* best;  // cosines of the phrases that queries are compared with
    float temperature;
};

constexpr int64_t kSumRows = 64;  // Gaussians that are summed together
constexpr int64_t kMostLanes = 16;

// Scratch of one worker. A sum belongs to a Gaussian and a level; planes hold one entry of each sum, side by side.
struct SumScratch {
    int64_t stride;        // sums of kSumRows Gaussians, rounded up to kMostLanes
    const int32_t* level;  // [stride]: of each sum
    int32_t* atoms;        // [k, stride]: zeros beyond the Gaussians at work
    float* weights;        // [k, stride]: zeros, too
    float* row;            // [kSumRows * levels * k]
    float *norms, *best, *sums;  // [stride] each
    int32_t* starts;       // [stride]: where the table of each sum's level begins
};

// All of rows first .. last - 1; they return the largest index met. Sums of a block in which one is no atom are not made.
struct CodeSumKernels {
    // out [N, levels, columns], W A
    int32_t (*scores)(const GaussianCodes& codes, const ScoreTable& table, int64_t first, int64_t last,
                      const SumScratch& scratch, float* out);
    // out [N, levels], 1 / sqrt(W G W^T), 0 where that is not positive; grams [levels, n_atoms, n_atoms]
    int32_t (*inverse_norms)(const GaussianCodes& codes, const float* grams, int64_t first, int64_t last,
                             const SumScratch& scratch, float* out);
    // out [N, levels], the largest cosine of any column
    int32_t (*best)(const GaussianCodes& codes, const ScoreTable& table, const float* inverse_norms, int64_t first,
                    int64_t last, const SumScratch& scratch, float* out);
    // out [columns, levels, n]
    int32_t (*relevancy)(const GaussianCodes& codes, const ScoreTable& table, const KnownCosines& known, int64_t n,
                         int64_t first, int64_t last, const SumScratch& scratch, float* out);
    // The same to the last bit, from a table [levels, index_values(), kMostLanes].
    int32_t (*relevancy_of_many)(const GaussianCodes& codes, const ScoreTable& table, const KnownCosines& known, int64_t n,
                                 int64_t first, int64_t last, const SumScratch& scratch, float* out);
};

SCOUP_KERNEL_TABLE(CodeSumKernels, code_sum_kernels)

}  // namespace scoup
