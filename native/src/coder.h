// Sparse coding of rows under a codebook, and the sums that a codebook is learned from.
//
// A row f is coded as non-negative weights w of at most K atoms so that w C points as nearly as possible along f.
// The scale of w C does not matter for the angle, so this is non-negative least squares on a small support; it needs
// only the similarities s = C f and the Gram matrix G = C C^T, never the D dimensions.
//
// Results do not depend on the number of threads: every row is coded by itself, and sums run in the order of the rows.
#pragma once

#include <cstdint>

#include "threads.h"

namespace scoup {

struct CodeSettings {
    int slots;        // K, 1 .. kMaxSlots (coder_kernels.h)
    int swap_passes;  // how often each atom of a code is tried against all others after the greedy choice
};

// Codes of R rows: the atoms of each row by falling weight, -1 with weight 0 in slots that are not used. Weights are
// those of least squares, so w C is the part of the row that the atoms explain. cosines are its norm: for
// rows of unit norm the cosine between row and decoded code.
struct CodesOut {
    int32_t* support;  // [R, K]
    float* weights;    // [R, K]
    float* cosines;    // [R]
};

struct Matrix {
    const float* data;  // row after row
    int64_t rows, columns;
};

// Codes rows given by their similarities [R, L]. warm, if not null, holds supports [R, K] to start from
// in place of the greedy choice: atoms 0 .. L - 1, anything negative for none, repetitions ignored.
void code_similarities(Matrix similarities, const float* gram, const CodeSettings& settings, const int32_t* warm,
                       const CodesOut& out, int n_threads, const Interrupted& interrupted);

// The same from rows [R, D] and atoms [L, D]; similarities exist for a few rows at a time only.
void code_rows(Matrix rows, Matrix atoms, const CodeSettings& settings, const int32_t* warm, const CodesOut& out,
               int n_threads, const Interrupted& interrupted);

// out [R, N] = rows [R, D] others^T [D, N].
void row_products(Matrix rows, Matrix others, float* out, int n_threads, const Interrupted& interrupted);

// The moments of codes w (as above) of rows f, each row counted scale times:
// within [L, L] = sum of scale w w^T, toward [L, D] = sum of scale w f^T.
void code_moments(Matrix rows, const int32_t* support, const float* weights, int slots, const float* scale,
                  int64_t n_atoms, double* within, double* toward, int n_threads, const Interrupted& interrupted);

// Solves matrix [L, L] X = right [L, D] in place of right. False if the matrix is not positive definite; right is then
// as it was. Only the lower triangle of the matrix is read.
bool solve_positive_definite(const double* matrix, int64_t size, double* right, int64_t columns, int n_threads,
                             const Interrupted& interrupted);

}  // namespace scoup
