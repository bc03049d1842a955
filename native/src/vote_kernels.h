// The vote over one Gaussian: region sums times codes, and what is largest of each sum.
#pragma once

#include <cstdint>

#include "isa.h"

namespace scoup {

constexpr int32_t kMostByInsertion = 32;  // of more, a sort finds the largest sooner

// How much a Gaussian paints of a combination of regions.
struct VoteEntry {
    uint32_t combination;  // among those of all views
    float weight;
};

// What a combination adds to a Gaussian's sums for each unit of weight.
struct Share {
    int32_t place;  // level * n_atoms + atom
    float weight;
};

// The combinations of all views and the codes of their regions.
struct CombinationCodes {
    int32_t levels, n_atoms;
    const int32_t* k;            // [levels] entries of a region's code
    int32_t k_of_all;            // their sum
    const Share* shares;         // [combinations, k_of_all]
    const int64_t* regions;      // [combinations, levels] rows of the codes, -1 for none
    const float* inverse_norms;  // [combinations, levels] of the decoded codes; 0 where they decode to nothing

    int64_t row() const { return int64_t(levels) * n_atoms; }
};

// What a Gaussian was found to be by the round before.
struct EarlierGaussian {
    const float* products;   // [levels, n_atoms] inner products of its decoded code, of norm 1, with the atoms
    const bool* is_coded;    // [levels]
    const float* sharpness;  // [levels]
};

struct VoteKernels {
    // sums [levels, n_atoms] += weights times codes.
    void (*add)(const VoteEntry* entries, int64_t count, const CombinationCodes& codes, float* sums);
    // The same, each region counted by its agreement with the round before. `factors`: scratch [levels * (count + 16)].
    void (*add_reweighted)(const VoteEntry* entries, int64_t count, const CombinationCodes& codes,
                           const EarlierGaussian& earlier, float* factors, float* sums);
    // 1 - cosine of the Gaussian and each region of one level that occurs in the entries; returns how many there are.
    int64_t (*deviations)(const VoteEntry* entries, int64_t count, const CombinationCodes& codes,
                          const EarlierGaussian& earlier, int32_t level, float* out);
    // out [n] = sum of weights[j] * rows[j].
    void (*combine_rows)(const float* const* rows, const float* weights, int32_t k, int64_t n, float* out);
    // The k <= kMostByInsertion largest positive ones of n values, largest first, the first of equals; returns how many.
    int32_t (*largest)(const float* values, int32_t n, int32_t k, float* found, int32_t* atoms);
    void (*widen)(const uint16_t* halves, int64_t count, float* out);
};

SCOUP_KERNEL_TABLE(VoteKernels, vote_kernels)

}  // namespace scoup
