#include "mask_parts.h"

#include <algorithm>
#include <vector>

#include "unions.h"

namespace scoup {

int32_t mask_parts(const uint8_t* mask, int64_t height, int64_t width, int32_t* parts) {
    Unions<int32_t> unions(1);  // outside of the mask, which is joined with nothing
    for (int64_t y = 0; y < height; ++y) {
        const uint8_t* inside = mask + y * width;
        int32_t* here = parts + y * width;
        const int32_t* above = y > 0 ? here - width : nullptr;
        for (int64_t x = 0; x < width; ++x) {
            if (inside[x] == 0) {
                here[x] = 0;
                continue;
            }
            int32_t part = x > 0 ? here[x - 1] : 0;
            for (int64_t other = std::max<int64_t>(x - 1, 0); above != nullptr && other < std::min(x + 2, width); ++other)
                if (above[other] != 0 && above[other] != part)
                    part = part == 0 ? above[other] : unions.join(part, above[other]);
            here[x] = part == 0 ? unions.add() : part;
        }
    }
    std::vector<int32_t> numbers(unions.size());
    const int32_t count = unions.number(numbers.data());
    for (int64_t i = 0; i < height * width; ++i) parts[i] = numbers[size_t(parts[i])];
    return count - 1;
}

}  // namespace scoup
