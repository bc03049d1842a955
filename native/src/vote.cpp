#include "vote.h"

#include <algorithm>
#include <vector>

namespace scoup {
namespace {

constexpr int64_t kRowsAtOnce = 4096;

// Keeps the best of one row, largest first.
class Best {
  public:
    explicit Best(int32_t k) : k_(k), values_(size_t(k)), atoms_(size_t(k)) {}

    void find(const float* sums, int32_t n_atoms) {
        count_ = 0;
        float least = 0;  // what a sum must exceed
        for (int32_t atom = 0; atom < n_atoms; ++atom) {
            if (!(sums[atom] > least)) continue;
            int32_t at = count_ < k_ ? count_++ : k_ - 1;
            for (; at > 0 && values_[size_t(at - 1)] < sums[atom]; --at) {
                values_[size_t(at)] = values_[size_t(at - 1)];
                atoms_[size_t(at)] = atoms_[size_t(at - 1)];
            }
            values_[size_t(at)] = sums[atom];
            atoms_[size_t(at)] = atom;
            if (count_ == k_) least = values_[size_t(k_ - 1)];
        }
    }

    template <class Index>
    void write(Index* indices, float* weights) const {
        double total = 0;
        for (int32_t j = 0; j < count_; ++j) total += double(values_[size_t(j)]);
        for (int32_t j = 0; j < k_; ++j) {
            weights[j] = j < count_ ? float(double(values_[size_t(j)]) / total) : 0.0f;
            indices[j] = Index(weights[j] > 0 ? atoms_[size_t(j)] : 0);
        }
    }

  private:
    int32_t k_, count_ = 0;
    std::vector<float> values_;
    std::vector<int32_t> atoms_;
};

}  // namespace

void vote(const Vote& task, int n_threads, const Interrupted& interrupted) {
    for_chunks((task.rows + kRowsAtOnce - 1) / kRowsAtOnce, n_threads, interrupted, [&](int64_t chunk, int) {
        Best best(task.k);
        for (int64_t row = chunk * kRowsAtOnce; row < std::min((chunk + 1) * kRowsAtOnce, task.rows); ++row) {
            best.find(task.sums + row * task.n_atoms, task.n_atoms);
            if (task.indices8 != nullptr)
                best.write(task.indices8 + row * task.k, task.weights + row * task.k);
            else
                best.write(task.indices16 + row * task.k, task.weights + row * task.k);
        }
    });
}

}  // namespace scoup
