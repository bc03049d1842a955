#include "depth_sort.h"

#include <algorithm>
#include <vector>

namespace scoup {
namespace {

constexpr int kDigitBits = 11;
constexpr int64_t kDigits = 1 << kDigitBits;

// One stable pass of a radix sort over the digit at `shift`; parts are counted and moved side by side.
void radix_pass(const Buffer<DepthKey>& from, Buffer<DepthKey>& to, uint64_t lowest, int shift, int64_t n_parts,
                int n_threads, const Interrupted& interrupted) {
    const int64_t n = from.size();
    std::vector<int64_t> places(size_t(n_parts * kDigits), 0);
    const auto digit = [&](DepthKey key) { return int64_t((key - lowest) >> shift) & (kDigits - 1); };
    for_chunks(n_parts, n_threads, interrupted, [&](int64_t part, int) {
        int64_t* count = &places[size_t(part * kDigits)];
        for (int64_t i = n * part / n_parts; i < n * (part + 1) / n_parts; ++i) ++count[digit(from[i])];
    });
    int64_t place = 0;
    for (int64_t d = 0; d < kDigits; ++d)
        for (int64_t part = 0; part < n_parts; ++part) {
            int64_t& here = places[size_t(part * kDigits + d)];
            place += std::exchange(here, place);
        }
    for_chunks(n_parts, n_threads, interrupted, [&](int64_t part, int) {
        int64_t* next = &places[size_t(part * kDigits)];
        for (int64_t i = n * part / n_parts; i < n * (part + 1) / n_parts; ++i) to[next[digit(from[i])]++] = from[i];
    });
}

// Puts the keys of each run that agrees in the sorted digits in order. Depths that are equal as floats may differ as
// doubles.
void order_runs(Buffer<DepthKey>& keys, uint64_t lowest, int shift, const Projected* projected, const int64_t* ties,
                int64_t n_parts, int n_threads, const Interrupted& interrupted) {
    const auto before = [projected, ties](DepthKey a, DepthKey b) {
        if (a >> 32 != b >> 32) return a < b;
        const Projected &pa = projected[slot_of(a)], &pb = projected[slot_of(b)];
        if (pa.depth != pb.depth) return pa.depth < pb.depth;
        return ties != nullptr ? ties[pa.id] < ties[pb.id] : pa.id < pb.id;
    };
    const int64_t n = keys.size();
    const auto same_run = [&](int64_t a, int64_t b) { return (keys[a] - lowest) >> shift == (keys[b] - lowest) >> shift; };
    std::vector<int64_t> edges(size_t(n_parts + 1), n);  // between runs
    for (int64_t part = 0; part < n_parts; ++part) {
        int64_t& edge = edges[size_t(part)];
        edge = n * part / n_parts;
        while (edge > 0 && edge < n && same_run(edge - 1, edge)) ++edge;
    }
    for_chunks(n_parts, n_threads, interrupted, [&](int64_t part, int) {
        const int64_t last = edges[size_t(part + 1)];
        for (int64_t first = edges[size_t(part)]; first < last;) {
            int64_t end = first + 1;
            while (end < last && same_run(first, end)) ++end;
            if (end - first > 1) std::sort(keys.data() + first, keys.data() + end, before);
            first = end;
        }
    });
}

}  // namespace

void sort_by_depth(Buffer<DepthKey>& keys, const Projected* projected, const int64_t* ties, int n_threads,
                   const Interrupted& interrupted) {
    if (keys.size() < 2) return;
    const auto [low, high] = std::minmax_element(keys.begin(), keys.end());
    const uint64_t lowest = *low >> 32 << 32, span = (*high - lowest) >> 32;
    const int64_t n_parts = std::clamp<int64_t>(keys.size() / 16384, 1, n_threads);
    // Two passes order all but the last few bits of the depths; what is left are short runs.
    int bits = 0;
    while (bits < 32 && span >> bits != 0) ++bits;
    const int shift = 32 + std::max(0, bits - 2 * kDigitBits);
    Buffer<DepthKey> other(keys.size());
    for (int pass = 0; pass < 2; ++pass) {
        radix_pass(keys, other, lowest, shift + pass * kDigitBits, n_parts, n_threads, interrupted);
        std::swap(keys, other);
    }
    order_runs(keys, lowest, shift, projected, ties, n_parts, n_threads, interrupted);
}

}  // namespace scoup
