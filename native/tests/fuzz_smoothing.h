// Rounds over box means and masks, against sums pixel by pixel.
#pragma once

#include "fuzzing.h"
#include "mask_parts.h"
#include "smoothing.h"

namespace scoup {

inline int64_t mirrored(int64_t position, int64_t size) {
    while (size > 1 && (position < 0 || position >= size)) position = position < 0 ? -position : 2 * (size - 1) - position;
    return size > 1 ? position : 0;
}

// Mean of a box of a map, or how many of its pixels are above a half: the sum and what it is divided by.
struct BoxSum {
    double sum = 0, count = 0;
};
template <class T>
BoxSum box_sum(const T* map, int64_t width, int64_t height, int64_t x, int64_t y, int64_t side, bool reflect) {
    BoxSum box;
    for (int64_t row = y - side / 2; row < y - side / 2 + side; ++row)
        for (int64_t column = x - side / 2; column < x - side / 2 + side; ++column) {
            const bool inside = row >= 0 && row < height && column >= 0 && column < width;
            if (!inside && !reflect) continue;
            box.sum += double(map[mirrored(row, height) * width + mirrored(column, width)]);
            ++box.count;
        }
    return box;
}

// Pixels are of one part exactly if they touch, and parts are numbered by their first pixels.
inline void fuzz_mask_parts(Random& random) {
    const int64_t height = random.between(0, 20), width = random.between(0, 30);
    const double share = random.uniform();
    Exact<uint8_t> mask(random, height * width);
    for (int64_t i = 0; i < mask.size(); ++i) mask[i] = uint8_t(random.chance(share) ? random.between(1, 255) : 0);
    Exact<int32_t> parts(random, height * width);
    const int32_t count = mask_parts(mask.data(), height, width, parts.data());
    // Floods from the first pixel of each part.
    std::vector<int32_t> expected(size_t(height * width), 0);
    int32_t found = 0;
    for (int64_t start = 0; start < mask.size(); ++start) {
        if (mask[start] == 0 || expected[size_t(start)] != 0) continue;
        std::vector<int64_t> waiting{start};
        expected[size_t(start)] = ++found;
        while (!waiting.empty()) {
            const int64_t at = waiting.back(), x = at % width, y = at / width;
            waiting.pop_back();
            for (int64_t row = std::max<int64_t>(y - 1, 0); row <= std::min(y + 1, height - 1); ++row)
                for (int64_t column = std::max<int64_t>(x - 1, 0); column <= std::min(x + 1, width - 1); ++column)
                    if (mask[row * width + column] != 0 && expected[size_t(row * width + column)] == 0) {
                        expected[size_t(row * width + column)] = found;
                        waiting.push_back(row * width + column);
                    }
        }
    }
    check(count == found, "parts of a mask: another number");
    for (int64_t i = 0; i < parts.size(); ++i) check(parts[i] == expected[size_t(i)], "parts of a mask");
}

inline void fuzz_smoothing(Random& random, int threads) {
    const auto height = int32_t(random.between(1, 23)), width = int32_t(random.between(1, 41));
    const int64_t count = random.between(0, 3), pixels = int64_t(width) * height;
    const auto kernel = int32_t(random.between(1, 30)), smoothing = int32_t(random.between(1, 9));
    const bool reflect = random.chance(0.5), hostile = random.chance(0.3);
    Exact<float> values(random, count * pixels), means(random, count * pixels), again(random, count * pixels);
    for (int64_t i = 0; i < values.size(); ++i)
        values[i] = hostile && random.chance(0.05) ? hostile_float(random) : float(random.uniform());
    const Maps maps{values.data(), count, height, width};
    box_means(maps, kernel, reflect, means.data(), threads, never);
    box_means(maps, kernel, reflect, again.data(), 1, never);
    check_same(means, again, "box means: threads");

    Exact<float> smoothed(random, count * pixels);
    Exact<uint8_t> masks(random, count * pixels), alone(random, count * pixels);
    Exact<float> thresholds(random, count);
    for (int64_t map = 0; map < count; ++map) thresholds[map] = float(random.uniform());
    level_masks(maps, means.data(), thresholds.data(), smoothing, smoothed.data(), masks.data(), threads, never);
    level_masks(maps, means.data(), thresholds.data(), smoothing, again.data(), alone.data(), 1, never);
    check_same(smoothed, again, "smoothed relevancy: threads");
    check_same(masks, alone, "masks: threads");
    std::vector<LevelSums> sums(static_cast<size_t>(count));
    level_sums({smoothed.data(), count, height, width}, masks.data(), sums.data(), threads, never);
    if (hostile) return;

    for (int64_t map = 0; map < count; ++map) {
        const float* own = smoothed.data() + map * pixels;
        float low = own[0], high = own[0];
        for (int64_t i = 0; i < pixels; ++i) low = std::min(low, own[i]), high = std::max(high, own[i]);
        std::vector<uint8_t> above(static_cast<size_t>(pixels));
        for (int64_t i = 0; i < pixels; ++i) {
            const double stretched = 2 * ((double(own[i]) - double(low)) / (double(high) - double(low) + 1e-9)) - 1;
            above[size_t(i)] = float(std::min(std::max(stretched, 0.0), 1.0)) > thresholds[map];
        }
        double sum = 0;
        int64_t area = 0;
        for (int64_t i = 0; i < pixels; ++i) {
            const int64_t at = map * pixels + i, x = i % width, y = i / width;
            const BoxSum box = box_sum(values.data() + map * pixels, width, height, x, y, kernel, reflect);
            check_near(means[at], box.sum / box.count, 1e-6, "box mean");
            check(smoothed[at] == 0.5f * (values[at] + means[at]), "smoothed relevancy");
            const BoxSum members = box_sum(above.data(), width, height, x, y, smoothing, false);
            check(masks[at] == (2 * members.sum > members.count), "mask");
            area += masks[at];
            sum += masks[at] ? double(smoothed[at]) : 0;
        }
        check(sums[size_t(map)].area == area && sums[size_t(map)].peak == high, "sums of a level");
        check_near(sums[size_t(map)].sum, sum, 1e-9 * double(pixels), "sum over a mask");
    }
}

}  // namespace scoup
