// Sums over codes for Python; scoup/scene/code_sums.py is their only user.
#include <nanobind/nanobind.h>

#include <stdexcept>

#include "arrays.h"
#include "code_arrays.h"
#include "code_sums.h"
#include "python_signals.h"

namespace nb = nanobind;

namespace scoup {
namespace {

// Codes, and scores [levels, n_atoms, columns] of their atoms.
struct ScoredCodes {
    int64_t n;
    GaussianCodes codes;
    AtomScores scores;

    ScoredCodes(const Array& indices, const Array& weights, const Array& table)
        : n(indices.ndim() > 0 ? int64_t(indices.shape(0)) : 0), codes{}, scores{} {
        if (table.ndim() != 3) throw std::invalid_argument("scores must have three axes");
        const auto n_atoms = int64_t(table.shape(1)), columns = int64_t(table.shape(2));
        codes = gaussian_codes(n, indices, weights, n_atoms);
        if (columns > 65536) throw std::invalid_argument("too many columns of scores");
        scores = {data_of<float>(table, "scores", {codes.levels, n_atoms, columns}), int32_t(columns)};
    }

    int64_t sums() const { return n * codes.levels; }
    const float* known(const Array& array, const char* name) const { return data_of<float>(array, name, {n, codes.levels}); }
};

nb::object py_code_scores(const Array& indices, const Array& weights, const Array& scores, int threads) {
    const ScoredCodes all(indices, weights, scores);
    Buffer<float> out(all.sums() * all.scores.columns);
    without_lock([&] { code_scores(all.n, all.codes, all.scores, out.data(), sane(threads), python_signals()); });
    return to_numpy(std::move(out), {size_t(all.n), size_t(all.codes.levels), size_t(all.scores.columns)});
}

nb::object py_inverse_code_norms(const Array& indices, const Array& weights, const Array& grams, int threads) {
    if (grams.ndim() != 3) throw std::invalid_argument("grams must have three axes");
    const auto n = int64_t(indices.ndim() > 0 ? indices.shape(0) : 0), n_atoms = int64_t(grams.shape(1));
    const GaussianCodes codes = gaussian_codes(n, indices, weights, n_atoms);
    const float* products = data_of<float>(grams, "grams", {codes.levels, n_atoms, n_atoms});
    Buffer<float> out(n * codes.levels);
    without_lock([&] { inverse_code_norms(n, codes, products, out.data(), sane(threads), python_signals()); });
    return to_numpy(std::move(out), {size_t(n), size_t(codes.levels)});
}

nb::object py_best_code_cosines(const Array& indices, const Array& weights, const Array& scores, const Array& inverse_norms,
                                int threads) {
    const ScoredCodes all(indices, weights, scores);
    const float* norms = all.known(inverse_norms, "inverse_norms");
    Buffer<float> out(all.sums());
    without_lock([&] {
        best_code_cosines(all.n, all.codes, all.scores, norms, out.data(), sane(threads), python_signals());
    });
    return to_numpy(std::move(out), {size_t(all.n), size_t(all.codes.levels)});
}

nb::object py_code_relevancy(const Array& indices, const Array& weights, const Array& scores, const Array& inverse_norms,
                             const Array& best, float temperature, int threads) {
    const ScoredCodes all(indices, weights, scores);
    const KnownCosines known{all.known(inverse_norms, "inverse_norms"), all.known(best, "best"), temperature};
    Buffer<float> out(all.sums() * all.scores.columns);
    without_lock([&] {
        code_relevancy(all.n, all.codes, all.scores, known, out.data(), sane(threads), python_signals());
    });
    return to_numpy(std::move(out), {size_t(all.scores.columns), size_t(all.codes.levels), size_t(all.n)});
}

}  // namespace

void bind_code_sums(nb::module_& m) {
    m.def("code_scores", &py_code_scores, nb::arg("indices"), nb::arg("weights"), nb::arg("scores"), nb::arg("threads"));
    m.def("inverse_code_norms", &py_inverse_code_norms, nb::arg("indices"), nb::arg("weights"), nb::arg("grams"),
          nb::arg("threads"));
    m.def("best_code_cosines", &py_best_code_cosines, nb::arg("indices"), nb::arg("weights"), nb::arg("scores"),
          nb::arg("inverse_norms"), nb::arg("threads"));
    m.def("code_relevancy", &py_code_relevancy, nb::arg("indices"), nb::arg("weights"), nb::arg("scores"),
          nb::arg("inverse_norms"), nb::arg("best"), nb::arg("temperature"), nb::arg("threads"));
}

}  // namespace scoup
