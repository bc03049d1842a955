#include "region_sums.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <utility>
#include <vector>

#include "projection_tile.h"

namespace scoup {
namespace {

constexpr int64_t kMostGroups = 256;
constexpr int kBucketBits = 10;  // Gaussians whose records are merged together: they fit into the first-level cache
constexpr int64_t kBucket = 1 << kBucketBits;

// Records of a group of neighbouring tiles.
struct alignas(64) Group : Records {  // a cache line of its own: counts rise all the time, on several threads
    Group() {
        reserve = [](Records& r, int64_t more) {
            const int64_t capacity = std::max<int64_t>({r.count + more, r.capacity + r.capacity / 2, 4096});
            void* larger = std::realloc(r.records, size_t(capacity) * sizeof(Record));
            if (larger == nullptr) throw std::bad_alloc();
            r.records = static_cast<Record*>(larger);
            r.capacity = capacity;
        };
    }
    Group(const Group&) = delete;
    Group& operator=(const Group&) = delete;
    ~Group() { std::free(records); }
};

// The records of a view by bucket of Gaussians, then by tile, then front to back.
struct Bucketed {
    Buffer<Record> records;
    std::vector<int64_t> starts;  // [buckets + 1]
};

Bucketed collect(const Projection& projection, const CombinationMap& map, int n_threads, const Interrupted& interrupted) {
    const int64_t n_buckets = (projection.n_gaussians + kBucket - 1) / kBucket;
    const int64_t tiles = projection.n_tiles();
    const int64_t tiles_at_once = std::max<int64_t>(16, (tiles + kMostGroups - 1) / kMostGroups);
    const int64_t n_groups = (tiles + tiles_at_once - 1) / tiles_at_once;
    std::vector<Group> groups(static_cast<size_t>(n_groups));
    std::vector<int64_t> places(size_t(n_groups * n_buckets), 0);
    const auto& kernels = pick(baseline::region_kernels, v3::region_kernels, v4::region_kernels);
    for_chunks(n_groups, n_threads, interrupted, [&](int64_t g, int) {
        Group& group = groups[size_t(g)];
        const int64_t first = g * tiles_at_once, last = std::min(first + tiles_at_once, tiles);
        group.reserve(group, (projection.starts[last] - projection.starts[first]) * 5 / 4);
        for (int64_t t = first; t < last; ++t) kernels.collect(tile_of(projection, t), map, group);
        int64_t* count = places.data() + g * n_buckets;
        for (int64_t r = 0; r < group.count; ++r) ++count[group.records[r].id >> kBucketBits];
    });

    Bucketed all;
    all.starts.assign(size_t(n_buckets + 1), 0);
    int64_t total = 0;
    for (int64_t b = 0; b < n_buckets; ++b) {
        all.starts[size_t(b)] = total;
        for (int64_t g = 0; g < n_groups; ++g) total += std::exchange(places[size_t(g * n_buckets + b)], total);
    }
    all.starts[size_t(n_buckets)] = total;
    all.records = Buffer<Record>(total);
    for_chunks(n_groups, n_threads, interrupted, [&](int64_t g, int) {
        int64_t* next = places.data() + g * n_buckets;
        const Group& group = groups[size_t(g)];
        for (int64_t r = 0; r < group.count; ++r) all.records[next[group.records[r].id >> kBucketBits]++] = group.records[r];
    });
    return all;
}

// Sorts the records of a bucket by Gaussian, then combination, and merges equal ones, in place. Branches that cannot be
// foreseen would cost more than the passes over all records do.
class Merger {
  public:
    // Returns how many are left, from the first on.
    int64_t operator()(Record* records, int64_t count) {
        if (count == 0) return 0;
        other_.resize(std::max(other_.size(), size_t(count)));
        Record *from = records, *to = other_.data();
        const auto sort_by = [&](const auto& digit) {
            places_.fill(0);
            for (int64_t r = 0; r < count; ++r) ++places_[digit(from[r])];
            uint32_t place = 0;
            for (uint32_t& next : places_) place += std::exchange(next, place);
            for (int64_t r = 0; r < count; ++r) to[places_[digit(from[r])]++] = from[r];
            std::swap(from, to);
        };
        uint32_t bits = 0;  // of all combinations
        for (int64_t r = 0; r < count; ++r) bits |= uint32_t(records[r].combination);
        for (int shift = 0; shift < 32 && bits >> shift != 0; shift += kBucketBits)
            sort_by([shift](const Record& record) { return uint32_t(record.combination) >> shift & (kBucket - 1); });
        sort_by([](const Record& record) { return record.id & (kBucket - 1); });

        int64_t last = -1;  // of those that are left
        uint32_t id = 0;
        int32_t combination = -1;
        double weight = 0;
        for (int64_t r = 0; r < count; ++r) {
            const Record next = from[r];
            const bool is_new = (next.id != id) | (next.combination != combination);
            weight = (is_new ? 0.0 : weight) + double(next.weight);
            id = next.id, combination = next.combination;
            last += is_new;
            records[last] = {id, combination, float(weight)};
        }
        return last + 1;
    }

  private:
    std::array<uint32_t, kBucket> places_;
    std::vector<Record> other_;
};

}  // namespace

RegionSums region_sums(const Projection& projection, const CombinationMap& map, int n_threads, const Interrupted& interrupted) {
    Bucketed all = collect(projection, map, n_threads, interrupted);
    const int64_t n_buckets = int64_t(all.starts.size()) - 1;
    std::vector<int64_t> firsts(size_t(n_buckets + 1), 0);
    std::vector<Merger> mergers(static_cast<size_t>(std::max(n_threads, 1)));
    for_chunks(n_buckets, n_threads, interrupted, [&](int64_t b, int worker) {
        const int64_t start = all.starts[size_t(b)];
        firsts[size_t(b + 1)] = mergers[size_t(worker)](all.records.data() + start, all.starts[size_t(b + 1)] - start);
    });
    for (int64_t b = 0; b < n_buckets; ++b) firsts[size_t(b + 1)] += firsts[size_t(b)];
    const int64_t count = firsts.back();
    RegionSums out{Buffer<int32_t>(count), Buffer<int32_t>(count), Buffer<float>(count)};
    for_chunks(n_buckets, n_threads, interrupted, [&](int64_t b, int) {
        const Record* record = all.records.data() + all.starts[size_t(b)];
        for (int64_t at = firsts[size_t(b)]; at < firsts[size_t(b + 1)]; ++at, ++record) {
            out.gaussian[at] = int32_t(record->id);
            out.combination[at] = record->combination;
            out.weight[at] = record->weight;
        }
    });
    return out;
}

}  // namespace scoup
