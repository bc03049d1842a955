// The coder for Python; scoup/coding/native.py is its only user.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <string>

#include "arrays.h"
#include "coder.h"
#include "coder_kernels.h"
#include "python_signals.h"

namespace nb = nanobind;

namespace scoup {
namespace {

constexpr int64_t kMostAtoms = 65536;

int64_t length(const Array& array, size_t axis) { return axis < array.ndim() ? int64_t(array.shape(axis)) : 0; }

void check(int64_t value, const char* name, int64_t least, int64_t most) {
    if (value < least || value > most)
        throw std::invalid_argument(std::string(name) + " must be " + std::to_string(least) + " to " +
                                    std::to_string(most) + ", got " + std::to_string(value));
}

Matrix matrix(const Array& array, const char* name, int64_t columns = kAnySize) {
    return {data_of<float>(array, name, {kAnySize, columns}), length(array, 0), length(array, 1)};
}

// Supports [rows, slots] whose atoms exist.
const int32_t* supports(const Array& array, const char* name, int64_t rows, int64_t slots, int64_t n_atoms) {
    const auto* atoms = data_of<int32_t>(array, name, {rows, slots});
    for (int64_t i = 0; i < rows * slots; ++i)
        if (atoms[i] >= n_atoms)
            throw std::invalid_argument(std::string(name) + " holds atom " + std::to_string(atoms[i]) + " of " +
                                        std::to_string(n_atoms));
    return atoms;
}

// Checks the settings, then codes: run(settings, warm, out).
template <class Run>
nb::tuple coded(int64_t rows, int64_t n_atoms, int64_t slots, int64_t swap_passes, const std::optional<Array>& warm,
                const Run& run) {
    check(n_atoms, "the number of atoms", 0, kMostAtoms);
    check(slots, "slots", 1, kMaxSlots);
    check(swap_passes, "swap_passes", 0, 1000);
    const CodeSettings settings{int(slots), int(swap_passes)};
    const int32_t* start = warm ? supports(*warm, "warm", rows, slots, n_atoms) : nullptr;
    Buffer<int32_t> support(rows * slots);
    Buffer<float> weights(rows * slots), cosines(rows);
    const CodesOut out{support.data(), weights.data(), cosines.data()};
    without_lock([&] { run(settings, start, out); });
    const auto r = size_t(rows), k = size_t(slots);
    return nb::make_tuple(to_numpy(std::move(support), {r, k}), to_numpy(std::move(weights), {r, k}),
                          to_numpy(std::move(cosines), {r}));
}

nb::tuple py_code_similarities(const Array& similarities, const Array& gram, int64_t slots, int64_t swap_passes,
                               const std::optional<Array>& warm, int threads) {
    const Matrix s = matrix(similarities, "similarities");
    const auto* g = data_of<float>(gram, "gram", {s.columns, s.columns});
    return coded(s.rows, s.columns, slots, swap_passes, warm, [&](auto settings, auto start, auto out) {
        code_similarities(s, g, settings, start, out, sane(threads), python_signals());
    });
}

nb::tuple py_code_rows(const Array& rows, const Array& atoms, int64_t slots, int64_t swap_passes,
                       const std::optional<Array>& warm, int threads) {
    const Matrix f = matrix(rows, "rows"), c = matrix(atoms, "atoms", f.columns);
    return coded(f.rows, c.rows, slots, swap_passes, warm, [&](auto settings, auto start, auto out) {
        code_rows(f, c, settings, start, out, sane(threads), python_signals());
    });
}

nb::object py_row_products(const Array& rows, const Array& others, int threads) {
    const Matrix f = matrix(rows, "rows"), c = matrix(others, "others", f.columns);
    Buffer<float> out(f.rows * c.rows);
    without_lock([&] { row_products(f, c, out.data(), sane(threads), python_signals()); });
    return to_numpy(std::move(out), {size_t(f.rows), size_t(c.rows)});
}

nb::tuple py_code_moments(const Array& rows, const Array& support, const Array& weights, const Array& scale,
                          int64_t n_atoms, int threads) {
    const Matrix f = matrix(rows, "rows");
    const int64_t slots = length(support, 1);
    check(n_atoms, "n_atoms", 0, kMostAtoms);
    check(slots, "the number of slots", 0, kMaxSlots);
    const int32_t* atoms = supports(support, "support", f.rows, slots, n_atoms);
    const auto* w = data_of<float>(weights, "weights", {f.rows, slots});
    const auto* u = data_of<float>(scale, "scale", {f.rows});
    Buffer<double> within(n_atoms * n_atoms), toward(n_atoms * f.columns);
    without_lock([&] {
        code_moments(f, atoms, w, int(slots), u, n_atoms, within.data(), toward.data(), sane(threads), python_signals());
    });
    const auto l = size_t(n_atoms);
    return nb::make_tuple(to_numpy(std::move(within), {l, l}), to_numpy(std::move(toward), {l, size_t(f.columns)}));
}

nb::object py_solve_positive_definite(const Array& matrix, const Array& right, int threads) {
    const auto* b = data_of<double>(right, "right", {kAnySize, kAnySize});
    const int64_t size = length(right, 0), columns = length(right, 1);
    const auto* a = data_of<double>(matrix, "matrix", {size, size});
    Buffer<double> out(size * columns);
    std::copy_n(b, size * columns, out.data());
    const bool solved =
        without_lock([&] { return solve_positive_definite(a, size, out.data(), columns, sane(threads), python_signals()); });
    if (!solved) throw std::invalid_argument("matrix is not positive definite");
    return to_numpy(std::move(out), {size_t(size), size_t(columns)});
}

}  // namespace

void bind_coder(nb::module_& m) {
    const auto array = [](const char* name) { return nb::arg(name).noconvert(); };
    const char* codes =
        "Returns support int32 [R, slots] with -1 in unused slots, weights float32 [R, slots], cosines float32 [R].";
    m.def("code_similarities", &py_code_similarities, array("similarities"), array("gram"), nb::arg("slots"),
          nb::arg("swap_passes"), array("warm") = nb::none(), nb::arg("threads") = 1, codes);
    m.def("code_rows", &py_code_rows, array("rows"), array("atoms"), nb::arg("slots"), nb::arg("swap_passes"),
          array("warm") = nb::none(), nb::arg("threads") = 1, codes);
    m.def("row_products", &py_row_products, array("rows"), array("others"), nb::arg("threads") = 1,
          "rows [R, D] times others [N, D] transposed: float32 [R, N].");
    m.def("code_moments", &py_code_moments, array("rows"), array("support"), array("weights"), array("scale"),
          nb::arg("n_atoms"), nb::arg("threads") = 1,
          "Returns the sums of scale w w^T, float64 [L, L], and of scale w f^T, float64 [L, D].");
    m.def("solve_positive_definite", &py_solve_positive_definite, array("matrix"), array("right"),
          nb::arg("threads") = 1, "X with matrix [L, L] X = right [L, D], all float64.");
}

}  // namespace scoup
