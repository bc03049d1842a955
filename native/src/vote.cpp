#include "vote.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

namespace scoup {
namespace {

constexpr int64_t kBucketsAtOnce = 4;
constexpr float kLeastNorm = 1e-6f;
constexpr int32_t kWide = 512;  // with more atoms, only the sums that a Gaussian's entries name are looked at

[[noreturn]] void refuse(const std::string& why) { throw std::invalid_argument("the region sums are damaged: " + why); }

// The norm of a decoded code of k entries.
template <class Atom>
float norm_of(const Atom& atom, const float* weights, int32_t k, const float* gram, int32_t n_atoms) {
    float squared = 0;
    for (int32_t one = 0; one < k; ++one)
        for (int32_t other = 0; other < k; ++other)
            squared += weights[one] * weights[other] * gram[int64_t(atom(one)) * n_atoms + atom(other)];
    return std::sqrt(std::max(squared, 0.0f));
}

// Per level, 1 / norm of each region's decoded code.
std::vector<std::vector<float>> inverse_norms_of(const std::vector<RegionCodes>& levels, const float* grams, int32_t n_atoms) {
    std::vector<std::vector<float>> all;
    for (size_t level = 0; level < levels.size(); ++level) {
        const RegionCodes& codes = levels[level];
        std::vector<float> found;
        for (int64_t row = 0; row < codes.rows; ++row) {
            const auto atom = [&](int32_t j) { return codes.atom(row * codes.k + j); };
            const float norm = norm_of(atom, codes.weights + row * codes.k, codes.k, grams + int64_t(level) * n_atoms * n_atoms, n_atoms);
            found.push_back(norm > 0 ? 1.0f / std::max(norm, 1e-12f) : 0.0f);
        }
        all.push_back(std::move(found));
    }
    return all;
}

}  // namespace

Vote::Vote(int64_t n_gaussians, int32_t n_atoms, std::vector<ViewSums> views, const std::vector<RegionCodes>& levels,
           const float* grams)
    : n_gaussians_(n_gaussians), n_atoms_(n_atoms), grams_(grams), views_(std::move(views)) {
    for (const RegionCodes& level : levels) {
        k_.push_back(level.k);
        k_of_all_ += level.k;
    }
    int64_t total = 0;
    for (const ViewSums& view : views_) {
        check(view);
        first_combination_.push_back(total);
        total += view.n_combinations;
    }
    if (total > std::numeric_limits<uint32_t>::max()) refuse("too many combinations of regions");
    index_pieces();
    shares_ = Buffer<Share>(total * k_of_all_);
    regions_ = Buffer<int64_t>(total * this->levels());
    inverse_norms_ = Buffer<float>(total * this->levels());
    const auto inverse_norms = inverse_norms_of(levels, grams, n_atoms);
    for (size_t v = 0; v < views_.size(); ++v) expand(views_[v], first_combination_[v], levels, inverse_norms);
}

void Vote::check(const ViewSums& view) const {
    for (int64_t b = 0; b < view.n_buckets; ++b) {
        if (view.starts[b] > view.starts[b + 1]) refuse("a bucket ends before it begins");
        if (b > 0 && view.buckets[b - 1] >= view.buckets[b]) refuse("buckets are not in their order");
    }
    if (view.n_buckets > 0 && int64_t(view.buckets[view.n_buckets - 1]) >= n_buckets()) refuse("there is no such bucket");
    if (view.starts[0] != 0 || int64_t(view.starts[view.n_buckets]) != view.n_entries) refuse("buckets have holes");
}

void Vote::index_pieces() {
    first_piece_.assign(size_t(n_buckets() + 1), 0);
    for (const ViewSums& view : views_)
        for (int64_t b = 0; b < view.n_buckets; ++b) ++first_piece_[size_t(view.buckets[b]) + 1];
    for (size_t b = 0; b < size_t(n_buckets()); ++b) first_piece_[b + 1] += first_piece_[b];
    pieces_.resize(size_t(first_piece_.back()));
    std::vector<int64_t> next(first_piece_.begin(), first_piece_.end());
    for (size_t v = 0; v < views_.size(); ++v)
        for (int64_t b = 0; b < views_[v].n_buckets; ++b)
            pieces_[size_t(next[views_[v].buckets[b]]++)] = {uint32_t(v), uint32_t(b)};
}

void Vote::expand(const ViewSums& view, int64_t first, const std::vector<RegionCodes>& levels,
                  const std::vector<std::vector<float>>& inverse_norms) {
    Share* share = shares_.data() + first * k_of_all_;
    for (int64_t c = 0; c < view.n_combinations; ++c)
        for (int32_t level = 0; level < this->levels(); ++level) {
            const RegionCodes& codes = levels[size_t(level)];
            const int64_t region = std::max<int64_t>(view.regions[c * this->levels() + level], -1);
            const int64_t at = (first + c) * this->levels() + level;
            if (region >= codes.rows) refuse("region " + std::to_string(region) + " has no code");
            regions_[at] = region;
            inverse_norms_[at] = region < 0 ? 0.0f : inverse_norms[size_t(level)][size_t(region)];
            for (int64_t i = region * codes.k; i < (region + 1) * codes.k; ++i)
                *share++ = region < 0 ? Share{level * n_atoms_, 0.0f} : Share{level * n_atoms_ + codes.atom(i), codes.weights[i]};
        }
}

// What a thread needs for a bucket.
class Vote::Worker {
  public:
    explicit Worker(const Vote& vote)
        : vote_(vote), kernels_(pick(baseline::vote_kernels, v3::vote_kernels, v4::vote_kernels)), codes_(vote.codes()),
          sums_(size_t(codes_.row())), products_(size_t(codes_.row())), is_coded_(new bool[size_t(vote.levels()) + 1]) {}

    // Brings the entries of all views in a bucket together by Gaussian, each one's by view, then combination.
    void open(int64_t bucket) {
        count_ = std::min(kVoteBucket, vote_.n_gaussians_ - bucket * kVoteBucket);
        starts_.assign(kVoteBucket + 1, 0);
        const Piece* first = vote_.pieces_.data() + vote_.first_piece_[size_t(bucket)];
        const Piece* last = vote_.pieces_.data() + vote_.first_piece_[size_t(bucket) + 1];
        for (const Piece* piece = first; piece < last; ++piece) {
            const ViewSums& view = vote_.views_[piece->view];
            const uint32_t start = view.starts[piece->at], end = view.starts[piece->at + 1];
            for (uint32_t i = start; i < end; ++i) ++starts_[size_t(view.places[i]) + 1];
        }
        for (size_t g = 0; g < size_t(kVoteBucket); ++g) starts_[g + 1] += starts_[g];
        if (starts_[size_t(count_)] != starts_.back()) refuse("there is no such Gaussian");
        entries_.resize(size_t(starts_.back()));
        next_.assign(starts_.begin(), starts_.end());
        for (const Piece* piece = first; piece < last; ++piece)
            take(vote_.views_[piece->view], uint32_t(vote_.first_combination_[piece->view]), piece->at);
    }

    int64_t count() const { return count_; }  // Gaussians

    // [levels, n_atoms] of a Gaussian of the bucket, into sums that are zero.
    void sum_up(int64_t place) { kernels_.add(entries_of(place), entries_in(place), codes_, sums_.data()); }
    void sum_up(int64_t place, const EarlierCodes& earlier, int64_t gaussian) {
        const int64_t n = entries_in(place);
        if (n == 0) return;
        factors_.resize(std::max(factors_.size(), size_t((n + 16) * vote_.levels())));
        kernels_.add_reweighted(entries_of(place), n, codes_, known(earlier, gaussian), factors_.data(), sums_.data());
    }

    // The `k` largest of each level's sums of a Gaussian, which are zero afterwards.
    template <class Index>
    void keep(int64_t place, int32_t k, bool unit_norm, Index* indices, float* weights) {
        const int32_t n_atoms = vote_.n_atoms_;
        const bool few_named = n_atoms > kWide && k <= kMostByInsertion;
        found_.resize(size_t(std::max(n_atoms, k)));
        atoms_.resize(found_.size());
        for (int32_t level = 0; level < vote_.levels(); ++level, indices += k, weights += k) {
            const float* row = sums_.data() + int64_t(level) * n_atoms;
            const int32_t count = few_named               ? take_largest_named(place, level, k)
                                  : k <= kMostByInsertion ? kernels_.largest(row, n_atoms, k, found_.data(), atoms_.data())
                                                          : sort(row, n_atoms, k);
            double total = 0;
            for (int32_t j = 0; j < count; ++j) total += double(found_[size_t(j)]);
            for (int32_t j = 0; j < k; ++j) {
                weights[j] = j < count ? float(double(found_[size_t(j)]) / total) : 0.0f;
                indices[j] = Index(weights[j] > 0 ? atoms_[size_t(j)] : 0);
            }
            if (!unit_norm || count == 0) continue;
            const float norm = norm_of([&](int32_t j) { return indices[j]; }, weights, count, gram(level), n_atoms);
            for (int32_t j = 0; j < count; ++j) weights[j] = norm > kLeastNorm ? weights[j] / norm : 0.0f;
        }
        if (!few_named) std::fill(sums_.begin(), sums_.end(), 0.0f);
    }

    void add_deviations(int64_t place, const EarlierCodes& earlier, int64_t gaussian, std::vector<std::vector<float>>& all) {
        const int64_t n = entries_in(place);
        if (n == 0) return;
        factors_.resize(std::max(factors_.size(), size_t(n)));
        const EarlierGaussian found = known(earlier, gaussian);
        for (int32_t level = 0; level < vote_.levels(); ++level) {
            const int64_t written = kernels_.deviations(entries_of(place), n, codes_, found, level, factors_.data());
            all[size_t(level)].insert(all[size_t(level)].end(), factors_.begin(), factors_.begin() + written);
        }
    }

  private:
    void take(const ViewSums& view, uint32_t first_combination, int64_t at) {
        const int64_t start = view.starts[at], count = view.starts[at + 1] - start;
        const float* weights = view.weights + start;
        if (view.weights == nullptr) {
            factors_.resize(std::max(factors_.size(), size_t(count)));
            kernels_.widen(view.halves + start, count, factors_.data());
            weights = factors_.data();
        }
        uint16_t highest = 0;
        for (int64_t i = 0; i < count; ++i) {
            const uint16_t combination = view.combinations[start + i];
            highest = std::max(highest, combination);
            entries_[next_[view.places[start + i]]++] = {first_combination + combination, weights[i]};
        }
        if (count > 0 && highest >= view.n_combinations) refuse("there is no combination " + std::to_string(highest));
    }

    const VoteEntry* entries_of(int64_t place) const { return entries_.data() + starts_[size_t(place)]; }
    int64_t entries_in(int64_t place) const { return starts_[size_t(place) + 1] - starts_[size_t(place)]; }
    const float* gram(int32_t level) const { return vote_.grams_ + int64_t(level) * vote_.n_atoms_ * vote_.n_atoms_; }

    EarlierGaussian known(const EarlierCodes& earlier, int64_t gaussian) {
        rows_.resize(size_t(earlier.k));
        for (int32_t level = 0; level < vote_.levels(); ++level) {
            const int64_t first = (gaussian * vote_.levels() + level) * earlier.k;
            float total = 0;
            for (int32_t j = 0; j < earlier.k; ++j) {
                total += earlier.weights[first + j];
                rows_[size_t(j)] = gram(level) + int64_t(earlier.atom(first + j)) * vote_.n_atoms_;
            }
            is_coded_[size_t(level)] = total > 0;
            kernels_.combine_rows(rows_.data(), earlier.weights + first, earlier.k, vote_.n_atoms_,
                                  products_.data() + int64_t(level) * vote_.n_atoms_);
        }
        return {products_.data(), is_coded_.get(), earlier.sharpness};
    }

    // Of those of a level that the Gaussian's entries name, the largest positive ones, the first atom of equals. Each is
    // set to zero when it is met: none counts twice.
    int32_t take_largest_named(int64_t place, int32_t level, int32_t k) {
        const VoteEntry* entries = entries_of(place);
        const int64_t n = entries_in(place), of_each = codes_.k[level];
        const int64_t first_share = std::accumulate(codes_.k, codes_.k + level, int64_t{0});
        named_.resize(std::max(named_.size(), size_t(n * of_each + 1)));
        float* const sums = sums_.data();
        Share* const named = named_.data();
        int64_t n_named = 0;
        for (int64_t i = 0; i < n; ++i) {
            const Share* share = codes_.shares + int64_t(entries[i].combination) * codes_.k_of_all + first_share;
            for (int64_t j = 0; j < of_each; ++j, ++share) {
                const float value = std::exchange(sums[share->place], 0.0f);
                named[n_named] = {share->place, value};
                n_named += value > 0;  // written always, kept only if there is something: cheaper than a branch
            }
        }
        const int64_t count = std::min<int64_t>(k, n_named);
        std::partial_sort(named, named + count, named + n_named, [](const Share& a, const Share& b) {
            return a.weight > b.weight || (a.weight == b.weight && a.place < b.place);
        });
        for (int64_t j = 0; j < count; ++j) {
            found_[size_t(j)] = named[j].weight;
            atoms_[size_t(j)] = named[j].place - level * vote_.n_atoms_;
        }
        return int32_t(count);
    }

    // Many: all positive ones in order. Not a number counts as nothing.
    int32_t sort(const float* row, int32_t n_atoms, int32_t k) {
        int32_t count = 0;
        for (int32_t atom = 0; atom < n_atoms; ++atom)
            if (row[atom] > 0) atoms_[size_t(count++)] = atom;
        std::stable_sort(atoms_.begin(), atoms_.begin() + count, [&](int32_t a, int32_t b) { return row[a] > row[b]; });
        count = std::min(count, k);
        for (int32_t j = 0; j < count; ++j) found_[size_t(j)] = row[atoms_[size_t(j)]];
        return count;
    }

    const Vote& vote_;
    const VoteKernels& kernels_;
    CombinationCodes codes_;
    int64_t count_ = 0;
    std::vector<uint32_t> starts_, next_;
    std::vector<VoteEntry> entries_;
    std::vector<Share> named_;
    std::vector<float> sums_, products_, factors_, found_;
    std::vector<int32_t> atoms_;
    std::vector<const float*> rows_;
    std::unique_ptr<bool[]> is_coded_;
};

void Vote::round(const VotedCodes& out, const EarlierCodes* earlier, bool unit_norm, int64_t first, int64_t last,
                 int n_threads, const Interrupted& interrupted) const {
    std::vector<Worker> workers;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) workers.emplace_back(*this);
    const auto vote_in = [&](auto* indices, Worker& worker, int64_t bucket) {
        worker.open(bucket);
        for (int64_t place = 0; place < worker.count(); ++place) {
            const int64_t gaussian = bucket * kVoteBucket + place;
            const int64_t at = (gaussian - first * kVoteBucket) * levels() * out.k;
            earlier == nullptr ? worker.sum_up(place) : worker.sum_up(place, *earlier, gaussian);
            worker.keep(place, out.k, unit_norm, indices + at, out.weights + at);
        }
    };
    for_chunks((last - first + kBucketsAtOnce - 1) / kBucketsAtOnce, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t begin = first + chunk * kBucketsAtOnce;
        for (int64_t bucket = begin; bucket < std::min(begin + kBucketsAtOnce, last); ++bucket) {
            if (out.indices8 != nullptr)
                vote_in(out.indices8, workers[size_t(worker)], bucket);
            else
                vote_in(out.indices16, workers[size_t(worker)], bucket);
        }
    });
}

std::vector<std::vector<float>> Vote::deviations(const EarlierCodes& earlier, int64_t first, int64_t last, int n_threads,
                                                 const Interrupted& interrupted) const {
    using Found = std::vector<std::vector<float>>;  // per level
    constexpr int64_t kAtOnce = 64;
    std::vector<Found> parts(static_cast<size_t>(std::max<int64_t>((last - first + kAtOnce - 1) / kAtOnce, 0)));
    std::vector<Worker> workers;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) workers.emplace_back(*this);
    for_chunks(int64_t(parts.size()), n_threads, interrupted, [&](int64_t chunk, int w) {
        Worker& worker = workers[size_t(w)];
        Found& found = parts[size_t(chunk)];
        found.resize(static_cast<size_t>(levels()));
        const int64_t begin = first + chunk * kAtOnce;
        for (int64_t bucket = begin; bucket < std::min(begin + kAtOnce, last); ++bucket) {
            worker.open(bucket);
            for (int64_t place = 0; place < worker.count(); ++place)
                worker.add_deviations(place, earlier, bucket * kVoteBucket + place, found);
        }
    });
    Found all(static_cast<size_t>(levels()));
    for (size_t level = 0; level < all.size(); ++level)
        for (const Found& part : parts) all[level].insert(all[level].end(), part[level].begin(), part[level].end());
    return all;
}

}  // namespace scoup
