// A second round of the vote: how far a region's code agrees with what a Gaussian was voted to be before.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "buffer.h"

namespace scoup {

// The codes of the round before. Arrays belong to the caller.
struct EarlierVotes {
    const uint8_t* indices8 = nullptr;    // [N, levels, k], or null if they are
    const uint16_t* indices16 = nullptr;  // these
    const float* weights = nullptr;       // [N, levels, k], scaled so that a decoded code has norm 1; zero: no code
    const float* sharpness = nullptr;     // [levels]
    int32_t k = 0;

    bool given() const { return weights != nullptr; }
};

// Of one level's regions: the cosine of each with every atom, [regions, atoms].
struct RegionCosines {
    const float* cosines;
    int64_t rows;
};

// No Gaussian loses its code for being odd.
constexpr float kLeastAgreement = 1e-6f;

// What a region's vote counts: exp(sharpness (cosine - 1)); 1 where there was no vote before.
inline float agreement(const EarlierVotes& earlier, int64_t gaussian, int32_t levels, int32_t level, const float* cosines) {
    const int64_t first = (gaussian * levels + level) * earlier.k;
    float cosine = 0, total = 0;
    for (int64_t i = first; i < first + earlier.k; ++i) {
        const int atom = earlier.indices8 != nullptr ? earlier.indices8[i] : earlier.indices16[i];
        cosine += earlier.weights[i] * cosines[atom];
        total += earlier.weights[i];
    }
    if (!(total > 0)) return 1;
    return std::max(std::exp(earlier.sharpness[level] * std::min(cosine - 1.0f, 0.0f)), kLeastAgreement);
}

}  // namespace scoup
