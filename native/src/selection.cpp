#include "selection.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "buffer.h"

namespace scoup {
namespace {

constexpr int64_t kPart = 16384;  // values of a chunk

const SelectionKernels& kernels() {
    return pick(baseline::selection_kernels, v3::selection_kernels, v4::selection_kernels);
}

int64_t parts_of(const ValueRows& rows) { return (rows.length + kPart - 1) / kPart; }

// The values of a chunk: parts of the first row, then of the next.
SomeValues part_of(const ValueRows& rows, int64_t chunk) {
    const int64_t row = chunk / parts_of(rows), first = chunk % parts_of(rows) * kPart, at = row * rows.length + first;
    return {rows.values + at, rows.included == nullptr ? nullptr : rows.included + at, std::min(kPart, rows.length - first)};
}

}  // namespace

void count_stretched(const ValueRows& rows, float share, float* spans, int64_t* bins, int n_threads, const Interrupted& interrupted) {
    const int64_t parts = parts_of(rows), chunks = rows.count * parts;
    n_threads = workers(chunks, n_threads);
    std::vector<ValueSpan> found(static_cast<size_t>(chunks));
    for_chunks(chunks, n_threads, interrupted,
               [&](int64_t chunk, int) { found[size_t(chunk)] = kernels().span(part_of(rows, chunk)); });
    std::fill_n(bins, rows.count * kBins, int64_t(0));
    std::vector<float> least(size_t(rows.count), std::numeric_limits<float>::quiet_NaN());  // nothing is as large
    for (int64_t row = 0; row < rows.count; ++row) {
        float& low = spans[2 * row] = std::numeric_limits<float>::infinity();
        float& high = spans[2 * row + 1] = -std::numeric_limits<float>::infinity();
        bool is_odd = false;
        for (int64_t part = 0; part < parts; ++part) {
            const ValueSpan& own = found[size_t(row * parts + part)];
            low = std::min(low, own.low), high = std::max(high, own.high), is_odd |= own.is_odd;
        }
        if (is_odd) low = high = std::numeric_limits<float>::quiet_NaN();
        if (std::isfinite(low) && std::isfinite(high)) least[size_t(row)] = low + (high - low) * share - 1e-6f;
    }
    std::vector<int64_t> counts(size_t(chunks) * kBins, 0);
    Buffer<float> scratch(n_threads * (kPart + kMostSelectionLanes));
    for_chunks(chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t row = chunk / parts;
        if (std::isnan(least[size_t(row)])) return;
        kernels().count(part_of(rows, chunk), spans[2 * row], spans[2 * row + 1], least[size_t(row)],
                        &counts[size_t(chunk) * kBins], scratch.data() + worker * (kPart + kMostSelectionLanes));
    });
    for (int64_t chunk = 0; chunk < chunks; ++chunk)
        for (int64_t bin = 0; bin < kBins; ++bin) bins[chunk / parts * kBins + bin] += counts[size_t(chunk * kBins + bin)];
}

void above_thresholds(const ValueRows& rows, const float* spans, const float* thresholds, uint8_t* masks, SumAbove* found,
                      int n_threads, const Interrupted& interrupted) {
    const int64_t parts = parts_of(rows), chunks = rows.count * parts;
    std::vector<SumAbove> sums(static_cast<size_t>(chunks));
    std::vector<float> least(size_t(rows.count), std::numeric_limits<float>::infinity());
    for (int64_t row = 0; row < rows.count; ++row)
        if (std::isfinite(spans[2 * row]) && std::isfinite(spans[2 * row + 1]))
            least[size_t(row)] = kernels().first_above(spans[2 * row], spans[2 * row + 1], thresholds[row]);
        else
            least[size_t(row)] = std::numeric_limits<float>::quiet_NaN();
    for_chunks(chunks, n_threads, interrupted, [&](int64_t chunk, int) {
        const int64_t row = chunk / parts, first = chunk % parts * kPart;
        sums[size_t(chunk)] = kernels().above(part_of(rows, chunk), least[size_t(row)], masks + row * rows.length + first);
    });
    for (int64_t row = 0; row < rows.count; ++row) {
        found[row] = {0, 0};
        for (int64_t part = 0; part < parts; ++part) {
            const SumAbove& own = sums[size_t(row * parts + part)];
            found[row].count += own.count, found[row].sum += own.sum;
        }
    }
}

}  // namespace scoup
