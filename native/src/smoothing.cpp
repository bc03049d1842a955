#include "smoothing.h"

#include <algorithm>
#include <vector>

#include "buffer.h"

namespace scoup {
namespace {

// One axis of a box, with the memory that it points to.
class Axis {
  public:
    Axis(int32_t size, int32_t kernel, bool reflect)
        : axis_{size, kernel, 0, 0, nullptr, nullptr}, source_(int64_t(size) + kernel), count_(size) {
        const int32_t before = kernel / 2, after = kernel - 1 - before;
        axis_.zeros = reflect ? 1 : before + 1;
        axis_.n_values = reflect ? size + kernel - 1 : size;
        for (int32_t value = 0; value < axis_.n_values; ++value)
            source_[value] = reflect ? reflected(value - before, size) : value;
        for (int32_t x = 0; x < size; ++x)
            count_[x] = reflect ? kernel : std::min(x + after, size - 1) - std::max(x - before, 0) + 1;
        axis_.source = source_.data(), axis_.count = count_.data();
    }

    const BoxAxis& axis() const { return axis_; }

  private:
    // Mirrored about the edge pixels as often as needed.
    static int32_t reflected(int32_t position, int32_t size) {
        if (size == 1) return 0;
        const int32_t period = 2 * (size - 1), place = (position % period + period) % period;
        return std::min(place, period - place);
    }

    BoxAxis axis_;
    Buffer<int32_t> source_;
    Buffer<double> count_;
};

class BoxMemory {
  public:
    BoxMemory(int32_t width, int32_t kernel)
        : nothing_(width), sums_(int64_t(kRowsAtOnce) * (width + kernel)), down_((int64_t(kernel) + 1) * width) {
        nothing_.fill(0.0f);
    }
    BoxScratch scratch() { return {nothing_.data(), sums_.data(), down_.data()}; }

  private:
    Buffer<float> nothing_;
    Buffer<double> sums_, down_;
};

class MaskMemory {
  public:
    MaskMemory(int32_t width, int32_t height) : above_(int64_t(width) * height), counts_(width), sums_(int64_t(width) + 1) {}
    MaskScratch scratch() { return {above_.data(), counts_.data(), sums_.data()}; }

  private:
    Buffer<uint8_t> above_;
    Buffer<int32_t> counts_, sums_;
};

}  // namespace

void box_means(const Maps& maps, int32_t kernel, bool reflect, float* out, int n_threads, const Interrupted& interrupted) {
    if (maps.count == 0) return;
    const auto& kernels = pick(baseline::smoothing_kernels, v3::smoothing_kernels, v4::smoothing_kernels);
    const Axis across(maps.width, kernel, reflect), along(maps.height, kernel, reflect);
    n_threads = workers(maps.count, n_threads);
    std::vector<BoxMemory> memory;
    for (int worker = 0; worker < n_threads; ++worker) memory.emplace_back(maps.width, kernel);
    for_chunks(maps.count, n_threads, interrupted, [&](int64_t map, int worker) {
        kernels.box_mean(maps.values + map * maps.pixels(), across.axis(), along.axis(), memory[size_t(worker)].scratch(),
                         out + map * maps.pixels());
    });
}

void level_masks(const Maps& relevancy, const float* averaged, const float* thresholds, int32_t smoothing,
                 float* smoothed, uint8_t* masks, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::smoothing_kernels, v3::smoothing_kernels, v4::smoothing_kernels);
    n_threads = workers(relevancy.count, n_threads);
    std::vector<MaskMemory> memory;
    for (int worker = 0; worker < n_threads; ++worker) memory.emplace_back(relevancy.width, relevancy.height);
    for_chunks(relevancy.count, n_threads, interrupted, [&](int64_t level, int worker) {
        const int64_t first = level * relevancy.pixels();
        kernels.mask(relevancy.values + first, averaged + first, relevancy.width, relevancy.height,
                     {thresholds[level], smoothing}, memory[size_t(worker)].scratch(), smoothed + first, masks + first);
    });
}

void level_sums(const Maps& smoothed, const uint8_t* masks, LevelSums* out, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::smoothing_kernels, v3::smoothing_kernels, v4::smoothing_kernels);
    for_chunks(smoothed.count, n_threads, interrupted, [&](int64_t level, int) {
        const int64_t first = level * smoothed.pixels();
        out[level] = kernels.sums(smoothed.values + first, masks + first, smoothed.pixels());
    });
}

}  // namespace scoup
