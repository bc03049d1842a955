// Rounds over the parts of masks, against floods.
#pragma once

#include "fuzzing.h"
#include "mask_parts.h"

namespace scoup {

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

}  // namespace scoup
