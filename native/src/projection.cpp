#include "projection.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "binning.h"

namespace scoup {
namespace {

constexpr int64_t kRows = kChunkBlocks * kBlockRows;  // of a chunk
constexpr int64_t kStride = kRows + 1;  // slots of a chunk; the kernel wants one as scratch

}  // namespace

Buffer<SceneBlock> blocks_of(const Scene& scene, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::scene_kernels, v3::scene_kernels, v4::scene_kernels);
    Buffer<SceneBlock> blocks(scene.n_blocks());
    for_chunks(scene.n_chunks(), n_threads, interrupted, [&](int64_t chunk, int) {
        const int64_t first = chunk * kChunkBlocks;
        kernels.make_blocks(scene, first, std::min(first + kChunkBlocks, blocks.size()), blocks.data() + first);
    });
    return blocks;
}

Buffer<ChunkBounds> bounds_of(const Scene& scene, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::scene_kernels, v3::scene_kernels, v4::scene_kernels);
    constexpr float kInfinite = std::numeric_limits<float>::infinity();
    Buffer<ChunkBounds> bounds(scene.n_chunks());
    for_chunks(bounds.size(), n_threads, interrupted, [&](int64_t chunk, int) {
        ChunkBounds found{{kInfinite, kInfinite, kInfinite}, {-kInfinite, -kInfinite, -kInfinite}, -1};
        const int64_t last = std::min((chunk + 1) * kChunkBlocks, scene.n_blocks());
        for (int64_t at = chunk * kChunkBlocks; at < last; ++at) {
            SceneBlock made;
            if (scene.blocks == nullptr) kernels.make_blocks(scene, at, at + 1, &made);
            const SceneBlock& block = scene.blocks == nullptr ? made : scene.blocks[at];
            for (int i = 0; i < kBlockRows; ++i) {
                if (!(block.extent[i] >= 0)) continue;  // never drawn
                found.extent = std::max(found.extent, block.extent[i]);
                for (int c = 0; c < 3; ++c) {
                    found.low[c] = std::min(found.low[c], block.mean[c][i]);
                    found.high[c] = std::max(found.high[c], block.mean[c][i]);
                }
            }
        }
        bounds[chunk] = found;
    });
    return bounds;
}

Projection project(const Scene& scene, const Camera& camera, const Preset& preset, int n_threads, const Interrupted& interrupted) {
    Projection projection{camera.width, camera.height, (camera.width + kTile - 1) / kTile, (camera.height + kTile - 1) / kTile,
              preset, scene.count, 0, 0, {}, {}, {}};
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    std::vector<int64_t> seen;  // chunks
    for (int64_t chunk = 0; chunk < scene.n_chunks(); ++chunk)
        if (scene.bounds == nullptr || kernels.may_see(scene.bounds[chunk], camera, preset)) seen.push_back(chunk);
    const auto n_chunks = int64_t(seen.size());
    for (const int64_t chunk : seen) projection.n_looked_at += std::min((chunk + 1) * kRows, scene.count) - chunk * kRows;
    projection.projected = Buffer<Projected>(n_chunks * kStride);  // slots of the c-th chunk seen begin at c * kStride
    Buffer<float> depths(n_chunks * kStride);
    Binning binning(projection.tiles_x, projection.tiles_y, n_chunks, kStride, n_threads);
    std::vector<int64_t> n_found(size_t(n_chunks), 0);
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = seen[size_t(chunk)] * kChunkBlocks, last = std::min(first + kChunkBlocks, scene.n_blocks());
        Projected* projected = projection.projected.data() + chunk * kStride;
        const int64_t found = kernels.project(scene, camera, preset, first, last, projected, binning.rects(chunk),
                                              depths.data() + chunk * kStride);
        binning.count(chunk, worker, projected, found);
        n_found[size_t(chunk)] = found;
    });
    for (const int64_t found : n_found) projection.n_visible += found;
    projection.starts = binning.starts();
    projection.lists = binning.lists(projection.starts, n_found, depths.data(), projection.projected.data(), scene.ties, n_threads, interrupted);
    return projection;
}

}  // namespace scoup
