#include "region_weights.h"

#include <algorithm>
#include <numeric>
#include <vector>

#include "bucketed_records.h"

namespace scoup {
namespace {

// Merges the records of one bucket into triplets.
class Merger {
  public:
    // Writes at most levels times as many triplets as records; returns how many.
    int64_t operator()(const BucketedRecords& all, int64_t bucket, int32_t levels, int64_t stride, int64_t* gaussian,
                       int64_t* key, float* weight) {
        const Record *begin = all.begin(bucket), *end = all.end(bucket);
        order_.resize(size_t(end - begin));
        starts_.assign(kBucket + 1, 0);
        for (const Record* r = begin; r < end; ++r) ++starts_[(r->id & (kBucket - 1)) + 1];
        std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
        for (const Record* r = begin; r < end; ++r) order_[starts_[r->id & (kBucket - 1)]++] = uint32_t(r - begin);
        int64_t written = 0;
        for (int64_t g = 0, at = 0; g < kBucket; ++g) {
            const int64_t until = starts_[size_t(g)];
            for (int32_t level = 0; level < levels && at < until; ++level) {
                entries_.clear();
                for (int64_t i = at; i < until; ++i) {
                    const Record& record = begin[order_[size_t(i)]];
                    const int32_t label = all.labels(record.combination)[level];
                    if (label >= 0) entries_.push_back({label, double(record.weight)});
                }
                merge();
                for (const Entry& entry : entries_) {
                    gaussian[written] = bucket * kBucket + g;
                    key[written] = level * stride + entry.label;
                    weight[written++] = float(entry.weight);
                }
            }
            at = until;
        }
        return written;
    }

  private:
    struct Entry {
        int32_t label;
        double weight;
    };

    // Sorts the entries by label and adds up those of the same one, in the order they came.
    void merge() {
        if (entries_.size() < 2) return;
        const auto before = [](const Entry& a, const Entry& b) { return a.label < b.label; };
        if (entries_.size() > 32) {
            std::stable_sort(entries_.begin(), entries_.end(), before);
        } else {  // the usual handful, without memory of its own
            for (size_t e = 1; e < entries_.size(); ++e)
                for (size_t at = e; at > 0 && before(entries_[at], entries_[at - 1]); --at)
                    std::swap(entries_[at], entries_[at - 1]);
        }
        size_t last = 0;
        for (size_t e = 1; e < entries_.size(); ++e) {
            if (entries_[e].label == entries_[last].label)
                entries_[last].weight += entries_[e].weight;
            else
                entries_[++last] = entries_[e];
        }
        entries_.resize(last + 1);
    }

    std::vector<uint32_t> order_, starts_;
    std::vector<Entry> entries_;
};

}  // namespace

RegionWeights region_weights(const View& view, const LabelMaps& maps, int64_t stride, int n_threads,
                             const Interrupted& interrupted) {
    const BucketedRecords all(view, maps, n_threads, interrupted);
    const int64_t most = all.n_records() * maps.levels;
    RegionWeights out{0, Buffer<int64_t>(most), Buffer<int64_t>(most), Buffer<float>(most)};
    std::vector<int64_t> written(size_t(all.n_buckets()), 0);
    std::vector<Merger> mergers(static_cast<size_t>(std::max(n_threads, 1)));
    for_chunks(all.n_buckets(), n_threads, interrupted, [&](int64_t b, int worker) {
        const int64_t at = all.start(b) * maps.levels;
        written[size_t(b)] = mergers[size_t(worker)](all, b, maps.levels, stride, out.gaussian.data() + at,
                                                     out.key.data() + at, out.weight.data() + at);
    });
    for (int64_t b = 0; b < all.n_buckets(); ++b) {
        const int64_t at = all.start(b) * maps.levels, n = written[size_t(b)];
        std::copy(out.gaussian.data() + at, out.gaussian.data() + at + n, out.gaussian.data() + out.count);
        std::copy(out.key.data() + at, out.key.data() + at + n, out.key.data() + out.count);
        std::copy(out.weight.data() + at, out.weight.data() + at + n, out.weight.data() + out.count);
        out.count += n;
    }
    return out;
}

}  // namespace scoup
