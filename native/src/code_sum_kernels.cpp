#include "code_sum_kernels.h"

#include "half.h"
#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

SCOUP_INLINE Ints load(const int32_t* from) {
    Ints x;
    __builtin_memcpy(&x, from, sizeof x);
    return x;
}
SCOUP_INLINE void store(int32_t* to, Ints x) { __builtin_memcpy(to, &x, sizeof x); }

SCOUP_INLINE Floats gather(const float* table, Ints at) {
#if defined(__AVX512F__)
    return (Floats)_mm512_mask_i32gather_ps(_mm512_setzero_ps(), 0xffff, (__m512i)at, table, 4);
#elif defined(__AVX2__)
    return (Floats)_mm256_i32gather_ps(table, (__m256i)at, 4);
#else
    Floats x{};
    for (int lane = 0; lane < kLanes; ++lane) x[lane] = table[at[lane]];
    return x;
#endif
}

// 1 / (1 + exp(-x)), to 3e-7; x where that is not a number.
SCOUP_INLINE Floats logistic(Floats x) {
    constexpr float kLog2E = 1.44269504089f;
    const Ints positive = x > 0.0f;
    const Floats away = only(positive, x) - only(~positive, x);
    const Floats power = exp2(larger(-kLog2E * away, all(-125.0f)));
    const Floats found = (only(positive, all(1.0f)) + only(~positive, power)) / (power + 1.0f);
    const Ints known = x == x;
    return (Floats)(((Ints)found & known) | ((Ints)x & ~known));
}

// The Gaussians at work.
struct SumBlock {
    int64_t row, rows, sums;  // the first, how many, and their sums
};

// One plane for each entry of the sums: `planes` [k, stride] of `values` [sums, k].
template <int K, class From, class To>
SCOUP_INLINE void spread(const From* __restrict values, int64_t sums, int32_t k, int64_t stride, To* __restrict planes) {
    const int32_t length = K > 0 ? K : k;
    for (int64_t i = 0; i < sums; ++i)
        for (int32_t j = 0; j < length; ++j) planes[j * stride + i] = To(values[i * length + j]);
    for (int64_t i = sums; i % kMostLanes != 0; ++i)
        for (int32_t j = 0; j < length; ++j) planes[j * stride + i] = To(0);
}

// Calls body(block) for the rows, a block at a time, with atoms and weights of its entries in the scratch.
template <class Index, class Weight, class Body>
SCOUP_INLINE int32_t for_blocks(const GaussianCodes& codes, const Index* all_indices, const Weight* all_weights,
                                int64_t first, int64_t last, const SumScratch& scratch, const Body& body) {
    const int64_t entries = int64_t(codes.levels) * codes.k;
    int32_t largest = 0;
    for (int64_t row = first; row < last; row += kSumRows) {
        const int64_t rows = last - row < kSumRows ? last - row : kSumRows, sums = rows * codes.levels;
        const Index* indices = all_indices + row * entries;
        const float* weights = from_stored(all_weights + row * entries, int(rows * entries), scratch.row);
        if (codes.k == 4) {
            spread<4>(indices, sums, 4, scratch.stride, scratch.atoms);
            spread<4>(weights, sums, 4, scratch.stride, scratch.weights);
        } else {
            spread<0>(indices, sums, codes.k, scratch.stride, scratch.atoms);
            spread<0>(weights, sums, codes.k, scratch.stride, scratch.weights);
        }
        // Of the copies, for Python's arrays may change meanwhile.
        int32_t most = 0;
        for (int64_t i = 0; i < codes.k * scratch.stride; ++i) most = scratch.atoms[i] > most ? scratch.atoms[i] : most;
        largest = most > largest ? most : largest;
        if (most < codes.n_atoms) body(SumBlock{row, rows, sums});
    }
    return largest;
}

template <class Body>
SCOUP_INLINE int32_t for_codes(const GaussianCodes& codes, int64_t first, int64_t last, const SumScratch& scratch,
                               const Body& body) {
    if (codes.indices8 != nullptr)
        return codes.weights != nullptr ? for_blocks(codes, codes.indices8, codes.weights, first, last, scratch, body)
                                        : for_blocks(codes, codes.indices8, codes.half_weights, first, last, scratch, body);
    return codes.weights != nullptr ? for_blocks(codes, codes.indices16, codes.weights, first, last, scratch, body)
                                    : for_blocks(codes, codes.indices16, codes.half_weights, first, last, scratch, body);
}

// W A of the sums from `i` on, by one column.
SCOUP_INLINE Floats weighted(const GaussianCodes& codes, const SumScratch& scratch, const float* column, int64_t i) {
    const Ints start = load(scratch.starts + i);
    Floats sum{};
    for (int64_t at = i; at < codes.k * scratch.stride; at += scratch.stride)
        sum += load(scratch.weights + at) * gather(column, load(scratch.atoms + at) + start);
    return sum;
}

// Where the table of each sum's level begins, for tables of `size` per level.
void begin_levels(int32_t size, const SumScratch& scratch) {
    for (int64_t i = 0; i < scratch.stride; ++i) scratch.starts[i] = scratch.level[i] * size;
}

SCOUP_INLINE int64_t column_size(const GaussianCodes& codes) { return codes.levels * codes.index_values(); }

void copy(const float* from, int64_t count, float* to) { __builtin_memcpy(to, from, size_t(count) * sizeof(float)); }

int32_t scores(const GaussianCodes& codes, const ScoreTable& table, int64_t first, int64_t last, const SumScratch& scratch,
               float* out) {
    begin_levels(int32_t(codes.index_values()), scratch);
    return for_codes(codes, first, last, scratch, [&](const SumBlock& block) __attribute__((always_inline)) {
        for (int32_t c = 0; c < table.columns; ++c) {
            const float* column = table.values + c * column_size(codes);
            for (int64_t i = 0; i < block.sums; i += kLanes) store(scratch.sums + i, weighted(codes, scratch, column, i));
            float* to = out + block.row * codes.levels * table.columns + c;
            if (table.columns == 1) copy(scratch.sums, block.sums, to);
            else
                for (int64_t i = 0; i < block.sums; ++i) to[i * table.columns] = scratch.sums[i];
        }
    });
}

int32_t inverse_norms(const GaussianCodes& codes, const float* grams, int64_t first, int64_t last,
                      const SumScratch& scratch, float* out) {
    const int32_t n_atoms = codes.n_atoms;
    begin_levels(n_atoms * n_atoms, scratch);
    return for_codes(codes, first, last, scratch, [&](const SumBlock& block) __attribute__((always_inline)) {
        for (int64_t i = 0; i < block.sums; i += kLanes) {
            const Ints start = load(scratch.starts + i);
            Floats squared{};
            for (int32_t one = 0; one < codes.k; ++one) {
                const int64_t own = one * scratch.stride + i;
                const Ints row = start + load(scratch.atoms + own) * n_atoms;
                const Floats weight = load(scratch.weights + own);
                Floats others{};
                for (int64_t at = own + scratch.stride; at < codes.k * scratch.stride; at += scratch.stride)
                    others += load(scratch.weights + at) * gather(grams, row + load(scratch.atoms + at));
                const Floats itself = weight * gather(grams, row + load(scratch.atoms + own));
                squared += weight * (itself + 2.0f * others);
            }
            store(scratch.sums + i, only(squared > 0.0f, 1.0f / sqrt(squared)));
        }
        copy(scratch.sums, block.sums, out + block.row * codes.levels);
    });
}

int32_t best(const GaussianCodes& codes, const ScoreTable& table, const float* inverse_norms, int64_t first, int64_t last,
             const SumScratch& scratch, float* out) {
    begin_levels(int32_t(codes.index_values()), scratch);
    return for_codes(codes, first, last, scratch, [&](const SumBlock& block) __attribute__((always_inline)) {
        copy(inverse_norms + block.row * codes.levels, block.sums, scratch.norms);
        for (int64_t i = 0; i < block.sums; i += kLanes) {
            Floats most = all(-__builtin_inff());
            for (int32_t c = 0; c < table.columns; ++c)
                most = larger(weighted(codes, scratch, table.values + c * column_size(codes), i), most);
            store(scratch.sums + i, most * load(scratch.norms + i));
        }
        copy(scratch.sums, block.sums, out + block.row * codes.levels);
    });
}

// out[level] of each row from values [rows, levels].
template <int kLevels>
SCOUP_INLINE void by_level(const float* __restrict values, int64_t rows, int32_t levels, float* __restrict out, int64_t stride) {
    const int32_t length = kLevels > 0 ? kLevels : levels;
    for (int64_t row = 0; row < rows; ++row)
        for (int32_t level = 0; level < length; ++level) out[level * stride + row] = values[row * length + level];
}

int32_t relevancy(const GaussianCodes& codes, const ScoreTable& table, const KnownCosines& known, int64_t n, int64_t first,
                  int64_t last, const SumScratch& scratch, float* out) {
    begin_levels(int32_t(codes.index_values()), scratch);
    return for_codes(codes, first, last, scratch, [&](const SumBlock& block) __attribute__((always_inline)) {
        copy(known.inverse_norms + block.row * codes.levels, block.sums, scratch.norms);
        copy(known.best + block.row * codes.levels, block.sums, scratch.best);
        for (int32_t c = 0; c < table.columns; ++c) {
            const float* column = table.values + c * column_size(codes);
            for (int64_t i = 0; i < block.sums; i += kLanes) {
                const Floats cosine = weighted(codes, scratch, column, i) * load(scratch.norms + i);
                store(scratch.sums + i, logistic(known.temperature * (cosine - load(scratch.best + i))));
            }
            float* to = out + c * codes.levels * n + block.row;
            if (codes.levels == 1) by_level<1>(scratch.sums, block.rows, 1, to, n);
            else if (codes.levels == 3) by_level<3>(scratch.sums, block.rows, 3, to, n);
            else by_level<0>(scratch.sums, block.rows, codes.levels, to, n);
        }
    });
}

// A lane for each column: no gather, and codes are read once for all of them.
int32_t relevancy_of_many(const GaussianCodes& codes, const ScoreTable& table, const KnownCosines& known, int64_t n,
                          int64_t first, int64_t last, const SumScratch& scratch, float* out) {
    constexpr int kParts = int(kMostLanes) / kLanes;
    begin_levels(int32_t(codes.index_values()), scratch);
    return for_codes(codes, first, last, scratch, [&](const SumBlock& block) __attribute__((always_inline)) {
        const float* norms = known.inverse_norms + block.row * codes.levels;
        const float* best = known.best + block.row * codes.levels;
        float found[kSumRows][kMostLanes];
        for (int32_t level = 0; level < codes.levels; ++level) {
            for (int64_t row = 0; row < block.rows; ++row) {
                const int64_t i = row * codes.levels + level;
                Floats sums[kParts] = {};
                for (int64_t at = i; at < codes.k * scratch.stride; at += scratch.stride) {
                    const float* scores = table.values + (int64_t(scratch.starts[i]) + scratch.atoms[at]) * kMostLanes;
                    for (int part = 0; part < kParts; ++part)
                        sums[part] += all(scratch.weights[at]) * load(scores + part * kLanes);
                }
                for (int part = 0; part < kParts; ++part)
                    store(found[row] + part * kLanes,
                          logistic(known.temperature * (sums[part] * all(norms[i]) - all(best[i]))));
            }
            for (int32_t c = 0; c < table.columns; ++c) {
                float* to = out + (c * codes.levels + level) * n + block.row;
                for (int64_t row = 0; row < block.rows; ++row) to[row] = found[row][c];
            }
        }
    });
}

}  // namespace

const CodeSumKernels code_sum_kernels = {scores, inverse_norms, best, relevancy, relevancy_of_many};

}  // namespace scoup::SCOUP_ISA
