#include "uplift.h"

#include <algorithm>
#include <stdexcept>
#include <string>

namespace scoup {

void Uplift::add(const View& view, const LabelMaps& maps, const std::vector<RegionCodes>& codes,
                 const std::vector<RegionCosines>& cosines, int n_threads, const Interrupted& interrupted) {
    BucketedRecords records(view, maps, n_threads, interrupted);
    int64_t entries_of_one = 0;
    for (const RegionCodes& level : codes) entries_of_one += level.k;
    Buffer<Entry> entries = expand(records, codes, entries_of_one);
    Pending taken{std::move(records), std::move(entries), entries_of_one, {}, {}, {}};
    if (earlier_.given()) keep_cosines(taken, codes, cosines);
    taken.records.forget_labels();
    const std::lock_guard<std::mutex> lock(*busy_);
    pending_bytes_ += taken.records.n_records() * int64_t(sizeof(Record)) +
                      int64_t(taken.entries.bytes() + taken.tables.bytes() + taken.cosines.bytes());
    pending_.push_back(std::move(taken));
    ++n_taken_;
}

Buffer<Uplift::Entry> Uplift::expand(const BucketedRecords& records, const std::vector<RegionCodes>& codes,
                                     int64_t entries_of_one) const {
    Buffer<Entry> entries(records.n_combinations() * entries_of_one);
    int64_t at = 0;
    for (int64_t c = 0; c < records.n_combinations(); ++c)
        for (int32_t level = 0; level < levels_; ++level) {
            const RegionCodes& code = codes[size_t(level)];
            const int64_t label = records.labels(c)[level];
            if (label >= code.rows) throw std::out_of_range("label " + std::to_string(label) + " has no code");
            for (int64_t i = label * code.k; i < (label + 1) * code.k; ++i, ++at) {
                const int atom = label < 0 ? 0 : code.indices8 != nullptr ? code.indices8[i] : code.indices16[i];
                entries[at] = {level * n_atoms_ + atom, label < 0 ? 0.0f : code.weights[i]};
            }
        }
    return entries;
}

void Uplift::keep_cosines(Pending& view, const std::vector<RegionCodes>& codes,
                          const std::vector<RegionCosines>& cosines) const {
    std::vector<int64_t> start;
    int64_t rows = 0;
    for (const RegionCosines& level : cosines) {
        start.push_back(rows);
        rows += level.rows;
    }
    view.cosines = Buffer<float>(rows * n_atoms_);
    for (int32_t level = 0; level < levels_; ++level) {
        const RegionCosines& table = cosines[size_t(level)];
        std::copy_n(table.cosines, table.rows * n_atoms_, view.cosines.data() + start[size_t(level)] * n_atoms_);
        view.k.push_back(codes[size_t(level)].k);
    }
    view.tables = Buffer<int64_t>(view.records.n_combinations() * levels_);
    for (int64_t c = 0, at = 0; c < view.records.n_combinations(); ++c)
        for (int32_t level = 0; level < levels_; ++level, ++at) {
            const int64_t label = view.records.labels(c)[level];
            view.tables[at] = label < 0 ? -1 : (start[size_t(level)] + label) * n_atoms_;
        }
}

void Uplift::flush(int n_threads, const Interrupted& interrupted) {
    const std::lock_guard<std::mutex> lock(*busy_);
    if (pending_.empty()) return;
    applied_.resize(size_t(n_buckets_of(n_gaussians_)), 0);
    for_chunks(n_buckets_of(n_gaussians_), n_threads, interrupted, [&](int64_t bucket, int) {
        apply(bucket, applied_[size_t(bucket)]);
        applied_[size_t(bucket)] = pending_.size();
    });
    pending_.clear();
    pending_bytes_ = 0;
    applied_.clear();
}

void Uplift::apply(int64_t bucket, size_t first) const {
    const int64_t row = int64_t(levels_) * n_atoms_;
    for (size_t v = first; v < pending_.size(); ++v) {
        const Pending& view = pending_[v];
        if (earlier_.given()) {
            apply_agreeing(view, bucket);
            continue;
        }
        for (const Record* r = view.records.begin(bucket); r < view.records.end(bucket); ++r) {
            float* sums = out_ + int64_t(r->id) * row;
            const Entry* entries = view.entries.data() + int64_t(r->combination) * view.entries_of_one;
            for (int64_t e = 0; e < view.entries_of_one; ++e) sums[entries[e].place] += r->weight * entries[e].weight;
        }
    }
}

void Uplift::apply_agreeing(const Pending& view, int64_t bucket) const {
    const int64_t row = int64_t(levels_) * n_atoms_;
    for (const Record* r = view.records.begin(bucket); r < view.records.end(bucket); ++r) {
        float* sums = out_ + int64_t(r->id) * row;
        const Entry* entry = view.entries.data() + int64_t(r->combination) * view.entries_of_one;
        const int64_t* table = view.tables.data() + int64_t(r->combination) * levels_;
        for (int32_t level = 0; level < levels_; ++level) {
            const int64_t k = view.k[size_t(level)];
            if (table[level] >= 0) {
                const float* cosines = view.cosines.data() + table[level];
                const float weight = r->weight * agreement(earlier_, int64_t(r->id), levels_, level, cosines);
                for (int64_t e = 0; e < k; ++e) sums[entry[e].place] += weight * entry[e].weight;
            }
            entry += k;
        }
    }
}

}  // namespace scoup
