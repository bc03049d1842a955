// A scene as one camera sees it: projected, sorted by depth and binned to tiles.
#pragma once

#include <cstdint>

#include "buffer.h"
#include "project_kernels.h"
#include "projected.h"
#include "threads.h"

namespace scoup {

// What the tile loop reads.
struct Projection {
    int32_t width, height;
    int32_t tiles_x, tiles_y;
    Preset preset;
    int64_t n_gaussians;           // rows of the scene
    int64_t n_looked_at;           // rows of the chunks that may be seen
    int64_t n_visible;
    Buffer<Projected> projected;   // by slot; slots between visible ones are not written
    Buffer<uint32_t> lists;        // slots of the Gaussians that reach each tile, tile after tile, nearest first
    Buffer<int64_t> starts;        // [tiles + 1], where each tile's slots begin in `lists`

    int64_t n_tiles() const { return int64_t(tiles_x) * tiles_y; }
};

// The blocks of a scene of which many views are made.
Buffer<SceneBlock> blocks_of(const Scene& scene, int n_threads, const Interrupted& interrupted);

// The bounds of its chunks, by which whole chunks are passed over.
Buffer<ChunkBounds> bounds_of(const Scene& scene, int n_threads, const Interrupted& interrupted);

// Takes time in proportion to the chunks that may be seen and to the pairs of a Gaussian and a tile it reaches.
// Memory: up to 64 bytes a Gaussian of these chunks, 4 bytes a pair, and while it works 12 bytes a Gaussian and 8 a pair more.
Projection project(const Scene& scene, const Camera& camera, const Preset& preset, int n_threads, const Interrupted& interrupted);

}  // namespace scoup
