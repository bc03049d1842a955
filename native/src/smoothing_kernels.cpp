#include "smoothing_kernels.h"

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

// Running sums of four rows side by side, each in the order of its pixels.
void sum_rows(const float* const rows[kRowsAtOnce], const BoxAxis& axis, double* out) {
    const int64_t length = int64_t(axis.size) + axis.kernel;
    double* const out0 = out;
    double* const out1 = out + length;
    double* const out2 = out + 2 * length;
    double* const out3 = out + 3 * length;
    int64_t i = 0;
    for (; i < axis.zeros; ++i) out0[i] = out1[i] = out2[i] = out3[i] = 0;
    double sum0 = 0, sum1 = 0, sum2 = 0, sum3 = 0;
    for (int32_t value = 0; value < axis.n_values; ++value, ++i) {
        const int32_t x = axis.source[value];
        out0[i] = sum0 += double(rows[0][x]);
        out1[i] = sum1 += double(rows[1][x]);
        out2[i] = sum2 += double(rows[2][x]);
        out3[i] = sum3 += double(rows[3][x]);
    }
    for (; i < length; ++i) out0[i] = sum0, out1[i] = sum1, out2[i] = sum2, out3[i] = sum3;
}

// Adds a row's means to the running sums down the columns; writes a row of box means where one is complete.
void add_row(const double* __restrict first, const double* __restrict last, const double* __restrict count, int32_t width,
             const double* __restrict above, double* __restrict here) {
    for (int32_t x = 0; x < width; ++x) here[x] = above[x] + (last[x] - first[x]) / count[x];
}
void add_row(const double* __restrict first, const double* __restrict last, const double* __restrict count, int32_t width,
             const double* __restrict above, double* __restrict here, const double* __restrict before, double rows,
             float* __restrict out) {
    for (int32_t x = 0; x < width; ++x) {
        const double sum = above[x] + (last[x] - first[x]) / count[x];
        here[x] = sum;
        out[x] = float((sum - before[x]) / rows);
    }
}

void box_mean(const float* map, const BoxAxis& across, const BoxAxis& along, const BoxScratch& scratch, float* out) {
    const int64_t width = across.size, kernel = along.kernel, kept = kernel + 1, length = width + across.kernel;
    const int64_t padded = int64_t(along.size) + kernel;
    for (int64_t first = 0; first < padded; first += kRowsAtOnce) {
        const float* rows[kRowsAtOnce];
        for (int64_t r = 0; r < kRowsAtOnce; ++r) {
            const int64_t value = first + r - along.zeros;
            rows[r] = value >= 0 && value < along.n_values ? map + along.source[value] * width : scratch.nothing;
        }
        sum_rows(rows, across, scratch.sums);
        for (int64_t i = first; i < first + kRowsAtOnce && i < padded; ++i) {
            const double* sums = scratch.sums + (i - first) * length;
            double* here = scratch.down + i % kept * width;
            const double* above = i > 0 ? scratch.down + (i - 1) % kept * width : nullptr;
            if (i == 0)  // the padding begins with a row of zeros
                for (int64_t x = 0; x < width; ++x) here[x] = 0;
            else if (i < kernel)
                add_row(sums, sums + across.kernel, across.count, int32_t(width), above, here);
            else
                add_row(sums, sums + across.kernel, across.count, int32_t(width), above, here,
                        scratch.down + (i - kernel) % kept * width, along.count[i - kernel], out + (i - kernel) * width);
        }
    }
}

// Writes the mean of relevancy and its box mean. The smallest and the largest; both not a number if any pixel is not.
void smooth(const float* relevancy, const float* averaged, int64_t pixels, float* smoothed, float& low, float& high) {
    const float infinity = __builtin_inff();
    Floats lows = all(infinity), highs = all(-infinity);
    Ints odd{};
    int64_t i = 0;
    for (; i + kLanes <= pixels; i += kLanes) {
        const Floats value = 0.5f * (load(relevancy + i) + load(averaged + i));
        store(smoothed + i, value);
        lows = smaller(value, lows);
        highs = larger(value, highs);
        odd |= value != value;
    }
    low = infinity, high = -infinity;
    bool is_odd = any(odd);
    for (int lane = 0; lane < kLanes; ++lane) {
        low = lows[lane] < low ? lows[lane] : low;
        high = highs[lane] > high ? highs[lane] : high;
    }
    for (; i < pixels; ++i) {
        const float value = smoothed[i] = 0.5f * (relevancy[i] + averaged[i]);
        low = value < low ? value : low;
        high = value > high ? value : high;
        is_odd |= value != value;
    }
    if (is_odd) low = high = __builtin_nanf("");
}

// Which pixels are above the threshold once stretched to 0..1 with the lower half cut off. In double precision, in which
// 1e-9 does not vanish beside the range.
void find_above(const float* __restrict smoothed, int64_t pixels, double low, double high, float threshold,
                uint8_t* __restrict above) {
    const double range = high - low + 1e-9;
    for (int64_t i = 0; i < pixels; ++i) {
        const double stretched = 2 * ((double(smoothed[i]) - low) / range) - 1;
        const double cut = stretched < 0 ? 0 : stretched > 1 ? 1 : stretched;
        above[i] = float(cut) > threshold;
    }
}

void add_counts(int32_t* __restrict counts, const uint8_t* __restrict row, int32_t width) {
    for (int32_t x = 0; x < width; ++x) counts[x] += row[x];
}
void take_counts(int32_t* __restrict counts, const uint8_t* __restrict row, int32_t width) {
    for (int32_t x = 0; x < width; ++x) counts[x] -= row[x];
}

// Whether more than half of the pixels of the box that lie in the image are above.
void majority(const MaskScratch& scratch, int32_t width, int32_t height, int32_t side, uint8_t* mask) {
    const int32_t before = side / 2, after = side - 1 - before;
    int32_t* __restrict sums = scratch.sums;
    for (int32_t x = 0; x < width; ++x) scratch.counts[x] = 0;
    for (int32_t y = 0; y < after && y < height; ++y) add_counts(scratch.counts, scratch.above + int64_t(y) * width, width);
    for (int32_t y = 0; y < height; ++y) {
        if (y + after < height) add_counts(scratch.counts, scratch.above + int64_t(y + after) * width, width);
        if (y - before - 1 >= 0) take_counts(scratch.counts, scratch.above + int64_t(y - before - 1) * width, width);
        const int32_t rows = smaller(height - 1, y + after) - (y > before ? y - before : 0) + 1;
        sums[0] = 0;
        for (int32_t x = 0; x < width; ++x) sums[x + 1] = sums[x] + scratch.counts[x];
        uint8_t* __restrict out = mask + int64_t(y) * width;
        const auto at = [&](int32_t x) {
            const int32_t first = x > before ? x - before : 0, last = smaller(width, x + after + 1);
            out[x] = 2 * (sums[last] - sums[first]) > rows * (last - first);
        };
        int32_t x = 0;
        for (; x < before && x < width; ++x) at(x);
        for (; x + after < width; ++x) out[x] = 2 * (sums[x + after + 1] - sums[x - before]) > rows * side;
        for (; x < width; ++x) at(x);
    }
}

void mask(const float* relevancy, const float* averaged, int32_t width, int32_t height, const MaskRule& rule,
          const MaskScratch& scratch, float* smoothed, uint8_t* mask) {
    const int64_t pixels = int64_t(width) * height;
    float low, high;
    smooth(relevancy, averaged, pixels, smoothed, low, high);
    find_above(smoothed, pixels, double(low), double(high), rule.threshold, scratch.above);
    majority(scratch, width, height, rule.smoothing, mask);
}

float peak_of(const float* values, int64_t count) {
    const float infinity = __builtin_inff();
    Floats highs = all(-infinity);
    Ints odd{};
    int64_t i = 0;
    for (; i + kLanes <= count; i += kLanes) {
        const Floats value = load(values + i);
        highs = larger(value, highs);
        odd |= value != value;
    }
    float high = -infinity;
    bool is_odd = any(odd);
    for (int lane = 0; lane < kLanes; ++lane) high = highs[lane] > high ? highs[lane] : high;
    for (; i < count; ++i) {
        high = values[i] > high ? values[i] : high;
        is_odd |= values[i] != values[i];
    }
    return is_odd ? __builtin_nanf("") : high;
}

LevelSums sums(const float* smoothed, const uint8_t* mask, int64_t pixels) {
    constexpr int kParts = 8;  // so many sums side by side, whatever the instruction set
    double parts[kParts] = {};
    int64_t area = 0;
    for (int64_t i = 0; i < pixels; ++i) area += mask[i];
    const int64_t whole = pixels / kParts * kParts;
    for (int64_t i = 0; i < whole; i += kParts) {
        uint64_t members;
        __builtin_memcpy(&members, mask + i, sizeof members);
        if (members == 0) continue;
        for (int part = 0; part < kParts; ++part) parts[part] += mask[i + part] ? double(smoothed[i + part]) : 0.0;
    }
    for (int64_t i = whole; i < pixels; ++i) parts[i % kParts] += mask[i] ? double(smoothed[i]) : 0.0;
    double sum = 0;
    for (const double part : parts) sum += part;
    return {peak_of(smoothed, pixels), area, sum};
}

}  // namespace

const SmoothingKernels smoothing_kernels = {box_mean, mask, sums};

}  // namespace scoup::SCOUP_ISA
