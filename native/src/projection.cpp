#include "projection.h"

#include <algorithm>
#include <vector>

#include "binning.h"

namespace scoup {
namespace {

constexpr int64_t kBlocksAtOnce = 1024;
constexpr int64_t kStride = kBlocksAtOnce * kBlockRows + 1;  // slots of a chunk; the kernel wants one as scratch

}  // namespace

Buffer<SceneBlock> blocks_of(const Scene& scene, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::scene_kernels, v3::scene_kernels, v4::scene_kernels);
    Buffer<SceneBlock> blocks(scene.n_blocks());
    const int64_t n_chunks = (blocks.size() + kBlocksAtOnce - 1) / kBlocksAtOnce;
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int) {
        const int64_t first = chunk * kBlocksAtOnce;
        kernels.make_blocks(scene, first, std::min(first + kBlocksAtOnce, blocks.size()), blocks.data() + first);
    });
    return blocks;
}

Projection project(const Scene& scene, const Camera& camera, const Preset& preset, int n_threads, const Interrupted& interrupted) {
    Projection projection{camera.width, camera.height, (camera.width + kTile - 1) / kTile, (camera.height + kTile - 1) / kTile,
              preset, scene.count, 0, {}, {}, {}};
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    const int64_t n_chunks = (scene.n_blocks() + kBlocksAtOnce - 1) / kBlocksAtOnce;
    projection.projected = Buffer<Projected>(n_chunks * kStride);  // slots of chunk c begin at c * kStride
    Buffer<float> depths(n_chunks * kStride);
    Binning binning(projection.tiles_x, projection.tiles_y, n_chunks, kStride, n_threads);
    std::vector<int64_t> n_found(size_t(n_chunks), 0);
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = chunk * kBlocksAtOnce, last = std::min(first + kBlocksAtOnce, scene.n_blocks());
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
