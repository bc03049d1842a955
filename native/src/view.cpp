#include "view.h"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "binning.h"
#include "depth_sort.h"

namespace scoup {
namespace {

constexpr int64_t kRowsAtOnce = 8192;
constexpr int64_t kStride = kRowsAtOnce + 1;  // slots of a chunk; the kernel wants one as scratch

// The projected scene before it is sorted: slots of chunk c begin at c * kStride.
struct Gathered {
    Buffer<Projected> projected;
    Buffer<TileRect> rects;
    Buffer<DepthKey> keys;          // of the visible ones, by rising slot
    std::vector<int64_t> per_tile;  // how many Gaussians reach each tile
};

Gathered gather(const Scene& scene, const Camera& camera, const Preset& preset, const View& view, int n_threads,
                const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    const int64_t n_chunks = (scene.count + kRowsAtOnce - 1) / kRowsAtOnce;
    Gathered all{Buffer<Projected>(n_chunks * kStride), Buffer<TileRect>(n_chunks * kStride), {}, {}};
    Buffer<float> depths(n_chunks * kStride);
    std::vector<int64_t> visible(size_t(n_chunks), 0);
    const size_t n_tiles = size_t(view.n_tiles());
    std::vector<std::vector<uint32_t>> counts(static_cast<size_t>(std::max(n_threads, 1)));
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t first = chunk * kRowsAtOnce, last = std::min(first + kRowsAtOnce, scene.count);
        const int64_t begin = chunk * kStride;
        const int64_t found = kernels.project(scene, camera, preset, first, last, all.projected.data() + begin,
                                              all.rects.data() + begin, depths.data() + begin);
        visible[size_t(chunk)] = found;
        auto& count = counts[size_t(worker)];
        count.resize(n_tiles);
        for (int64_t slot = begin; slot < begin + found; ++slot)
            visit_tiles(all.projected[slot], all.rects[slot], [&](int row, int x0, int x1) {
                for (int x = x0; x < x1; ++x) ++count[size_t(row) * size_t(view.tiles_x) + size_t(x)];
            });
    });

    all.per_tile.assign(n_tiles, 0);
    for (const auto& count : counts)
        for (size_t tile = 0; tile < count.size(); ++tile) all.per_tile[tile] += count[tile];
    std::vector<int64_t> places(size_t(n_chunks + 1), 0);
    for (int64_t chunk = 0; chunk < n_chunks; ++chunk) places[size_t(chunk + 1)] = places[size_t(chunk)] + visible[size_t(chunk)];
    all.keys = Buffer<DepthKey>(places.back());
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int) {
        for (int64_t k = 0; k < visible[size_t(chunk)]; ++k) {
            const int64_t slot = chunk * kStride + k;
            all.keys[places[size_t(chunk)] + k] = depth_key(depths[slot], uint32_t(slot));
        }
    });
    return all;
}

// Fills the tiles' lists in the order of the keys. Each worker has a band of rows of tiles to itself.
void fill_lists(View& view, const Gathered& all, int n_threads, const Interrupted& interrupted) {
    constexpr int64_t kRectAhead = 32, kProjectedAhead = 16;
    std::vector<int64_t> next(view.starts.data(), view.starts.data() + view.n_tiles());
    const int64_t n_bands = std::clamp<int64_t>(n_threads, 1, view.tiles_y);
    // Bands hold about the same number of pairs.
    std::vector<int> edges(size_t(n_bands + 1), view.tiles_y);
    edges[0] = 0;
    for (int64_t band = 1; band < n_bands; ++band) {
        int row = edges[size_t(band - 1)];
        while (row < view.tiles_y && view.starts[int64_t(row) * view.tiles_x] < view.lists.size() * band / n_bands) ++row;
        edges[size_t(band)] = row;
    }
    for_chunks(n_bands, n_threads, interrupted, [&](int64_t band, int) {
        const int begin = edges[size_t(band)], end = edges[size_t(band + 1)];
        const int64_t n = all.keys.size();
        for (int64_t i = 0; i < n; ++i) {
            if (i + kRectAhead < n) __builtin_prefetch(&all.rects[slot_of(all.keys[i + kRectAhead])]);
            if (i + kProjectedAhead < n) {
                const TileRect& soon = all.rects[slot_of(all.keys[i + kProjectedAhead])];
                if ((soon.x1 - soon.x0) * (soon.y1 - soon.y0) > kUntestedTiles)
                    __builtin_prefetch(&all.projected[slot_of(all.keys[i + kProjectedAhead])]);
            }
            const uint32_t slot = slot_of(all.keys[i]);
            const TileRect& rect = all.rects[slot];
            if (rect.y1 <= begin || rect.y0 >= end) continue;
            visit_tiles(all.projected[slot], rect, [&](int row, int x0, int x1) {
                if (row < begin || row >= end) return;
                for (int x = x0; x < x1; ++x) view.lists[next[size_t(row) * size_t(view.tiles_x) + size_t(x)]++] = slot;
            });
        }
    });
}

}  // namespace

View look(const Scene& scene, const Camera& camera, const Preset& preset, int n_threads, const Interrupted& interrupted) {
    View view{camera.width, camera.height, (camera.width + kTile - 1) / kTile, (camera.height + kTile - 1) / kTile,
              preset, scene.count, 0, {}, {}, {}};
    Gathered all = gather(scene, camera, preset, view, n_threads, interrupted);
    sort_by_depth(all.keys, all.projected.data(), scene.ties, n_threads, interrupted);
    view.n_visible = all.keys.size();
    view.starts = Buffer<int64_t>(view.n_tiles() + 1);
    view.starts[0] = 0;
    for (int64_t tile = 0; tile < view.n_tiles(); ++tile)
        view.starts[tile + 1] = view.starts[tile] + all.per_tile[size_t(tile)];
    view.lists = Buffer<uint32_t>(view.starts[view.n_tiles()]);
    fill_lists(view, all, n_threads, interrupted);
    view.projected = std::move(all.projected);
    return view;
}

}  // namespace scoup
