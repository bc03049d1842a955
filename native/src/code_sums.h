// Sums over the codes of Gaussians 0 .. n - 1, seen or not: what scoup/scene/code_sums.py says. All throw std::invalid_argument
// if a code refers to an atom there is not.
#pragma once

#include "code_sum_kernels.h"
#include "threads.h"

namespace scoup {

// Scores of atoms, [levels, n_atoms, columns].
struct AtomScores {
    const float* values;
    int32_t columns;
};

void check_atoms(int32_t largest, int32_t n_atoms);

// out [n, levels, columns]
void code_scores(int64_t n, const GaussianCodes& codes, const AtomScores& scores, float* out, int n_threads,
                 const Interrupted& interrupted);

// grams [levels, n_atoms, n_atoms]; out [n, levels]
void inverse_code_norms(int64_t n, const GaussianCodes& codes, const float* grams, float* out, int n_threads,
                        const Interrupted& interrupted);

// inverse_norms and out [n, levels]; minus infinity times the norm without a column
void best_code_cosines(int64_t n, const GaussianCodes& codes, const AtomScores& scores, const float* inverse_norms,
                       float* out, int n_threads, const Interrupted& interrupted);

// out [columns, levels, n]
void code_relevancy(int64_t n, const GaussianCodes& codes, const AtomScores& scores, const KnownCosines& known, float* out,
                    int n_threads, const Interrupted& interrupted);

}  // namespace scoup
