#include "wide_codes.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace scoup {
namespace {

constexpr int64_t kRowsOfChunk = 16;

// weights start at zero; residual starts as the similarities and ends as s - G w.
void descend(const float* gram, int64_t n_atoms, const Descent& descent, float* __restrict residual, float* weights) {
    for (int32_t sweep = 0; sweep < descent.sweeps; ++sweep) {
        float furthest = 0;
        for (int64_t atom = 0; atom < n_atoms; ++atom) {
            const float* __restrict products = gram + atom * n_atoms;
            const float norm = products[atom];
            if (!(norm > 0)) continue;
            const float wanted = weights[atom] + residual[atom] / norm;
            const float better = wanted > 0 ? wanted : 0;
            const float step = better - weights[atom];
            if (step == 0) continue;
            weights[atom] = better;
            for (int64_t other = 0; other < n_atoms; ++other) residual[other] -= step * products[other];
            furthest = std::max(furthest, std::fabs(step));
        }
        if (!(furthest > descent.tolerance)) return;
    }
}

}  // namespace

void wide_weights(Matrix similarities, const float* gram, const Descent& descent, float* out, int n_threads,
                  const Interrupted& interrupted) {
    const int64_t rows = similarities.rows, n_atoms = similarities.columns;
    const int64_t n_chunks = (rows + kRowsOfChunk - 1) / kRowsOfChunk;
    const int threads = int(std::max<int64_t>(1, std::min<int64_t>(n_threads, n_chunks)));
    std::vector<std::vector<float>> memory;
    for (int worker = 0; worker < threads; ++worker) memory.emplace_back(static_cast<size_t>(n_atoms));
    for_chunks(n_chunks, threads, interrupted, [&](int64_t chunk, int worker) {
        float* residual = memory[size_t(worker)].data();
        const int64_t end = std::min(rows, (chunk + 1) * kRowsOfChunk);
        for (int64_t row = chunk * kRowsOfChunk; row < end; ++row) {
            const float* own = similarities.data + row * n_atoms;
            std::copy_n(own, n_atoms, residual);
            float* weights = out + row * n_atoms;
            std::fill_n(weights, n_atoms, 0.0f);
            descend(gram, n_atoms, descent, residual, weights);
        }
    });
}

}  // namespace scoup
