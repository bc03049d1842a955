#include "uplift.h"

#include <stdexcept>
#include <string>

namespace scoup {

void Uplift::add(const View& view, const LabelMaps& maps, const std::vector<RegionCodes>& codes, int n_threads,
                 const Interrupted& interrupted) {
    BucketedRecords records(view, maps, n_threads, interrupted);
    int64_t entries_of_one = 0;
    for (const RegionCodes& level : codes) entries_of_one += level.k;
    Buffer<Entry> entries = expand(records, codes, entries_of_one);
    records.forget_labels();
    const std::lock_guard<std::mutex> lock(*busy_);
    const int64_t bytes = records.n_records() * int64_t(sizeof(Record)) + int64_t(entries.bytes());
    pending_.push_back({std::move(records), std::move(entries), entries_of_one});
    pending_bytes_ += bytes;
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
        for (const Record* r = view.records.begin(bucket); r < view.records.end(bucket); ++r) {
            float* sums = out_ + int64_t(r->id) * row;
            const Entry* entries = view.entries.data() + int64_t(r->combination) * view.entries_of_one;
            for (int64_t e = 0; e < view.entries_of_one; ++e) sums[entries[e].place] += r->weight * entries[e].weight;
        }
    }
}

}  // namespace scoup
