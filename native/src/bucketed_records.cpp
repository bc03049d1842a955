#include "bucketed_records.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "view_tile.h"

namespace scoup {
namespace {

constexpr int64_t kMostGroups = 256;

template <class T>
void grow(T*& data, int64_t& capacity, int64_t needed, int64_t per_entry) {
    capacity = std::max(needed, capacity + capacity / 2);
    void* larger = std::realloc(data, size_t(capacity * per_entry) * sizeof(T));
    if (larger == nullptr) throw std::bad_alloc();
    data = static_cast<T*>(larger);
}

// Records of a group of neighbouring tiles.
struct Group : Records {
    Group() {
        reserve_records = [](Records& r, int64_t more) {
            grow(r.records, r.records_capacity, std::max<int64_t>(r.n_records + more, 4096), 1);
        };
        reserve_combinations = [](Records& r, int64_t more, int32_t levels) {
            grow(r.combinations, r.combinations_capacity, r.n_combinations + more, levels);
        };
    }
    // Room for the records of that many pairs of a Gaussian and a tile, unless they are unusually many.
    void expect(int64_t n_pairs) { reserve_records(*this, n_pairs + n_pairs / 4); }
    Group(const Group&) = delete;
    Group& operator=(const Group&) = delete;
    ~Group() {
        std::free(records);
        std::free(combinations);
    }
};

}  // namespace

BucketedRecords::BucketedRecords(const View& view, const LabelMaps& maps, int n_threads, const Interrupted& interrupted)
    : levels_(maps.levels), starts_(size_t(n_buckets_of(view.n_gaussians) + 1), 0) {
    const int64_t n_buckets = n_buckets_of(view.n_gaussians);
    const int64_t tiles = view.n_tiles();
    const int64_t tiles_at_once = std::max<int64_t>(16, (tiles + kMostGroups - 1) / kMostGroups);
    const int64_t n_groups = (tiles + tiles_at_once - 1) / tiles_at_once;
    std::vector<Group> groups(static_cast<size_t>(n_groups));
    std::vector<uint32_t> counts(size_t(n_groups * n_buckets), 0);
    const auto& kernels = pick(baseline::region_kernels, v3::region_kernels, v4::region_kernels);
    for_chunks(n_groups, n_threads, interrupted, [&](int64_t g, int) {
        Group& group = groups[size_t(g)];
        group.expect(view.starts[std::min((g + 1) * tiles_at_once, tiles)] - view.starts[g * tiles_at_once]);
        for (int64_t t = g * tiles_at_once; t < std::min((g + 1) * tiles_at_once, tiles); ++t)
            kernels.collect(tile_of(view, t), maps, group);
        uint32_t* count = counts.data() + g * n_buckets;
        for (int64_t r = 0; r < group.n_records; ++r) ++count[group.records[r].id >> kBucketBits];
    });

    std::vector<int64_t> places(counts.size());
    int64_t total = 0;
    for (int64_t b = 0; b < n_buckets; ++b) {
        starts_[size_t(b)] = total;
        for (int64_t g = 0; g < n_groups; ++g) {
            places[size_t(g * n_buckets + b)] = total;
            total += counts[size_t(g * n_buckets + b)];
        }
    }
    starts_[size_t(n_buckets)] = total;
    records_ = Buffer<Record>(total);
    std::vector<int64_t> first_combination(size_t(n_groups + 1), 0);
    for (int64_t g = 0; g < n_groups; ++g)
        first_combination[size_t(g + 1)] = first_combination[size_t(g)] + groups[size_t(g)].n_combinations;
    combinations_ = Buffer<int32_t>(first_combination.back() * levels_);
    for_chunks(n_groups, n_threads, interrupted, [&](int64_t g, int) {
        const Group& group = groups[size_t(g)];
        const int64_t offset = first_combination[size_t(g)];
        if (group.n_combinations > 0)
            std::memcpy(combinations_.data() + offset * levels_, group.combinations,
                        size_t(group.n_combinations * levels_) * sizeof(int32_t));
        int64_t* next = places.data() + g * n_buckets;
        for (int64_t r = 0; r < group.n_records; ++r) {
            const Record& record = group.records[r];
            records_[next[record.id >> kBucketBits]++] = {record.id, record.combination + uint32_t(offset), record.weight};
        }
    });
}

}  // namespace scoup
