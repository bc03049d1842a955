// The region records of a whole view, by ranges of Gaussians.
#pragma once

#include <cstdint>
#include <vector>

#include "buffer.h"
#include "region_records.h"
#include "threads.h"
#include "view.h"

namespace scoup {

// Gaussians of a bucket: their accumulators (3 levels of 64 atoms: 0.8 MB) fit into a core's second-level cache.
constexpr int kBucketBits = 10;
constexpr int64_t kBucket = 1 << kBucketBits;

inline int64_t n_buckets_of(int64_t n_gaussians) { return (n_gaussians + kBucket - 1) / kBucket; }

// The records of a view, ordered by bucket of Gaussians, then by tile, then front to back: the same whatever the number
// of threads.
class BucketedRecords {
  public:
    BucketedRecords(const View& view, const LabelMaps& maps, int n_threads, const Interrupted& interrupted);

    int64_t n_buckets() const { return int64_t(starts_.size()) - 1; }
    int64_t n_records() const { return starts_.back(); }
    int64_t start(int64_t bucket) const { return starts_[size_t(bucket)]; }
    const Record* begin(int64_t bucket) const { return records_.data() + starts_[size_t(bucket)]; }
    const Record* end(int64_t bucket) const { return records_.data() + starts_[size_t(bucket + 1)]; }

    int64_t n_combinations() const { return levels_ == 0 ? 0 : combinations_.size() / levels_; }
    // One label a level.
    const int32_t* labels(int64_t combination) const { return combinations_.data() + combination * levels_; }

    // Lets the labels go, once what the combinations stand for is known otherwise.
    void forget_labels() { combinations_ = Buffer<int32_t>(); }

  private:
    int32_t levels_;
    std::vector<int64_t> starts_;  // [buckets + 1] into the records
    Buffer<Record> records_;
    Buffer<int32_t> combinations_;
};

}  // namespace scoup
