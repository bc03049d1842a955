// Rounds over values above thresholds, against the rule value by value.
#pragma once

#include <algorithm>

#include "fuzzing.h"
#include "selection.h"

namespace scoup {

inline void fuzz_selection(Random& random, int threads) {
    const int64_t count = random.between(0, 3), length = random.one_of<int64_t>({0, 1, 15, 16, 17, 200, 16384, 16390});
    const bool hostile = random.chance(0.3);
    Exact<float> values(random, count * length), thresholds(random, count);
    Exact<uint8_t> included(random, count * length), masks(random, count * length), alone(random, count * length);
    for (int64_t i = 0; i < values.size(); ++i) {
        values[i] = hostile && random.chance(0.05) ? hostile_float(random) : float(random.uniform(-0.2, 0.8));
        included[i] = random.chance(0.8);
    }
    for (int64_t row = 0; row < count; ++row) thresholds[row] = float(random.uniform());
    const bool all = random.chance(0.3);
    const ValueRows rows{values.data(), all ? nullptr : included.data(), count, length};
    Exact<float> spans(random, 2 * count), same(random, 2 * count);
    Exact<int64_t> bins(random, count * kBins), again(random, count * kBins);
    count_stretched(rows, 0.0f, spans.data(), bins.data(), threads, never);
    count_stretched(rows, 0.0f, same.data(), again.data(), 1, never);
    check_same(spans, same, "spans: threads");
    check_same(bins, again, "bins: threads");
    std::vector<SumAbove> found(static_cast<size_t>(count));
    above_thresholds(rows, spans.data(), thresholds.data(), masks.data(), found.data(), threads, never);
    above_thresholds(rows, spans.data(), thresholds.data(), alone.data(), found.data(), 1, never);
    check_same(masks, alone, "masks above: threads");

    for (int64_t row = 0; row < count; ++row) {
        const double low = spans[2 * row], high = spans[2 * row + 1];
        const bool meant = std::isfinite(low) && std::isfinite(high);
        const bool counted = meant && std::isfinite(spans[2 * row + 1] - spans[2 * row]);
        int64_t expected[kBins] = {}, above = 0;
        double sum = 0;
        for (int64_t i = row * length; i < (row + 1) * length; ++i) {
            const bool own = meant && (all || included[i]);
            const double twice = 2 * ((double(values[i]) - low) / (high - low + 1e-9)) - 1;
            const float stretched = own ? float(std::min(std::max(twice, 0.0), 1.0)) : 0;
            if (own && counted) ++expected[std::min(int(stretched * 100.0f), kBins - 1)];
            check(masks[i] == (own && stretched > thresholds[row]), "mask above");
            above += masks[i];
            sum += masks[i] ? double(values[i]) : 0;
        }
        check(std::equal(expected, expected + kBins, bins.data() + row * kBins), "bins");
        check(found[size_t(row)].count == above, "count above");
        check_near(found[size_t(row)].sum, sum, 1e-9 * double(length) * std::max(1.0, std::abs(sum)), "sum above");
    }
}

}  // namespace scoup
