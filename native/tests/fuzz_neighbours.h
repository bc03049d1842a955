// Rounds over nearest neighbours, against all distances.
#pragma once

#include <algorithm>

#include "fuzzing.h"
#include "neighbours.h"

namespace scoup {

inline void fuzz_neighbours(Random& random, int threads) {
    const int64_t n = random.one_of<int64_t>({0, 1, 2, 15, 16, 17, 33, 200, 1500}), count = std::min<int64_t>(random.between(0, 9), std::max<int64_t>(n - 1, 0));
    const bool hostile = random.chance(0.3), grid = random.chance(0.3);
    Exact<double> points(random, 3 * n);
    for (int64_t i = 0; i < points.size(); ++i) {
        points[i] = grid ? double(random.below(4)) : random.uniform(-1, 1);
        if (hostile && random.chance(0.1)) points[i] = random.one_of({1e300, -1e300, 1e-320, 0.0, -0.0});
    }
    Exact<int64_t> numbers(random, n * count), alone(random, n * count), parts(random, n);
    Exact<double> lengths(random, n * count), same(random, n * count);
    nearest_points(points.data(), n, count, numbers.data(), lengths.data(), threads, never);
    nearest_points(points.data(), n, count, alone.data(), same.data(), 1, never);
    check_same(numbers, alone, "nearest: threads");
    check_same(lengths, same, "nearest: threads");
    std::vector<double> all;
    for (int64_t i = 0; i < n && !hostile; ++i) {
        all.clear();
        for (int64_t j = 0; j < n; ++j) {
            double square = 0;
            for (int axis = 0; axis < 3; ++axis) square += std::pow(points[3 * i + axis] - points[3 * j + axis], 2);
            if (j != i) all.push_back(std::sqrt(square));
        }
        std::sort(all.begin(), all.end());
        for (int64_t j = 0; j < count; ++j) {
            check_near(lengths[i * count + j], all[size_t(j)], 1e-12, "nearest");
            check(numbers[i * count + j] != i, "nearest: itself");
        }
    }
    const double longest = random.uniform(0, 1);
    linked_parts(numbers.data(), lengths.data(), n, count, longest, parts.data());
    int64_t found = 0;
    for (int64_t i = 0; i < n; ++i) {
        check(parts[i] >= 0 && parts[i] <= found, "parts: not in order");
        found = std::max(found, parts[i] + 1);
        for (int64_t j = 0; j < count; ++j)
            check(!(lengths[i * count + j] <= longest) || parts[i] == parts[numbers[i * count + j]], "parts: a link between two");
    }
    if (numbers.size() == 0) return;
    numbers[random.below(numbers.size())] = random.one_of<int64_t>({-1, n, INT64_MAX, INT64_MIN});
    try {
        linked_parts(numbers.data(), lengths.data(), n, count, 1e308, parts.data());
        check(hostile, "parts: a link to no point");
    } catch (const std::invalid_argument&) {
    }
}

}  // namespace scoup
