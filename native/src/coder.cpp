#include "coder.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "buffer.h"
#include "coder_kernels.h"

namespace scoup {
namespace {

constexpr int64_t kChunkRows = 48;     // a multiple of the tiles of every instruction set
constexpr int64_t kFlushRows = 1024;   // rows summed in single precision before they join the double sums
constexpr int64_t kFewOthers = 8;      // so few are not worth packing
constexpr double kThreadWork = 4e6;    // multiplications that are worth a thread
constexpr float kDependentShare = 1e-5f;

const CoderKernels& coder() { return pick(baseline::coder_kernels, v3::coder_kernels, v4::coder_kernels); }
const ProductKernels& product() {
    return pick(baseline::coder_product_kernels, v3::coder_product_kernels, v4::coder_product_kernels);
}

int64_t chunks_of(int64_t count, int64_t size) { return (count + size - 1) / size; }

// Small work is done by fewer threads than there are: starting one costs more than it would save.
int threads_for(double multiplications, int n_threads) {
    return int(std::clamp(multiplications / kThreadWork, 1.0, double(std::max(n_threads, 1))));
}

// The right-hand side of products, laid out for the kernels that packed it.
class Packed {
  public:
    explicit Packed(Matrix others)
        : kernels_(product()),
          panels_(chunks_of(others.rows, kernels_.panel)),
          depth_(others.columns),
          values_(panels_ * kernels_.panel * depth_) {
        kernels_.pack(others.data, others.rows, depth_, values_.data());
    }

    int64_t columns() const { return panels_ * kernels_.panel; }

    void multiply(const float* rows, int64_t count, float* out, int64_t stride) const {
        kernels_.multiply(rows, count, depth_, values_.data(), panels_, out, stride);
    }

  private:
    const ProductKernels& kernels_;
    const int64_t panels_, depth_;
    Buffer<float> values_;
};

// A codebook in Gram space, padded.
class Gram {
  public:
    // From a matrix [L, L].
    Gram(const float* gram, int64_t n_atoms) : Gram(n_atoms) {
        for (int64_t i = 0; i < n_atoms; ++i)
            std::memcpy(values_.data() + i * stride, gram + i * n_atoms, size_t(n_atoms) * sizeof(float));
        finish();
    }

    // From atoms [L, D] and the same packed.
    Gram(Matrix atoms, const Packed& packed, int n_threads, const Interrupted& interrupted) : Gram(atoms.rows) {
        const int threads = threads_for(double(atoms.rows) * double(atoms.rows * atoms.columns), n_threads);
        for_chunks(chunks_of(atoms.rows, kChunkRows), threads, interrupted, [&](int64_t chunk, int) {
            const int64_t first = chunk * kChunkRows, count = std::min(kChunkRows, atoms.rows - first);
            packed.multiply(atoms.data + first * atoms.columns, count, values_.data() + first * stride, stride);
        });
        finish();
    }

    CodeProblem problem(const CodeSettings& settings) const {
        return {values_.data(), norms_.data(), floor_.data(), n_atoms, stride, settings.slots, settings.swap_passes};
    }

    const int64_t n_atoms, stride;

  private:
    explicit Gram(int64_t atoms)
        : n_atoms(atoms),
          stride(chunks_of(atoms, kPad) * kPad),
          values_(atoms * stride),
          norms_(stride),
          floor_(stride) {
        values_.fill(0);
    }

    void finish() {
        for (int64_t j = 0; j < stride; ++j) {
            norms_[j] = j < n_atoms ? values_[j * stride + j] : 0;
            // Atoms without length, and the padding, are never chosen.
            floor_[j] = norms_[j] > 0 ? kDependentShare * norms_[j] : std::numeric_limits<float>::infinity();
        }
    }

    Buffer<float> values_, norms_, floor_;
};

// Scratch for each worker, made when it first needs it.
class Scratch {
  public:
    Scratch(int workers, const CodeProblem& problem)
        : stride_(problem.stride), slots_(problem.slots), workers_(size_t(workers)) {}

    struct Worker {
        Buffer<float> similarities, values;
        CoderScratch code;
    };

    Worker& of(int worker) {
        Worker& mine = workers_[size_t(worker)];
        if (mine.values.size() == 0) {
            mine.similarities = Buffer<float>(kChunkRows * stride_);
            mine.similarities.fill(0);  // the padding stays so
            mine.values = Buffer<float>((2 + slots_) * stride_);
            float* at = mine.values.data();
            mine.code = {at, at + stride_, at + 2 * stride_};
        }
        return mine;
    }

  private:
    const int64_t stride_, slots_;
    std::vector<Worker> workers_;
};

// Codes rows, chunk by chunk; fill(first, count, out) writes their similarities, `stride` apart, at the cost of `depth`
// multiplications each.
template <class Fill>
void code_chunks(int64_t n_rows, int64_t depth, const CodeProblem& problem, const int32_t* warm, const CodesOut& out,
                 int n_threads, const Interrupted& interrupted, const Fill& fill) {
    const int slots = problem.slots;
    const double work_of_row = double(problem.stride) * double(depth + 20 * slots);
    const int threads = threads_for(double(n_rows) * work_of_row, n_threads);
    Scratch scratch(threads, problem);
    for_chunks(chunks_of(n_rows, kChunkRows), threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = chunk * kChunkRows, count = std::min(kChunkRows, n_rows - first);
        Scratch::Worker& mine = scratch.of(worker);
        fill(first, count, mine.similarities.data());
        for (int64_t r = first; r < first + count; ++r)
            out.cosines[r] = coder().code(problem, mine.code, mine.similarities.data() + (r - first) * problem.stride,
                                          warm ? warm + r * slots : nullptr, out.support + r * slots,
                                          out.weights + r * slots);
    });
}

}  // namespace

void code_similarities(Matrix similarities, const float* gram, const CodeSettings& settings, const int32_t* warm,
                       const CodesOut& out, int n_threads, const Interrupted& interrupted) {
    const Gram padded(gram, similarities.columns);
    const auto bytes = size_t(similarities.columns) * sizeof(float);
    code_chunks(similarities.rows, 1, padded.problem(settings), warm, out, n_threads, interrupted,
                [&](int64_t first, int64_t count, float* to) {
                    for (int64_t r = 0; bytes > 0 && r < count; ++r)
                        std::memcpy(to + r * padded.stride, similarities.data + (first + r) * similarities.columns, bytes);
                });
}

void code_rows(Matrix rows, Matrix atoms, const CodeSettings& settings, const int32_t* warm, const CodesOut& out,
               int n_threads, const Interrupted& interrupted) {
    const Packed packed(atoms);
    const Gram gram(atoms, packed, n_threads, interrupted);
    code_chunks(rows.rows, rows.columns, gram.problem(settings), warm, out, n_threads, interrupted,
                [&](int64_t first, int64_t count, float* to) {
                    packed.multiply(rows.data + first * rows.columns, count, to, gram.stride);
                });
}

void row_products(Matrix rows, Matrix others, float* out, int n_threads, const Interrupted& interrupted) {
    const int64_t depth = rows.columns, n_others = others.rows;
    const int threads = threads_for(double(rows.rows) * double(depth * n_others), n_threads);
    const int64_t n_chunks = chunks_of(rows.rows, kChunkRows);
    if (n_others <= kFewOthers) {
        for_chunks(n_chunks, threads, interrupted, [&](int64_t chunk, int) {
            const int64_t first = chunk * kChunkRows, count = std::min(kChunkRows, rows.rows - first);
            product().dots(rows.data + first * depth, count, depth, others.data, n_others, out + first * n_others);
        });
        return;
    }
    const Packed packed(others);
    const int64_t stride = packed.columns();
    std::vector<Buffer<float>> scratch(static_cast<size_t>(threads));
    for_chunks(n_chunks, threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = chunk * kChunkRows, count = std::min(kChunkRows, rows.rows - first);
        Buffer<float>& mine = scratch[size_t(worker)];
        if (stride != n_others && mine.size() == 0) mine = Buffer<float>(kChunkRows * stride);
        float* to = stride == n_others ? out + first * n_others : mine.data();
        packed.multiply(rows.data + first * depth, count, to, stride);
        if (stride == n_others) return;
        for (int64_t r = 0; r < count; ++r)
            std::memcpy(out + (first + r) * n_others, to + r * stride, size_t(n_others) * sizeof(float));
    });
}

void code_moments(Matrix rows, const int32_t* support, const float* weights, int slots, const float* scale,
                  int64_t n_atoms, double* within, double* toward, int n_threads, const Interrupted& interrupted) {
    const int64_t dim = rows.columns;
    std::fill(within, within + n_atoms * n_atoms, 0.0);
    std::fill(toward, toward + n_atoms * dim, 0.0);
    for (int64_t r = 0; r < rows.rows; ++r) {
        const int32_t* atoms = support + r * slots;
        const float* mine = weights + r * slots;
        for (int i = 0; i < slots; ++i) {
            const double weight = double(scale[r]) * mine[i];
            for (int j = 0; j < slots; ++j)
                if (atoms[i] >= 0 && atoms[j] >= 0) within[atoms[i] * n_atoms + atoms[j]] += weight * mine[j];
        }
    }
    // Threads share the columns: every number is then summed in the order of the rows, however many they are.
    const int threads = threads_for(double(rows.rows) * double(slots * dim), n_threads);
    const int64_t width = std::max<int64_t>(chunks_of(chunks_of(dim, threads), 64), 1) * 64;
    for_chunks(chunks_of(dim, width), threads, interrupted, [&](int64_t chunk, int) {
        const int64_t first = chunk * width, mine = std::min(width, dim - first);
        Buffer<float> sums(n_atoms * mine);
        for (int64_t r = 0; r < rows.rows; r += kFlushRows) {
            sums.fill(0);
            product().pull(rows.data + r * dim, std::min(kFlushRows, rows.rows - r), dim, first, mine,
                           support + r * slots, weights + r * slots, slots, scale + r, sums.data());
            for (int64_t atom = 0; atom < n_atoms; ++atom)
                for (int64_t d = 0; d < mine; ++d) toward[atom * dim + first + d] += sums[atom * mine + d];
        }
    });
}

bool solve_positive_definite(const double* matrix, int64_t size, double* right, int64_t columns, int n_threads,
                             const Interrupted& interrupted) {
    if (size == 0) return true;
    Buffer<double> factor(size * size);
    std::memcpy(factor.data(), matrix, size_t(size * size) * sizeof(double));
    if (!product().factor(factor.data(), size)) return false;
    constexpr int64_t kWidth = 64;
    for_chunks(chunks_of(columns, kWidth), n_threads, interrupted, [&](int64_t chunk, int) {
        const int64_t first = chunk * kWidth;
        product().substitute(factor.data(), size, right + first, columns, std::min(kWidth, columns - first));
    });
    return true;
}

}  // namespace scoup
