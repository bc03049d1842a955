// Uplift: out [N, levels, n_atoms] += region sums times codes, over many views.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "agreement.h"
#include "bucketed_records.h"

namespace scoup {

// Sparse codes of one level's regions.
struct RegionCodes {
    const uint8_t* indices8;    // [rows, k], or null if they are
    const uint16_t* indices16;  // these
    const float* weights;       // [rows, k]
    int64_t rows;
    int32_t k;
};

// Collects the records of views and adds them to the accumulators many views at a time, so that each part of the
// accumulators comes into the cache once for all of those. Additions to one accumulator happen in the order of the
// views, then of the tiles: the result depends neither on threads nor on when what is pending is added.
class Uplift {
  public:
    // `out` and `earlier` must outlive this object. With earlier votes, each region's code counts as far as it agrees
    // with them.
    Uplift(float* out, int64_t n_gaussians, int32_t levels, int32_t n_atoms, const EarlierVotes& earlier = {})
        : out_(out), n_gaussians_(n_gaussians), levels_(levels), n_atoms_(n_atoms), earlier_(earlier) {}
    Uplift(Uplift&&) = default;

    // Takes a view in, and leaves it pending. `cosines`: one table a level with earlier votes, else none. Throws
    // std::out_of_range if a label has no code; after that and after an interruption, nothing has changed.
    void add(const View& view, const LabelMaps& maps, const std::vector<RegionCodes>& codes,
             const std::vector<RegionCosines>& cosines, int n_threads, const Interrupted& interrupted);

    // Adds what is pending to the accumulators. After an interruption, it can be called again.
    void flush(int n_threads, const Interrupted& interrupted);

    int64_t n_taken() const { return n_taken_; }  // views
    int64_t pending_bytes() const { return pending_bytes_; }
    int64_t n_gaussians() const { return n_gaussians_; }
    int32_t levels() const { return levels_; }
    int32_t n_atoms() const { return n_atoms_; }
    bool has_earlier_votes() const { return earlier_.given(); }

  private:
    // What a combination of regions adds for each unit of weight.
    struct Entry {
        int32_t place;  // level * n_atoms + atom
        float weight;
    };
    struct Pending {
        BucketedRecords records;
        Buffer<Entry> entries;  // [combinations, entries of one]
        int64_t entries_of_one;
        // With earlier votes:
        std::vector<int64_t> k;    // [levels] entries of a level
        Buffer<int64_t> tables;    // [combinations, levels]: where the region's cosines start, -1 for no region
        Buffer<float> cosines;     // [regions of all levels, atoms]
    };

    Buffer<Entry> expand(const BucketedRecords& records, const std::vector<RegionCodes>& codes, int64_t entries_of_one) const;
    void keep_cosines(Pending& view, const std::vector<RegionCodes>& codes, const std::vector<RegionCosines>& cosines) const;
    void apply(int64_t bucket, size_t first) const;
    void apply_agreeing(const Pending& view, int64_t bucket) const;

    float* out_;
    int64_t n_gaussians_;
    int32_t levels_, n_atoms_;
    EarlierVotes earlier_;
    std::vector<Pending> pending_;
    int64_t n_taken_ = 0, pending_bytes_ = 0;
    std::unique_ptr<std::mutex> busy_ = std::make_unique<std::mutex>();  // one caller at a time
    std::vector<size_t> applied_;  // of each bucket: the pending views that an interrupted flush has added
};

}  // namespace scoup
