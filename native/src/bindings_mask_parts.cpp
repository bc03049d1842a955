// Connected parts of masks for Python.
#include <nanobind/nanobind.h>

#include <stdexcept>

#include "arrays.h"
#include "mask_parts.h"
#include "python_signals.h"

namespace nb = nanobind;

namespace scoup {
namespace {

nb::tuple py_mask_parts(const Array& mask) {
    const auto* inside = data_of<uint8_t>(mask, "mask", {kAnySize, kAnySize});
    const auto height = int64_t(mask.shape(0)), width = int64_t(mask.shape(1));
    if (height > kMostMaskPixels || width > kMostMaskPixels || height * width > kMostMaskPixels)
        throw std::invalid_argument("the mask is too large");
    Buffer<int32_t> parts(height * width);
    const int32_t count = without_lock([&] { return mask_parts(inside, height, width, parts.data()); });
    return nb::make_tuple(to_numpy(std::move(parts), {size_t(height), size_t(width)}), count);
}

}  // namespace

void bind_mask_parts(nb::module_& m) { m.def("mask_parts", &py_mask_parts, nb::arg("mask")); }

}  // namespace scoup
