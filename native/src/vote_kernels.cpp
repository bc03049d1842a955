#include "vote_kernels.h"

#include <cstddef>

#include "half.h"
#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

// No Gaussian loses its code for being odd.
constexpr float kLeastAgreement = 1e-6f;
constexpr float kLog2E = 1.4426950408889634f;
constexpr int64_t kAhead = 6;  // entries whose codes are fetched before they are needed

SCOUP_INLINE void fetch(const VoteEntry* entries, int64_t i, int64_t count, const CombinationCodes& codes) {
    if (i + kAhead >= count) return;
    const Share* share = codes.shares + int64_t(entries[i + kAhead].combination) * codes.k_of_all;
    __builtin_prefetch(share);
    __builtin_prefetch(share + 8);
}

// Entries of a region's code: K where all levels have so many, which unrolls the loops; 0 where they differ.
template <int K>
SCOUP_INLINE int32_t k_of(const CombinationCodes& codes, int32_t level) {
    return K > 0 ? K : codes.k[level];
}

template <int K>
void add_codes(const VoteEntry* entries, int64_t count, const CombinationCodes& codes, float* sums) {
    for (int64_t i = 0; i < count; ++i) {
        fetch(entries, i, count, codes);
        const Share* share = codes.shares + int64_t(entries[i].combination) * codes.k_of_all;
        const float weight = entries[i].weight;
        for (int32_t level = 0; level < codes.levels; ++level)
            for (int32_t j = 0; j < k_of<K>(codes, level); ++j, ++share) sums[share->place] += weight * share->weight;
    }
}

SCOUP_INLINE float cosine_of(const Share* shares, int32_t k, const float* products, float inverse_norm) {
    float product = 0;
    for (int32_t j = 0; j < k; ++j) product += shares[j].weight * products[shares[j].place];
    return product * inverse_norm;
}

template <int K>
void add_reweighted_codes(const VoteEntry* entries, int64_t count, const CombinationCodes& codes,
                          const EarlierGaussian& earlier, float* factors, float* sums) {
    const int32_t levels = codes.levels;
    const int64_t stride = (count + kLanes - 1) / kLanes * kLanes;  // from level to level
    for (int64_t i = 0; i < count; ++i) {
        fetch(entries, i, count, codes);
        if (i + kAhead < count)
            __builtin_prefetch(codes.inverse_norms + int64_t(entries[i + kAhead].combination) * levels);
        const Share* share = codes.shares + int64_t(entries[i].combination) * codes.k_of_all;
        const float* inverse_norms = codes.inverse_norms + int64_t(entries[i].combination) * levels;
        for (int32_t level = 0; level < levels; ++level) {
            factors[level * stride + i] = cosine_of(share, k_of<K>(codes, level), earlier.products, inverse_norms[level]);
            share += k_of<K>(codes, level);
        }
    }
    // Without branches: many cosines are 1, more or less.
    for (int32_t level = 0; level < levels; ++level) {
        const Floats sharpness = all(earlier.is_coded[level] ? earlier.sharpness[level] : 0.0f);
        for (float *factor = factors + level * stride, *end = factor + stride; factor < end; factor += kLanes) {
            const Floats below = sharpness * (smaller(load(factor), all(1.0f)) - all(1.0f));
            const Floats power = larger(below * kLog2E, all(-126.0f));
            store(factor, larger(exp2(power), all(kLeastAgreement)));
        }
    }
    for (int64_t i = 0; i < count; ++i) {
        const Share* share = codes.shares + int64_t(entries[i].combination) * codes.k_of_all;
        for (int32_t level = 0; level < levels; ++level) {
            const float weight = entries[i].weight * factors[level * stride + i];
            for (int32_t j = 0; j < k_of<K>(codes, level); ++j, ++share) sums[share->place] += weight * share->weight;
        }
    }
}

constexpr int32_t kUsual = 4;  // entries of a code; 1 where regions vote for things

bool all_have(int32_t k, const CombinationCodes& codes) {
    for (int32_t level = 0; level < codes.levels; ++level)
        if (codes.k[level] != k) return false;
    return true;
}

void add(const VoteEntry* entries, int64_t count, const CombinationCodes& codes, float* sums) {
    if (all_have(kUsual, codes))
        add_codes<kUsual>(entries, count, codes, sums);
    else if (all_have(1, codes))
        add_codes<1>(entries, count, codes, sums);
    else
        add_codes<0>(entries, count, codes, sums);
}

void add_reweighted(const VoteEntry* entries, int64_t count, const CombinationCodes& codes, const EarlierGaussian& earlier,
                    float* factors, float* sums) {
    if (all_have(kUsual, codes))
        add_reweighted_codes<kUsual>(entries, count, codes, earlier, factors, sums);
    else
        add_reweighted_codes<0>(entries, count, codes, earlier, factors, sums);
}

int64_t deviations(const VoteEntry* entries, int64_t count, const CombinationCodes& codes, const EarlierGaussian& earlier,
                   int32_t level, float* out) {
    int64_t written = 0, first_share = 0;
    for (int32_t before = 0; before < level; ++before) first_share += codes.k[before];
    const auto region_of = [&](int64_t i) { return codes.regions[int64_t(entries[i].combination) * codes.levels + level]; };
    for (int64_t i = 0; i < count; ++i) {
        bool known = region_of(i) < 0;  // or met already in another combination
        for (int64_t other = i; other > 0 && !known; --other) known = region_of(other - 1) == region_of(i);
        if (known) continue;
        const int64_t combination = entries[i].combination;
        const Share* share = codes.shares + combination * codes.k_of_all + first_share;
        const float inverse_norm = codes.inverse_norms[combination * codes.levels + level];
        const float cosine = cosine_of(share, codes.k[level], earlier.products, inverse_norm);
        out[written++] = earlier.is_coded[level] ? 1.0f - cosine : 0.0f;
    }
    return written;
}

void combine_rows(const float* const* rows, const float* weights, int32_t k, int64_t n, float* out) {
    for (int64_t i = 0; i < n; ++i) out[i] = 0;
    for (int32_t j = 0; j < k; ++j)
        for (int64_t i = 0; i < n; ++i) out[i] += weights[j] * rows[j][i];
}

// By insertion: the time goes with what is inserted.
int32_t largest_of_many(const float* values, int32_t n, int32_t k, float* found, int32_t* atoms) {
    int32_t count = 0;
    float least = 0;  // what a value must exceed
    for (int32_t atom = 0; atom < n; ++atom) {
        const float value = values[atom];
        if (!(value > least)) continue;
        int32_t at = count < k ? count++ : k - 1;
        for (; at > 0 && found[at - 1] < value; --at) {
            found[at] = found[at - 1];
            atoms[at] = atoms[at - 1];
        }
        found[at] = value;
        atoms[at] = atom;
        if (count == k) least = found[k - 1];
    }
    return count;
}

constexpr int32_t kFewAtoms = 512, kFewKept = 8;

SCOUP_INLINE float largest_lane(Floats x) {
    using Four = float __attribute__((vector_size(16)));
    Four parts[kLanes / 4];
    __builtin_memcpy(parts, &x, sizeof x);
    for (int step = kLanes / 8; step > 0; step /= 2)
        for (int i = 0; i < step; ++i) parts[i] = parts[i] > parts[i + step] ? parts[i] : parts[i + step];
    const float one = parts[0][0] > parts[0][2] ? parts[0][0] : parts[0][2];
    const float other = parts[0][1] > parts[0][3] ? parts[0][1] : parts[0][3];
    return one > other ? one : other;
}

// One after the other is looked for among what is left: no branch depends on the values.
int32_t largest(const float* values, int32_t n, int32_t k, float* found, int32_t* atoms) {
    if (n > kFewAtoms || k > kFewKept) return largest_of_many(values, n, k, found, atoms);
    Ints lanes;
    for (int lane = 0; lane < kLanes; ++lane) lanes[lane] = lane;
    Floats left[kFewAtoms / kLanes];
    const int blocks = (n + kLanes - 1) / kLanes;
    left[blocks - 1] = Floats{};
    __builtin_memcpy(left, values, size_t(n) * sizeof(float));
    for (int b = 0; b < blocks; ++b) left[b] = only(left[b] > 0.0f, left[b]);  // nor what is not a number
    for (int32_t count = 0; count < k; ++count) {
        Floats most = left[0];
        for (int b = 1; b < blocks; ++b) most = larger(left[b], most);
        const float value = largest_lane(most);
        if (!(value > 0)) return count;
        int b = 0;
        uint32_t here = 0;
        for (; (here = bits(left[b] == value)) == 0;) ++b;
        const int lane = __builtin_ctz(here);
        left[b] = only(lanes != lane, left[b]);  // a single lane stored would stall the next load
        found[count] = value;
        atoms[count] = b * kLanes + lane;
    }
    return k;
}

void widen(const uint16_t* halves, int64_t count, float* out) {
    constexpr int64_t kAtOnce = 1 << 20;
    for (int64_t first = 0; first < count; first += kAtOnce)
        from_stored(halves + first, int(count - first < kAtOnce ? count - first : kAtOnce), out + first);
}

}  // namespace

const VoteKernels vote_kernels = {add, add_reweighted, deviations, combine_rows, largest, widen};

}  // namespace scoup::SCOUP_ISA
