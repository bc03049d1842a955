// Values above thresholds for Python; scoup/query/selection.py is their only user.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>

#include "arrays.h"
#include "python_signals.h"
#include "selection.h"

namespace nb = nanobind;

namespace scoup {
namespace {

ValueRows rows_of(const Array& values, const std::optional<Array>& included) {
    const auto* data = data_of<float>(values, "values", {kAnySize, kAnySize});
    const auto count = int64_t(values.shape(0)), length = int64_t(values.shape(1));
    return {data, included ? data_of<uint8_t>(*included, "included", {count, length}) : nullptr, count, length};
}

nb::tuple py_count_stretched(const Array& values, const std::optional<Array>& included, float share, int threads) {
    const ValueRows rows = rows_of(values, included);
    Buffer<float> spans(2 * rows.count);
    Buffer<int64_t> bins(rows.count * kBins);
    without_lock([&] { count_stretched(rows, share, spans.data(), bins.data(), sane(threads), python_signals()); });
    return nb::make_tuple(to_numpy(std::move(spans), {size_t(rows.count), 2}),
                          to_numpy(std::move(bins), {size_t(rows.count), size_t(kBins)}));
}

// Bytes of the masks: 0 and 1.
nb::tuple py_above_thresholds(const Array& values, const std::optional<Array>& included, const Array& spans,
                              const Array& thresholds, int threads) {
    const ValueRows rows = rows_of(values, included);
    const float* ends = data_of<float>(spans, "spans", {rows.count, 2});
    const float* bounds = data_of<float>(thresholds, "thresholds", {rows.count});
    Buffer<uint8_t> masks(rows.count * rows.length);
    Buffer<SumAbove> found(rows.count);
    without_lock([&] {
        above_thresholds(rows, ends, bounds, masks.data(), found.data(), sane(threads), python_signals());
    });
    Buffer<int64_t> counts(rows.count);
    Buffer<double> sums(rows.count);
    for (int64_t row = 0; row < rows.count; ++row) counts[row] = found[row].count, sums[row] = found[row].sum;
    return nb::make_tuple(to_numpy(std::move(masks), {size_t(rows.count), size_t(rows.length)}),
                          to_numpy(std::move(counts), {size_t(rows.count)}),
                          to_numpy(std::move(sums), {size_t(rows.count)}));
}

}  // namespace

void bind_selection(nb::module_& m) {
    m.def("count_stretched", &py_count_stretched, nb::arg("values"), nb::arg("included").none(), nb::arg("share"),
          nb::arg("threads"));
    m.def("above_thresholds", &py_above_thresholds, nb::arg("values"), nb::arg("included").none(), nb::arg("spans"),
          nb::arg("thresholds"), nb::arg("threads"));
}

}  // namespace scoup
