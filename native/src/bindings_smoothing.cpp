// Box means, masks and their parts for Python; scoup/query/smoothing.py is the only user.
#include <nanobind/nanobind.h>

#include <stdexcept>
#include <string>

#include "arrays.h"
#include "mask_parts.h"
#include "python_signals.h"
#include "smoothing.h"

namespace nb = nanobind;

namespace scoup {
namespace {

void check_side(int64_t side, const char* name) {
    if (side < 1 || side > kMostKernel)
        throw std::invalid_argument(std::string(name) + " must be 1 to " + std::to_string(kMostKernel) + ", got " +
                                    std::to_string(side));
}

Maps maps_of(const Array& array, const char* name) {
    const auto* values = data_of<float>(array, name, {kAnySize, kAnySize, kAnySize});
    const auto count = int64_t(array.shape(0)), height = int64_t(array.shape(1)), width = int64_t(array.shape(2));
    constexpr int64_t kMost = int64_t(1) << 29;  // counts of pixels are compared in 32 bits
    if (height > kMost || width > kMost || height * width > kMost)
        throw std::invalid_argument(std::string(name) + " are too large");
    return {values, height * width > 0 ? count : 0, int32_t(height), int32_t(width)};
}

nb::object py_box_means(const Array& maps, int64_t kernel, bool reflect, int threads) {
    const Maps found = maps_of(maps, "maps");
    check_side(kernel, "kernel");
    Buffer<float> out(int64_t(maps.size()));
    without_lock([&] { box_means(found, int32_t(kernel), reflect, out.data(), sane(threads), python_signals()); });
    return to_numpy(std::move(out), {maps.shape(0), maps.shape(1), maps.shape(2)});
}

nb::tuple py_level_masks(const Array& relevancy, const Array& averaged, const Array& thresholds, int64_t smoothing,
                        int threads) {
    const Maps found = maps_of(relevancy, "relevancy");
    check_side(smoothing, "smoothing");
    const auto levels = relevancy.shape(0), height = relevancy.shape(1), width = relevancy.shape(2);
    const float* means = data_of<float>(averaged, "averaged", {int64_t(levels), int64_t(height), int64_t(width)});
    const float* bounds = data_of<float>(thresholds, "thresholds", {int64_t(levels)});
    Buffer<float> smoothed(int64_t(relevancy.size()));
    Buffer<uint8_t> masks(int64_t(relevancy.size()));
    without_lock([&] {
        level_masks(found, means, bounds, int32_t(smoothing), smoothed.data(), masks.data(), sane(threads),
                    python_signals());
    });
    return nb::make_tuple(to_numpy(std::move(smoothed), {levels, height, width}),
                          to_numpy(std::move(masks), {levels, height, width}));
}

// Bytes of the masks: 0 and 1.
nb::tuple py_level_sums(const Array& smoothed, const Array& masks, int threads) {
    const Maps found = maps_of(smoothed, "smoothed");
    const auto levels = smoothed.shape(0);
    const auto* bytes = data_of<uint8_t>(masks, "masks", {int64_t(levels), found.height, found.width});
    Buffer<LevelSums> sums{int64_t(levels)};
    sums.fill({0, 0, 0});
    without_lock([&] { level_sums(found, bytes, sums.data(), sane(threads), python_signals()); });
    Buffer<float> peaks{int64_t(levels)};
    Buffer<int64_t> areas{int64_t(levels)};
    Buffer<double> totals{int64_t(levels)};
    for (int64_t level = 0; level < int64_t(levels); ++level)
        peaks[level] = sums[level].peak, areas[level] = sums[level].area, totals[level] = sums[level].sum;
    return nb::make_tuple(to_numpy(std::move(peaks), {levels}), to_numpy(std::move(areas), {levels}),
                          to_numpy(std::move(totals), {levels}));
}

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

void bind_smoothing(nb::module_& m) {
    m.attr("MOST_KERNEL") = kMostKernel;
    m.def("box_means", &py_box_means, nb::arg("maps"), nb::arg("kernel"), nb::arg("reflect"), nb::arg("threads"));
    m.def("level_masks", &py_level_masks, nb::arg("relevancy"), nb::arg("averaged"), nb::arg("thresholds"),
          nb::arg("smoothing"), nb::arg("threads"));
    m.def("mask_parts", &py_mask_parts, nb::arg("mask"));
    m.def("level_sums", &py_level_sums, nb::arg("smoothed"), nb::arg("masks"), nb::arg("threads"));
}

}  // namespace scoup
