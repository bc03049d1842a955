// Nearest neighbours for Python; scoup/query/neighbours.py is their only user.
#include <nanobind/nanobind.h>

#include <cmath>
#include <stdexcept>

#include "arrays.h"
#include "neighbours.h"
#include "python_signals.h"

namespace nb = nanobind;

namespace scoup {
namespace {

nb::tuple py_nearest_points(const Array& points, int64_t count, int threads) {
    const auto* places = data_of<double>(points, "points", {kAnySize, 3});
    const auto n = int64_t(points.shape(0));
    if (count < 0 || (n > 0 && count >= n)) throw std::invalid_argument("there must be more points than neighbours");
    for (int64_t i = 0; i < 3 * n; ++i)
        if (!std::isfinite(places[i])) throw std::invalid_argument("points must be finite");
    Buffer<int64_t> numbers(n * count);
    Buffer<double> lengths(n * count);
    without_lock([&] { nearest_points(places, n, count, numbers.data(), lengths.data(), sane(threads), python_signals()); });
    return nb::make_tuple(to_numpy(std::move(numbers), {size_t(n), size_t(count)}),
                          to_numpy(std::move(lengths), {size_t(n), size_t(count)}));
}

nb::object py_linked_parts(const Array& numbers, const Array& lengths, double longest) {
    const auto* nearest = data_of<int64_t>(numbers, "numbers", {kAnySize, kAnySize});
    const auto n = int64_t(numbers.shape(0)), count = int64_t(numbers.shape(1));
    const auto* far = data_of<double>(lengths, "lengths", {n, count});
    Buffer<int64_t> parts(n);
    without_lock([&] { linked_parts(nearest, far, n, count, longest, parts.data()); });
    return to_numpy(std::move(parts), {size_t(n)});
}

}  // namespace

void bind_neighbours(nb::module_& m) {
    m.def("nearest_points", &py_nearest_points, nb::arg("points"), nb::arg("count"), nb::arg("threads"));
    m.def("linked_parts", &py_linked_parts, nb::arg("numbers"), nb::arg("lengths"), nb::arg("longest"));
}

}  // namespace scoup
