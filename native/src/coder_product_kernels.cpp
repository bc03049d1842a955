// Products and sums over rows. Every number is summed in an order that depends on nothing but the shapes.
#include "coder_kernels.h"

#include <cstddef>

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr int kVectors = 2;  // of a panel
constexpr int kPanel = kVectors * kLanes;
constexpr int kTile = kLanes == 16 ? 12 : 6;  // rows whose sums fit into the registers, with their vectors of a panel
static_assert(kPad % kPanel == 0);

using Doubles = double __attribute__((vector_size(4 * kLanes)));
constexpr int kHalf = kLanes / 2;

void pack(const float* rows, int64_t count, int64_t depth, float* packed) {
    for (int64_t first = 0; first < count; first += kPanel, packed += depth * kPanel) {
        const int64_t filled = count - first < kPanel ? count - first : kPanel;
        for (int64_t d = 0; d < depth; ++d) {
            for (int64_t c = 0; c < filled; ++c) packed[d * kPanel + c] = rows[(first + c) * depth + d];
            for (int64_t c = filled; c < kPanel; ++c) packed[d * kPanel + c] = 0;
        }
    }
}

template <int kRows>
void tile(const float* rows, int64_t depth, const float* panel, float* out, int64_t stride) {
    Floats sums[kRows][kVectors] = {};
    for (int64_t d = 0; d < depth; ++d) {
        const Floats low = load(panel + d * kPanel), high = load(panel + d * kPanel + kLanes);
#pragma GCC unroll 12
        for (int r = 0; r < kRows; ++r) {
            const float x = rows[r * depth + d];
            sums[r][0] += x * low;
            sums[r][1] += x * high;
        }
    }
#pragma GCC unroll 12
    for (int r = 0; r < kRows; ++r) {
        store(out + r * stride, sums[r][0]);
        store(out + r * stride + kLanes, sums[r][1]);
    }
}

void multiply(const float* rows, int64_t count, int64_t depth, const float* packed, int64_t n_panels, float* out,
              int64_t stride) {
    for (int64_t p = 0; p < n_panels; ++p) {
        const float* panel = packed + p * depth * kPanel;
        float* to = out + p * kPanel;
        int64_t r = 0;
        for (; r + kTile <= count; r += kTile) tile<kTile>(rows + r * depth, depth, panel, to + r * stride, stride);
        for (; r + 4 <= count; r += 4) tile<4>(rows + r * depth, depth, panel, to + r * stride, stride);
        for (; r < count; ++r) tile<1>(rows + r * depth, depth, panel, to + r * stride, stride);
    }
}

template <int kOthers>
SCOUP_INLINE void dots_with(const float* row, int64_t depth, const float* others, float* out) {
    Floats sums[kOthers] = {};
    int64_t d = 0;
    for (; d + kLanes <= depth; d += kLanes) {
        const Floats x = load(row + d);
#pragma GCC unroll 4
        for (int c = 0; c < kOthers; ++c) sums[c] += x * load(others + c * depth + d);
    }
    for (int c = 0; c < kOthers; ++c) {
        float total = sum(sums[c]);
        for (int64_t rest = d; rest < depth; ++rest) total += row[rest] * others[c * depth + rest];
        out[c] = total;
    }
}

void dots(const float* rows, int64_t count, int64_t depth, const float* others, int64_t n_others, float* out) {
    for (int64_t r = 0; r < count; ++r, rows += depth, out += n_others) {
        int64_t c = 0;
        for (; c + 4 <= n_others; c += 4) dots_with<4>(rows, depth, others + c * depth, out + c);
        for (; c < n_others; ++c) dots_with<1>(rows, depth, others + c * depth, out + c);
    }
}

void pull(const float* rows, int64_t count, int64_t depth, int64_t first, int64_t width, const int32_t* support,
          const float* weights, int slots, const float* scale, float* sums) {
    for (int64_t r = 0; r < count; ++r) {
        const float* row = rows + r * depth + first;
        for (int k = 0; k < slots; ++k) {
            const int32_t atom = support[r * slots + k];
            if (atom < 0) continue;
            const float weight = scale[r] * weights[r * slots + k];
            float* to = sums + atom * width;
            int64_t d = 0;
            for (; d + kLanes <= width; d += kLanes) store(to + d, load(to + d) + weight * load(row + d));
            // The same arithmetic for the last few, so that they come out alike however the columns are cut.
            if (d < width) {
                Floats x = {}, y = {};
                __builtin_memcpy(&x, to + d, std::size_t(width - d) * sizeof(float));
                __builtin_memcpy(&y, row + d, std::size_t(width - d) * sizeof(float));
                x = x + weight * y;
                __builtin_memcpy(to + d, &x, std::size_t(width - d) * sizeof(float));
            }
        }
    }
}

double dot(const double* a, const double* b, int64_t count) {
    Doubles sums[4] = {};
    int64_t i = 0;
    for (; i + 4 * kHalf <= count; i += 4 * kHalf) {
        for (int part = 0; part < 4; ++part) {
            Doubles x, y;
            __builtin_memcpy(&x, a + i + part * kHalf, sizeof x);
            __builtin_memcpy(&y, b + i + part * kHalf, sizeof y);
            sums[part] += x * y;
        }
    }
    const Doubles together = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    double total = 0;
    for (int lane = 0; lane < kHalf; ++lane) total += together[lane];
    for (; i < count; ++i) total += a[i] * b[i];
    return total;
}

bool factor(double* matrix, int64_t size) {
    for (int64_t i = 0; i < size; ++i) {
        double* row = matrix + i * size;
        for (int64_t j = 0; j < i; ++j) row[j] = (row[j] - dot(row, matrix + j * size, j)) / matrix[j * size + j];
        const double rest = row[i] - dot(row, row, i);
        if (!(rest > 0)) return false;
        row[i] = __builtin_sqrt(rest);
    }
    return true;
}

// to -= x from
SCOUP_INLINE void subtract(double* __restrict to, double x, const double* __restrict from, int64_t width) {
    for (int64_t c = 0; c < width; ++c) to[c] -= x * from[c];
}

SCOUP_INLINE void divide(double* to, double x, int64_t width) {
    for (int64_t c = 0; c < width; ++c) to[c] /= x;
}

void substitute(const double* factor, int64_t size, double* right, int64_t stride, int64_t width) {
    for (int64_t i = 0; i < size; ++i) {
        double* row = right + i * stride;
        for (int64_t j = 0; j < i; ++j) subtract(row, factor[i * size + j], right + j * stride, width);
        divide(row, factor[i * size + i], width);
    }
    for (int64_t i = size - 1; i >= 0; --i) {
        double* row = right + i * stride;
        for (int64_t j = i + 1; j < size; ++j) subtract(row, factor[j * size + i], right + j * stride, width);
        divide(row, factor[i * size + i], width);
    }
}

}  // namespace

extern const ProductKernels coder_product_kernels = {kPanel, pack, multiply, dots, pull, factor, substitute};

}  // namespace scoup::SCOUP_ISA
