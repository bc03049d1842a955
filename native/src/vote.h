// The vote: what regions say of each Gaussian, from the region sums of all views (method.md, stage 2).
#pragma once

#include <cstdint>
#include <vector>

#include "buffer.h"
#include "threads.h"
#include "vote_kernels.h"

namespace scoup {

constexpr int kVoteBits = 8;
constexpr int64_t kVoteBucket = 1 << kVoteBits;  // Gaussians of a bucket: places in it fit a byte

// Region sums of one view by buckets of Gaussians. Arrays belong to the caller.
struct ViewSums {
    const uint32_t* buckets;       // [n_buckets] that have entries, rising
    const uint32_t* starts;        // [n_buckets + 1] into the entries
    const uint8_t* places;         // [entries] of the Gaussian in its bucket
    const uint16_t* combinations;  // [entries]
    const float* weights;          // [entries], or null if they are
    const uint16_t* halves;        // these: float16
    int64_t n_buckets, n_entries;
    const int64_t* regions;  // [combinations, levels] rows of the codes; -1 for none
    int64_t n_combinations;
};

// Sparse codes of all regions of one level.
struct RegionCodes {
    const uint8_t* indices8;    // [rows, k], or null if they are
    const uint16_t* indices16;  // these
    const float* weights;       // [rows, k]
    int64_t rows;
    int32_t k;

    int32_t atom(int64_t i) const { return indices8 != nullptr ? indices8[i] : indices16[i]; }
};

// Codes that the vote writes, [Gaussians of its buckets, levels, k]. One of the arrays of indices is null.
struct VotedCodes {
    uint8_t* indices8;
    uint16_t* indices16;
    float* weights;
    int32_t k;
};

// What the round before has found, and how strictly regions are held to it.
struct EarlierCodes {
    const uint8_t* indices8;    // [N, levels, k], or null if they are
    const uint16_t* indices16;  // these
    const float* weights;       // [N, levels, k], a decoded code has norm 1; zeros: no code
    int32_t k;
    const float* sharpness;  // [levels]

    int32_t atom(int64_t i) const { return indices8 != nullptr ? indices8[i] : indices16[i]; }
};

class Vote {
  public:
    // `grams`: [levels, n_atoms, n_atoms], inner products of the atoms; read later, too. Throws std::invalid_argument
    // if the sums are damaged: what they refer to must be there.
    Vote(int64_t n_gaussians, int32_t n_atoms, std::vector<ViewSums> views, const std::vector<RegionCodes>& levels,
         const float* grams);
    Vote(Vote&&) = default;

    // Adds up what all views say of the Gaussians in buckets first .. last - 1, and writes the `out.k` atoms that each
    // of them keeps, scaled to sum 1 or so that a decoded code has norm 1. `earlier` may be null.
    void round(const VotedCodes& out, const EarlierCodes* earlier, bool unit_norm, int64_t first, int64_t last,
               int n_threads, const Interrupted& interrupted) const;

    // Per level: 1 - cosine of each region and each Gaussian that meet in some view, in the order of Gaussians, then
    // views.
    std::vector<std::vector<float>> deviations(const EarlierCodes& earlier, int64_t first, int64_t last, int n_threads,
                                               const Interrupted& interrupted) const;

    int64_t n_gaussians() const { return n_gaussians_; }
    int64_t n_buckets() const { return (n_gaussians_ + kVoteBucket - 1) / kVoteBucket; }
    int32_t levels() const { return int32_t(k_.size()); }
    int32_t n_atoms() const { return n_atoms_; }

  private:
    class Worker;
    CombinationCodes codes() const {
        return {levels(), n_atoms_, k_.data(), k_of_all_, shares_.data(), regions_.data(), inverse_norms_.data()};
    }
    // The entries that one view has in one bucket.
    struct Piece {
        uint32_t view, at;  // the bucket is the at-th that the view names
    };
    void check(const ViewSums& view) const;
    void index_pieces();
    void expand(const ViewSums& view, int64_t first, const std::vector<RegionCodes>& levels,
                const std::vector<std::vector<float>>& inverse_norms);

    int64_t n_gaussians_;
    int32_t n_atoms_, k_of_all_ = 0;
    const float* grams_;
    std::vector<int32_t> k_;
    std::vector<ViewSums> views_;
    std::vector<int64_t> first_combination_;  // of each view among all
    std::vector<int64_t> first_piece_;        // [buckets + 1]
    std::vector<Piece> pieces_;               // by bucket, then view
    Buffer<Share> shares_;
    Buffer<int64_t> regions_;
    Buffer<float> inverse_norms_;
};

}  // namespace scoup
