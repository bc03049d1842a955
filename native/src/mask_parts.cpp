#include "mask_parts.h"

#include <algorithm>
#include <vector>

namespace scoup {
namespace {

// Parts that are found to be one while the mask is read. The lowest number of those stands for all.
class Unions {
  public:
    int32_t add() {
        parents_.push_back(int32_t(parents_.size()));
        return parents_.back();
    }
    int32_t first_of(int32_t part) {
        while (parents_[size_t(part)] != part) part = parents_[size_t(part)] = parents_[size_t(parents_[size_t(part)])];
        return part;
    }
    int32_t join(int32_t one, int32_t other) {
        one = first_of(one), other = first_of(other);
        const int32_t first = std::min(one, other);
        parents_[size_t(std::max(one, other))] = first;
        return first;
    }
    // Numbers the parts 1 .. n in the order of their lowest numbers; number 0 stays.
    std::vector<int32_t> numbers() {
        std::vector<int32_t> found(parents_.size(), 0);
        int32_t count = 0;
        for (size_t part = 1; part < found.size(); ++part) {
            const int32_t first = first_of(int32_t(part));
            found[part] = first == int32_t(part) ? ++count : found[size_t(first)];
        }
        return found;
    }

  private:
    std::vector<int32_t> parents_{0};
};

}  // namespace

int32_t mask_parts(const uint8_t* mask, int64_t height, int64_t width, int32_t* parts) {
    Unions unions;
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
    const std::vector<int32_t> numbers = unions.numbers();
    for (int64_t i = 0; i < height * width; ++i) parts[i] = numbers[size_t(parts[i])];
    return *std::max_element(numbers.begin(), numbers.end());
}

}  // namespace scoup
