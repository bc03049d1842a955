#include "code_sums.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "buffer.h"

namespace scoup {
namespace {

constexpr int64_t kRows = 16384;  // of a chunk
constexpr int64_t kMany = 3;      // columns from which a lane for each is quicker

// One worker's scratch, with the memory that it points to.
class SumMemory {
  public:
    explicit SumMemory(const GaussianCodes& codes)
        : stride_((kSumRows * codes.levels + kMostLanes - 1) / kMostLanes * kMostLanes), level_(stride_), starts_(stride_),
          atoms_(stride_ * codes.k), weights_(stride_ * codes.k), row_(kSumRows * codes.levels * codes.k), sums_(3 * stride_) {
        for (int64_t i = 0; i < stride_; ++i) level_[i] = int32_t(i % codes.levels);
        sums_.fill(0.0f);
        atoms_.fill(0);
    }

    SumScratch scratch() {
        float* const sums = sums_.data();
        return {stride_, level_.data(), atoms_.data(), weights_.data(), row_.data(), sums, sums + stride_, sums + 2 * stride_,
                starts_.data()};
    }

  private:
    int64_t stride_;
    Buffer<int32_t> level_, starts_, atoms_;
    Buffer<float> weights_, row_, sums_;
};

using Sums = std::function<int32_t(int64_t first, int64_t last, const SumScratch& scratch)>;

// Calls sums for all rows, chunk by chunk.
void for_rows(int64_t n, const GaussianCodes& codes, int n_threads, const Interrupted& interrupted, const Sums& sums) {
    if (n == 0 || codes.levels == 0) return;
    const int64_t most = std::numeric_limits<int32_t>::max();
    if (kSumRows * codes.levels * std::max(codes.k, 1) > most || codes.levels * codes.index_values() > most)
        throw std::invalid_argument("codes of too many levels or entries");
    const int64_t chunks = (n + kRows - 1) / kRows;
    n_threads = workers(chunks, n_threads);
    std::vector<SumMemory> memory;
    for (int worker = 0; worker < n_threads; ++worker) memory.emplace_back(codes);
    std::vector<int32_t> largest(size_t(chunks), -1);
    for_chunks(chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = chunk * kRows, last = std::min(n, first + kRows);
        largest[size_t(chunk)] = sums(first, last, memory[size_t(worker)].scratch());
    });
    if (codes.k == 0) return;  // no index was met
    for (const int32_t of_chunk : largest) check_atoms(of_chunk, codes.n_atoms);
}

// The scores of columns `from` .. `from` + `count` - 1, a column every `column` numbers and an atom every `step`. Levels are as
// long as an index can be large; atoms that none can name are left out.
Buffer<float> padded(const GaussianCodes& codes, const AtomScores& scores, int64_t from, int64_t count, int64_t column,
                     int64_t step) {
    const int64_t values = codes.index_values();
    Buffer<float> table(codes.levels * values * std::max(count, step));
    table.fill(0.0f);
    for (int64_t level = 0; level < codes.levels; ++level)
        for (int64_t atom = 0; atom < std::min<int64_t>(codes.n_atoms, values); ++atom)
            for (int64_t c = 0; c < count; ++c)
                table[c * column + (level * values + atom) * step] =
                    scores.values[(level * codes.n_atoms + atom) * scores.columns + from + c];
    return table;
}

// Columns one after the other.
Buffer<float> padded(const GaussianCodes& codes, const AtomScores& scores) {
    return padded(codes, scores, 0, scores.columns, codes.levels * codes.index_values(), 1);
}

const CodeSumKernels& kernels() {
    return pick(baseline::code_sum_kernels, v3::code_sum_kernels, v4::code_sum_kernels);
}

}  // namespace

void check_atoms(int32_t largest, int32_t n_atoms) {
    if (largest >= n_atoms)
        throw std::invalid_argument("a code refers to atom " + std::to_string(largest) + " of " + std::to_string(n_atoms));
}

void code_scores(int64_t n, const GaussianCodes& codes, const AtomScores& scores, float* out, int n_threads,
                 const Interrupted& interrupted) {
    const Buffer<float> table = padded(codes, scores);
    for_rows(n, codes, n_threads, interrupted, [&](int64_t first, int64_t last, const SumScratch& scratch) {
        return kernels().scores(codes, {table.data(), scores.columns}, first, last, scratch, out);
    });
}

void inverse_code_norms(int64_t n, const GaussianCodes& codes, const float* grams, float* out, int n_threads,
                        const Interrupted& interrupted) {
    if (int64_t(codes.levels) * codes.n_atoms * codes.n_atoms > std::numeric_limits<int32_t>::max())
        throw std::invalid_argument("products of too many levels or atoms");
    for_rows(n, codes, n_threads, interrupted, [&](int64_t first, int64_t last, const SumScratch& scratch) {
        return kernels().inverse_norms(codes, grams, first, last, scratch, out);
    });
}

void best_code_cosines(int64_t n, const GaussianCodes& codes, const AtomScores& scores, const float* inverse_norms,
                       float* out, int n_threads, const Interrupted& interrupted) {
    const Buffer<float> table = padded(codes, scores);
    for_rows(n, codes, n_threads, interrupted, [&](int64_t first, int64_t last, const SumScratch& scratch) {
        return kernels().best(codes, {table.data(), scores.columns}, inverse_norms, first, last, scratch, out);
    });
}

void code_relevancy(int64_t n, const GaussianCodes& codes, const AtomScores& scores, const KnownCosines& known, float* out,
                    int n_threads, const Interrupted& interrupted) {
    for (int64_t from = 0; from < scores.columns; from += kMostLanes) {
        const int64_t count = std::min<int64_t>(kMostLanes, scores.columns - from);
        const bool many = count >= kMany;
        const Buffer<float> table = many ? padded(codes, scores, from, count, 1, kMostLanes)
                                         : padded(codes, scores, from, count, codes.levels * codes.index_values(), 1);
        const auto kernel = many ? kernels().relevancy_of_many : kernels().relevancy;
        for_rows(n, codes, n_threads, interrupted, [&](int64_t first, int64_t last, const SumScratch& scratch) {
            return kernel(codes, {table.data(), int32_t(count)}, known, n, first, last, scratch,
                          out + from * codes.levels * n);
        });
    }
}

}  // namespace scoup
