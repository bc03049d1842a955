// Rounds over the codes of single Gaussians, against sums entry by entry.
#pragma once

#include "code_sums.h"
#include "fuzz_raster.h"

namespace scoup {

// All sums over some codes.
struct CodeSums {
    Exact<float> scores, norms, best, relevancy;

    CodeSums(Random& random, int64_t n, const GaussianCodes& codes, const float* grams, const AtomScores& table, int threads)
        : scores(random, n * codes.levels * table.columns), norms(random, n * codes.levels), best(random, n * codes.levels),
          relevancy(random, n * codes.levels * table.columns) {
        code_scores(n, codes, table, scores.data(), threads, never);
        inverse_code_norms(n, codes, grams, norms.data(), threads, never);
        best_code_cosines(n, codes, table, norms.data(), best.data(), threads, never);
        code_relevancy(n, codes, table, {norms.data(), best.data(), 10.0f}, relevancy.data(), threads, never);
    }
};

inline void fuzz_code_sums(Random& random, int threads) {
    const int64_t n = random.one_of<int64_t>({0, 1, 63, 64, 65, 200, 17000});
    const auto levels = int32_t(random.between(1, 4)), k = int32_t(random.between(0, 5));
    const int32_t n_atoms = random.one_of({1, 7, 64, 256, 257}), columns = int32_t(random.one_of({0, 1, 2, 3, 5, 16, 20}));
    const CodeArrays codes = random_codes(random, n * levels * k, n_atoms);
    GaussianCodes table = codes.table(levels, k, n_atoms);
    Exact<float> grams(random, int64_t(levels) * n_atoms * n_atoms), scores(random, int64_t(levels) * n_atoms * columns);
    for (int64_t a = 0; a < int64_t(levels) * n_atoms; ++a)
        for (int64_t b = 0; b < n_atoms; ++b) {  // symmetric
            const int64_t own = a % n_atoms, level = a / n_atoms;
            grams[a * n_atoms + b] = b < own ? grams[(level * n_atoms + b) * n_atoms + own] : float(random.uniform(0.1, 1));
        }
    for (int64_t i = 0; i < scores.size(); ++i) scores[i] = float(random.uniform(-1, 1));
    const AtomScores all{scores.data(), columns};
    const CodeSums found(random, n, table, grams.data(), all, threads), alone(random, n, table, grams.data(), all, 1);
    check_same(found.scores, alone.scores, "code scores: threads");
    check_same(found.norms, alone.norms, "code norms: threads");
    check_same(found.best, alone.best, "best cosines: threads");
    check_same(found.relevancy, alone.relevancy, "relevancy: threads");

    for (int64_t row = 0; row < n * levels; ++row) {
        const int64_t level = row % levels;
        double squared = 0, best = -1e30;
        for (int64_t i = row * k; i < (row + 1) * k; ++i)
            for (int64_t j = row * k; j < (row + 1) * k; ++j)
                squared += double(codes.weights[i]) * codes.weights[j] *
                           grams[(level * n_atoms + codes.index(i)) * n_atoms + codes.index(j)];
        check_near(found.norms[row], squared > 0 ? 1 / std::sqrt(squared) : 0, squared > 0 ? 1e-4 / std::sqrt(squared) : 0,
                   "code norms");
        for (int32_t c = 0; c < columns; ++c) {
            double expected = 0;
            for (int64_t i = row * k; i < (row + 1) * k; ++i)
                expected += double(codes.weights[i]) * scores[(level * n_atoms + codes.index(i)) * columns + c];
            check_near(found.scores[row * columns + c], expected, 1e-5, "code scores");
            best = std::max(best, expected * found.norms[row]);
            const double cosine = expected * found.norms[row] - found.best[row];
            check_near(found.relevancy[(c * levels + level) * n + row / levels], 1 / (1 + std::exp(-10 * cosine)), 1e-4,
                       "relevancy");
        }
        if (columns > 0) check_near(found.best[row], best, 1e-4 * (1 + std::abs(best)), "best cosine");
    }

    // Numbers of any kind, and atoms that there are not: refused where they are met, and never read beyond.
    Exact<uint16_t> half(random, n * levels * k), any16(random, n * levels * k);
    Exact<uint8_t> any8(random, n * levels * k);
    for (int64_t i = 0; i < half.size(); ++i)
        half[i] = uint16_t(random.bits()), any16[i] = uint16_t(random.bits()), any8[i] = uint8_t(random.bits());
    for (int64_t i = 0; i < grams.size(); ++i)
        if (random.chance(0.1)) grams[i] = hostile_float(random);
    table.weights = nullptr, table.half_weights = half.data();
    CodeSums(random, n, table, grams.data(), all, threads);
    table.indices8 = codes.bytes ? any8.data() : nullptr, table.indices16 = codes.bytes ? nullptr : any16.data();
    try {
        CodeSums(random, n, table, grams.data(), all, threads);
    } catch (const std::invalid_argument&) {
    }
    Exact<float> out(random, n * levels);
    try {
        inverse_code_norms(n, table, grams.data(), out.data(), threads, never);
    } catch (const std::invalid_argument&) {
    }
}

}  // namespace scoup
