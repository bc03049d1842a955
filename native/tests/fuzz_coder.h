// Rounds over the sparse coder and the products it is made of.
#pragma once

#include <algorithm>
#include <set>

#include "coder.h"
#include "fuzzing.h"

namespace scoup {

inline Exact<float> random_rows(Random& random, int64_t count, int64_t dim, double hostile) {
    Exact<float> rows(random, count * dim);
    for (int64_t r = 0; r < count; ++r) {
        float* row = rows.data() + r * dim;
        double norm2 = 1e-30;
        for (int64_t d = 0; d < dim; ++d) {
            row[d] = float(random.uniform(-0.4, 1));
            norm2 += double(row[d]) * row[d];
        }
        for (int64_t d = 0; d < dim; ++d) row[d] = float(row[d] / std::sqrt(norm2));
    }
    if (hostile == 0) return rows;
    for (int64_t i = 0; i < rows.size(); ++i)
        if (random.chance(hostile)) rows[i] = hostile_float(random);
    for (int64_t r = 1; r < count; ++r) {
        const double kind = random.uniform();
        float* row = rows.data() + r * dim;
        if (kind < hostile) std::fill(row, row + dim, 0.0f);
        else if (kind < 2 * hostile) std::copy(rows.data(), rows.data() + dim, row);  // equal to the first one
    }
    return rows;
}

struct Codes {
    Exact<int32_t> support;
    Exact<float> weights, cosines;

    Codes(Random& random, int64_t rows, int64_t slots)
        : support(random, rows * slots), weights(random, rows * slots), cosines(random, rows) {}
    CodesOut out() { return {support.data(), weights.data(), cosines.data()}; }
};

inline void check_codes(const Codes& codes, int64_t rows, int64_t slots, int64_t n_atoms, bool good) {
    for (int64_t r = 0; r < rows; ++r) {
        std::set<int32_t> seen;
        for (int64_t i = r * slots; i < (r + 1) * slots; ++i) {
            const int32_t atom = codes.support[i];
            check(atom >= -1 && atom < n_atoms, "coder: no such atom");
            if (atom < 0) check(codes.weights[i] == 0, "coder: an unused slot has a weight");
            if (atom < 0) continue;
            check(codes.weights[i] >= 0, "coder: negative weight");
            check(i == r * slots || codes.support[i - 1] >= 0, "coder: a hole between slots");
            check(i == r * slots || codes.weights[i - 1] >= codes.weights[i], "coder: weights rise");
            if (good) check(seen.insert(atom).second, "coder: an atom twice");
        }
        // Above 1 by rounding, where nearly dependent atoms explain a row wholly: 1e-7 in the Gram matrix of what may be
        // 1e-5 is a hundredth.
        if (good) check_near(codes.cosines[r], 0.5, 0.55, "coder: cosine");
    }
    if (good) check_finite(codes.weights, "coder: weights");
}

inline void check_same_codes(const Codes& a, const Codes& b, const std::string& what) {
    check_same(a.support, b.support, what);
    check_same(a.weights, b.weights, what);
    check_same(a.cosines, b.cosines, what);
}

inline void fuzz_moments(Random& random, const Exact<float>& rows, int64_t dim, const Codes& codes, int slots, int64_t n_atoms,
                         int threads, bool good) {
    const int64_t count = codes.cosines.size();
    Exact<float> scale(random, count);
    for (int64_t r = 0; r < count; ++r) scale[r] = good ? float(random.uniform()) : hostile_float(random);
    const auto moments = [&](int n_threads, Exact<double>& within, Exact<double>& toward) {
        code_moments({rows.data(), count, dim}, codes.support.data(), codes.weights.data(), slots, scale.data(), n_atoms,
                     within.data(), toward.data(), n_threads, never);
    };
    Exact<double> within(random, n_atoms * n_atoms), toward(random, n_atoms * dim);
    Exact<double> within1(random, n_atoms * n_atoms), toward1(random, n_atoms * dim);
    moments(threads, within, toward);
    moments(1, within1, toward1);
    check_same(within, within1, "moments: threads");
    check_same(toward, toward1, "moments: threads");
    if (!good) return;
    for (int64_t r = 0; r < count; ++r)
        for (int i = 0; i < slots; ++i) {
            const int32_t atom = codes.support[r * slots + i];
            if (atom < 0) continue;
            const double weight = double(scale[r]) * codes.weights[r * slots + i];
            for (int64_t d = 0; d < dim; ++d) toward1[atom * dim + d] -= weight * rows[r * dim + d];
            for (int j = 0; j < slots; ++j) {
                const int32_t other = codes.support[r * slots + j];
                if (other >= 0) within1[atom * n_atoms + other] -= weight * codes.weights[r * slots + j];
            }
        }
    for (int64_t i = 0; i < within1.size(); ++i) check_near(within1[i], 0, 1e-4 * (1 + std::abs(within[i])), "moments");
    for (int64_t i = 0; i < toward1.size(); ++i) check_near(toward1[i], 0, 1e-3 * (1 + std::abs(toward[i])), "moments");
}

inline void fuzz_solve(Random& random, int threads) {
    const int64_t size = random.one_of<int64_t>({0, 1, 2, 17, 64}), columns = random.one_of<int64_t>({0, 1, 63, 65, 130});
    const bool hostile = random.chance(0.4);
    Exact<double> matrix(random, size * size), right(random, size * columns), root(random, size * size);
    for (int64_t i = 0; i < root.size(); ++i) root[i] = random.uniform(-1, 1);
    for (int64_t i = 0; i < size; ++i)
        for (int64_t j = 0; j < size; ++j) {
            matrix[i * size + j] = i == j ? 1 : 0;
            for (int64_t d = 0; d < size; ++d) matrix[i * size + j] += root[i * size + d] * root[j * size + d];
        }
    for (int64_t i = 0; i < right.size(); ++i) right[i] = random.uniform(-1, 1);
    for (int64_t i = 0; hostile && i < matrix.size(); ++i)
        if (random.chance(0.1)) matrix[i] = hostile_float(random);
    Exact<double> solved(random, right.size());
    if (right.size() > 0) std::memcpy(solved.data(), right.data(), size_t(right.size()) * sizeof(double));
    const bool positive = solve_positive_definite(matrix.data(), size, solved.data(), columns, threads, never);
    if (!positive) return check_same(solved, right, "solve: right has changed");
    if (hostile) return;
    for (int64_t i = 0; i < size; ++i)
        for (int64_t c = 0; c < columns; ++c) {
            double product = 0;
            for (int64_t j = 0; j < size; ++j) product += matrix[i * size + j] * solved[j * columns + c];
            check_near(product, right[i * columns + c], 1e-9, "solve");
        }
}

inline void fuzz_products(Random& random, const Exact<float>& rows, int64_t count, const Exact<float>& others, int64_t n_others,
                          int64_t dim, int threads, bool good) {
    Exact<float> out(random, count * n_others), alone(random, count * n_others);
    row_products({rows.data(), count, dim}, {others.data(), n_others, dim}, out.data(), threads, never);
    row_products({rows.data(), count, dim}, {others.data(), n_others, dim}, alone.data(), 1, never);
    check_same(out, alone, "products: threads");
    for (int64_t i = 0; good && i < out.size(); ++i) {
        double product = 0;
        for (int64_t d = 0; d < dim; ++d)
            product += double(rows[i / n_others * dim + d]) * double(others[i % n_others * dim + d]);
        check_near(out[i], product, 1e-4, "products");
    }
}

inline void fuzz_coder(Random& random) {
    // A few are large enough for threads, which small work does without.
    const bool large = random.chance(0.05);
    const int64_t dim = large ? 128 : random.one_of<int64_t>({0, 1, 5, 16, 64, 100});
    const int64_t n_atoms = large ? 100 : random.one_of<int64_t>({0, 1, 3, 9, 31, 32, 33, 70});
    const int64_t count = large ? 1500 : random.one_of<int64_t>({0, 1, 47, 48, 49, 130});
    const CodeSettings settings{int(random.one_of({1, 2, 3, 4, 5, 17, 64})), int(random.between(0, 3))};
    const int threads = int(random.between(1, 4));
    const double hostile = random.one_of({0.0, 0.0, 0.01, 0.2});
    const bool good = hostile == 0 && dim > 0;
    const Exact<float> rows = random_rows(random, count, dim, hostile), atoms = random_rows(random, n_atoms, dim, hostile);
    const Matrix f{rows.data(), count, dim}, c{atoms.data(), n_atoms, dim};
    fuzz_products(random, rows, count, atoms, n_atoms, dim, threads, good);

    Exact<int32_t> start(random, count * settings.slots);
    for (int64_t i = 0; i < start.size(); ++i) {
        start[i] = random.chance(0.3) || n_atoms == 0 ? random.one_of({-1, std::numeric_limits<int32_t>::min()})
                                                      : int32_t(random.below(n_atoms));
    }
    const int32_t* warm = random.chance(0.4) ? start.data() : nullptr;
    const auto coded = [&](int n_threads, const Interrupted& interrupted) {
        Codes codes(random, count, settings.slots);
        code_rows(f, c, settings, warm, codes.out(), n_threads, interrupted);
        return codes;
    };
    const Codes codes = coded(threads, never);
    check_codes(codes, count, settings.slots, n_atoms, good);
    const double seconds = seconds_of([&] { check_same_codes(codes, coded(1, never), "coder: threads"); });
    if (random.chance(0.05)) interrupt(random, seconds, [&](const Interrupted& stop) { coded(threads, stop); });
    fuzz_moments(random, rows, dim, codes, settings.slots, n_atoms, threads, good);

    // Any matrix may come in the place of a Gram matrix.
    Exact<float> similarities(random, count * n_atoms), gram(random, n_atoms * n_atoms);
    row_products(f, c, similarities.data(), 1, never);
    row_products(c, c, gram.data(), 1, never);
    const auto from_similarities = [&](bool sane) {
        Codes found(random, count, settings.slots);
        code_similarities({similarities.data(), count, n_atoms}, gram.data(), settings, warm, found.out(), threads, never);
        check_codes(found, count, settings.slots, n_atoms, sane);
        return found;
    };
    const Codes found = from_similarities(good);
    for (int64_t r = 0; good && r < count; ++r) check_near(found.cosines[r], codes.cosines[r], 0.05, "coder: similarities");
    for (int64_t i = 0; i < gram.size(); ++i) gram[i] = random.chance(0.1) ? hostile_float(random) : float(random.uniform(-1, 1));
    from_similarities(false);

    fuzz_solve(random, threads);
}

}  // namespace scoup
