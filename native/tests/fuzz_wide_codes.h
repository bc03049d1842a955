// Rounds over the weights of wide codes: well formed whatever comes in, optimal where it can be.
#pragma once

#include <cmath>

#include "fuzz_coder.h"
#include "wide_codes.h"

namespace scoup {

// Karush, Kuhn and Tucker: no atom at zero would help, and none in use could be moved.
inline void check_optimal(const Exact<float>& similarities, const Exact<float>& gram, const Exact<float>& weights,
                          int64_t n_atoms, double tolerance) {
    const int64_t rows = n_atoms == 0 ? 0 : weights.size() / n_atoms;
    for (int64_t r = 0; r < rows; ++r)
        for (int64_t atom = 0; atom < n_atoms; ++atom) {
            if (!(gram[atom * n_atoms + atom] > 0)) continue;
            double pull = similarities[r * n_atoms + atom];
            for (int64_t other = 0; other < n_atoms; ++other)
                pull -= double(gram[atom * n_atoms + other]) * weights[r * n_atoms + other];
            check(pull <= tolerance, "wide codes: an atom at zero would help");
            if (weights[r * n_atoms + atom] > 0) check(pull >= -tolerance, "wide codes: a weight is too large");
        }
}

inline void fuzz_wide_codes(Random& random) {
    const int64_t dim = random.one_of<int64_t>({0, 1, 5, 16, 64}), n_atoms = random.one_of<int64_t>({0, 1, 3, 9, 33, 70});
    const int64_t count = random.one_of<int64_t>({0, 1, 15, 16, 17, 49});
    const int threads = int(random.between(1, 4));
    const double hostile = random.one_of({0.0, 0.0, 0.01, 0.2});
    const Exact<float> rows = random_rows(random, count, dim, hostile);
    Exact<float> atoms = random_rows(random, n_atoms, dim, hostile);
    const int64_t unused = n_atoms > 1 && random.chance(0.5) ? random.below(n_atoms) : -1;
    for (int64_t d = 0; unused >= 0 && d < dim; ++d) atoms[unused * dim + d] = 0;
    Exact<float> similarities(random, count * n_atoms), gram(random, n_atoms * n_atoms);
    row_products({rows.data(), count, dim}, {atoms.data(), n_atoms, dim}, similarities.data(), 1, never);
    row_products({atoms.data(), n_atoms, dim}, {atoms.data(), n_atoms, dim}, gram.data(), 1, never);
    const bool any_matrix = random.chance(0.2);  // in the place of a Gram matrix
    for (int64_t i = 0; any_matrix && i < gram.size(); ++i)
        gram[i] = random.chance(0.1) ? hostile_float(random) : float(random.uniform(-1, 1));

    const auto weights_of = [&](const Descent& descent, int n_threads, const Interrupted& interrupted) {
        Exact<float> weights(random, count * n_atoms);
        wide_weights({similarities.data(), count, n_atoms}, gram.data(), descent, weights.data(), n_threads, interrupted);
        return weights;
    };
    const Descent usual{int32_t(random.between(0, 30)), 1e-3f};
    const Exact<float> weights = weights_of(usual, threads, never);
    const double seconds =
        seconds_of([&] { check_same(weights, weights_of(usual, 1, never), "wide codes: threads"); });
    if (random.chance(0.05)) interrupt(random, seconds, [&](const Interrupted& stop) { weights_of(usual, threads, stop); });
    for (int64_t i = 0; i < weights.size(); ++i) {
        check(weights[i] >= 0, "wide codes: negative weight");  // nor NaN
        if (usual.sweeps == 0) check(weights[i] == 0, "wide codes: weights without a sweep");
        if (!any_matrix && i % n_atoms == unused) check(weights[i] == 0, "wide codes: an atom of norm zero is used");
    }
    if (hostile > 0 || any_matrix) return;
    check_finite(weights, "wide codes: weights");
    // Once no weight moves by more than the tolerance, no pull is larger than as many steps of it.
    constexpr float kTolerance = 1e-5f;
    check_optimal(similarities, gram, weights_of({5000, kTolerance}, threads, never), n_atoms,
                  1e-3 + kTolerance * double(n_atoms));
}

}  // namespace scoup
