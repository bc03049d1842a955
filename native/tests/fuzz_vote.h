// Rounds over the vote: against sums in double precision, with threads, interruptions, and sums that are damaged.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>

#include "fuzz_raster.h"
#include "vote.h"

namespace scoup {

// Region sums of one view that no rasteriser has made.
struct SumsArrays {
    Exact<uint32_t> buckets, starts;
    Exact<uint8_t> places;
    Exact<uint16_t> combinations, halves;
    Exact<float> weights;
    Exact<int64_t> regions;
    int64_t n_combinations;

    // Where the entries of a bucket begin (0) or end (1); the same where it has none.
    int64_t first_of(int64_t bucket, int64_t end) const {
        for (int64_t b = 0; b < buckets.size(); ++b)
            if (buckets[b] == bucket) return starts[b + end];
        return 0;
    }

    ViewSums sums(bool half) const {
        return {buckets.data(), starts.data(), places.data(), combinations.data(), half ? nullptr : weights.data(),
                half ? halves.data() : nullptr, buckets.size(), places.size(), regions.data(), n_combinations};
    }
};

inline SumsArrays random_sums(Random& random, int64_t n, int32_t levels, const std::vector<int64_t>& rows) {
    const int64_t n_combinations = random.between(0, 12);
    const int64_t buckets = (n + kVoteBucket - 1) / kVoteBucket;
    std::vector<uint8_t> places;
    std::vector<uint32_t> named, starts;
    for (int64_t bucket = 0; bucket < buckets; ++bucket) {
        if (random.chance(0.2)) continue;
        named.push_back(uint32_t(bucket));
        starts.push_back(uint32_t(places.size()));
        for (int64_t place = 0; place < std::min(kVoteBucket, n - bucket * kVoteBucket); ++place)
            for (int64_t entry = n_combinations > 0 ? random.between(-2, 3) : 0; entry > 0; --entry) places.push_back(uint8_t(place));
    }
    starts.push_back(uint32_t(places.size()));
    SumsArrays all{{random, int64_t(named.size())}, {random, int64_t(starts.size())}, {}, {}, {}, {},
                   {random, n_combinations * levels}, n_combinations};
    std::copy(named.begin(), named.end(), all.buckets.data());
    std::copy(starts.begin(), starts.end(), all.starts.data());
    const auto count = int64_t(places.size());
    all.places = {random, count}, all.combinations = {random, count}, all.halves = {random, count}, all.weights = {random, count};
    for (int64_t i = 0; i < count; ++i) {
        all.places[i] = places[size_t(i)];
        all.combinations[i] = uint16_t(random.below(n_combinations));
        all.halves[i] = uint16_t(0x3000 + random.below(0x1000));  // 0.125 to 1.999
        const auto exponent = int32_t(all.halves[i] >> 10) - 15;
        all.weights[i] = std::ldexp(1.0f + float(all.halves[i] & 0x3ff) / 1024, exponent);
    }
    for (int64_t i = 0; i < all.regions.size(); ++i) {
        const int64_t known = rows[size_t(i % levels)];
        all.regions[i] = known == 0 || random.chance(0.2) ? -1 : random.below(known);
    }
    return all;
}

// Everything that a vote reads and writes.
class VoteCase {
  public:
    explicit VoteCase(Random& random)
        : n_(random.one_of<int64_t>({0, 1, 255, 256, 257, 700})), levels_(int32_t(random.between(1, 3))),
          n_atoms_(random.one_of({1, 5, 64, 130, 256, 300, 600})), keep_(int32_t(random.one_of({1, 2, 4, 9, 40}))) {
        for (int32_t level = 0; level < levels_; ++level) rows_.push_back(random.between(0, 20));
        for (int32_t level = 0; level < levels_; ++level) {
            const auto k = int32_t(random.between(0, 4));
            codes_.push_back(random_codes(random, rows_[size_t(level)] * k, n_atoms_));
            const CodeArrays& last = codes_.back();
            tables_.push_back({last.bytes ? last.indices8.data() : nullptr, last.bytes ? nullptr : last.indices16.data(),
                               last.weights.data(), rows_[size_t(level)], k});
        }
        for (int64_t view = random.between(0, 4); view > 0; --view) views_.push_back(random_sums(random, n_, levels_, rows_));
        grams_ = Exact<float>(random, int64_t(levels_) * n_atoms_ * n_atoms_);
        std::vector<float> atoms(size_t(levels_) * size_t(n_atoms_) * 4);
        for (float& value : atoms) value = float(random.uniform(-0.3, 1));
        for (int64_t row = 0; row < int64_t(levels_) * n_atoms_; ++row)
            for (int64_t other = 0; other < n_atoms_; ++other)
                for (int64_t d = 0; d < 4; ++d)
                    grams_[row * n_atoms_ + other] +=
                        atoms[size_t(row * 4 + d)] * atoms[size_t((row / n_atoms_ * n_atoms_ + other) * 4 + d)];
        sharpness_ = Exact<float>(random, levels_);
        for (int32_t level = 0; level < levels_; ++level) sharpness_[level] = float(random.between(0, 20));
        half_ = random.chance(0.3);
    }

    Vote vote() const {
        std::vector<ViewSums> views;
        for (const SumsArrays& view : views_) views.push_back(view.sums(half_));
        return {n_, n_atoms_, std::move(views), tables_, grams_.data()};
    }

    struct Found {
        Exact<uint8_t> indices8;
        Exact<uint16_t> indices16;
        Exact<float> weights;
        int64_t atom(int64_t i, bool bytes) const { return bytes ? indices8[i] : indices16[i]; }
    };
    Found room(Random& random) const {
        const int64_t size = n_ * levels_ * keep_;
        return {{random, size}, {random, size}, {random, size}};
    }
    VotedCodes out(Found& found) const {
        return {bytes() ? found.indices8.data() : nullptr, bytes() ? nullptr : found.indices16.data(), found.weights.data(), keep_};
    }
    EarlierCodes earlier(const Found& found) const {
        return {bytes() ? found.indices8.data() : nullptr, bytes() ? nullptr : found.indices16.data(), found.weights.data(),
                keep_, sharpness_.data()};
    }
    bool bytes() const { return n_atoms_ <= 256; }

    // [levels, atoms] of a Gaussian in double precision; with an earlier round, each region counts by its agreement.
    std::vector<double> expected(int64_t gaussian, const Found* before) const {
        std::vector<double> sums(size_t(levels_ * n_atoms_), 0.0);
        for (const SumsArrays& view : views_)
            for (int64_t i = view.first_of(gaussian / kVoteBucket, 0); i < view.first_of(gaussian / kVoteBucket, 1); ++i) {
                if (view.places[i] != gaussian % kVoteBucket) continue;
                for (int32_t level = 0; level < levels_; ++level) {
                    const int64_t region = view.regions[view.combinations[i] * levels_ + level];
                    if (region < 0) continue;
                    const double weight = double(view.weights[i]) * (before ? agreement(gaussian, level, region, *before) : 1);
                    for (int32_t j = 0; j < tables_[size_t(level)].k; ++j) {
                        const int64_t at = region * tables_[size_t(level)].k + j;
                        sums[size_t(level * n_atoms_ + codes_[size_t(level)].index(at))] += weight * codes_[size_t(level)].weights[at];
                    }
                }
            }
        return sums;
    }

    int64_t n_;
    int32_t levels_, n_atoms_, keep_;
    std::vector<int64_t> rows_;
    std::vector<CodeArrays> codes_;
    std::vector<RegionCodes> tables_;
    std::vector<SumsArrays> views_;
    Exact<float> grams_, sharpness_;
    bool half_ = false;

  private:
    double agreement(int64_t gaussian, int32_t level, int64_t region, const Found& before) const {
        const auto gram = [&](int64_t a, int64_t b) { return double(grams_[(level * int64_t(n_atoms_) + a) * n_atoms_ + b]); };
        const CodeArrays& codes = codes_[size_t(level)];
        const int32_t k = tables_[size_t(level)].k;
        double product = 0, squared = 0, total = 0;
        for (int32_t j = 0; j < k; ++j) {
            const int64_t at = region * k + j;
            for (int32_t i = 0; i < k; ++i)
                squared += double(codes.weights[at]) * codes.weights[region * k + i] * gram(codes.index(at), codes.index(region * k + i));
            for (int32_t i = 0; i < keep_; ++i) {
                const int64_t own = (gaussian * levels_ + level) * keep_ + i;
                product += double(codes.weights[at]) * before.weights[own] * gram(codes.index(at), before.atom(own, bytes()));
            }
        }
        for (int32_t i = 0; i < keep_; ++i) total += before.weights[(gaussian * levels_ + level) * keep_ + i];
        if (!(total > 0)) return 1;
        const double cosine = squared > 0 ? product / std::sqrt(squared) : 0;
        return std::max(std::exp(double(sharpness_[level]) * std::min(cosine - 1, 0.0)), 1e-6);
    }
};

inline void check_round(const VoteCase& vote, const VoteCase::Found& found, const VoteCase::Found* before) {
    for (int64_t g = 0; g < vote.n_; ++g) {
        const std::vector<double> sums = vote.expected(g, before);
        for (int32_t level = 0; level < vote.levels_; ++level) {
            const double* row = sums.data() + level * vote.n_atoms_;
            const double most = *std::max_element(row, row + vote.n_atoms_);
            std::vector<double> sorted(row, row + vote.n_atoms_);
            std::sort(sorted.rbegin(), sorted.rend());
            sorted.resize(std::min(sorted.size(), size_t(vote.keep_)));
            const double total = std::accumulate(sorted.begin(), sorted.end(), 0.0);
            for (int32_t j = 0; j < vote.keep_; ++j) {
                const int64_t at = (g * vote.levels_ + level) * vote.keep_ + j;
                const int64_t atom = found.atom(at, vote.bytes());
                check(atom < vote.n_atoms_, "vote: no such atom");
                const double weight = double(found.weights[at]);
                // Equal ones may come in either order; what is kept of them is the same.
                const double expected = size_t(j) < sorted.size() && total > 0 ? sorted[size_t(j)] / total : 0;
                check_near(weight, expected, 1e-3, "vote: weight");
                if (weight > 1e-3) check_near(row[atom], sorted[size_t(j)], 1e-3 * most, "vote: another atom");
            }
        }
    }
}

inline void fuzz_vote(Random& random, int threads) {
    const VoteCase all(random);
    const Vote vote = all.vote();
    check(vote.n_buckets() == (all.n_ + kVoteBucket - 1) / kVoteBucket, "vote: buckets");

    VoteCase::Found first = all.room(random), alone = all.room(random), unit = all.room(random), second = all.room(random);
    vote.round(all.out(alone), nullptr, false, 0, vote.n_buckets(), 1, never);
    const double seconds = seconds_of([&] { vote.round(all.out(first), nullptr, false, 0, vote.n_buckets(), threads, never); });
    check_same(first.weights, alone.weights, "vote: threads");
    check_same(first.indices8, alone.indices8, "vote: threads");
    check_same(first.indices16, alone.indices16, "vote: threads");
    check_round(all, first, nullptr);
    if (random.chance(0.05))
        interrupt(random, seconds, [&](const Interrupted& stop) {
            VoteCase::Found dropped = all.room(random);
            vote.round(all.out(dropped), nullptr, false, 0, vote.n_buckets(), threads, stop);
        });

    vote.round(all.out(unit), nullptr, true, 0, vote.n_buckets(), threads, never);
    const EarlierCodes earlier = all.earlier(unit);
    // In two parts: buckets do not depend on each other.
    const int64_t middle = random.between(0, vote.n_buckets());
    vote.round(all.out(second), &earlier, false, 0, middle, threads, never);
    VotedCodes rest = all.out(second);
    const int64_t skipped = std::min(middle * kVoteBucket, all.n_) * all.levels_ * all.keep_;
    if (rest.indices8 != nullptr) rest.indices8 += skipped;
    if (rest.indices16 != nullptr) rest.indices16 += skipped;
    rest.weights += skipped;
    vote.round(rest, &earlier, false, middle, vote.n_buckets(), threads, never);
    check_round(all, second, &unit);
    const auto deviations = vote.deviations(earlier, 0, vote.n_buckets(), threads, never);
    check(deviations == vote.deviations(earlier, 0, vote.n_buckets(), 1, never), "deviations: threads");
    check(int32_t(deviations.size()) == all.levels_, "deviations: levels");
}

// Sums of which nothing can be trusted are refused, or give any numbers, but are never read beyond their ends.
inline void fuzz_damaged_sums(Random& random, int threads) {
    VoteCase all(random);
    for (SumsArrays& view : all.views_) {
        const auto damage = [&](auto& values) {
            for (int64_t i = 0; i < values.size(); ++i)
                if (random.chance(0.01)) values[i] = std::decay_t<decltype(values[0])>(random.bits());
        };
        if (random.chance(0.3)) damage(view.buckets);
        if (random.chance(0.3)) damage(view.starts);
        if (random.chance(0.3)) damage(view.places);
        if (random.chance(0.3)) damage(view.combinations);
        if (random.chance(0.3)) damage(view.regions);
        if (random.chance(0.3)) damage(view.halves);
        for (int64_t i = 0; i < view.weights.size(); ++i)
            if (random.chance(0.01)) view.weights[i] = hostile_float(random);
    }
    VoteCase::Found found = all.room(random);
    try {
        const Vote vote = all.vote();
        vote.round(all.out(found), nullptr, true, 0, vote.n_buckets(), threads, never);
        const EarlierCodes earlier = all.earlier(found);
        vote.deviations(earlier, 0, vote.n_buckets(), threads, never);
        VoteCase::Found again = all.room(random);
        vote.round(all.out(again), &earlier, false, 0, vote.n_buckets(), threads, never);
    } catch (const std::invalid_argument&) {
    }
}

}  // namespace scoup
