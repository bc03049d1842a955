// A scene in blocks of rows, with what does not depend on the camera worked out.
#pragma once

#include <cstdint>

#include "isa.h"
#include "projected.h"

namespace scoup {

constexpr int kBlockRows = 8;

// Eight Gaussians side by side: 48 bytes each. Rotations and scales are kept apart: their product, rounded to floats,
// would turn long needles by more than is allowed.
struct alignas(64) SceneBlock {
    float mean[3][kBlockRows];   // the first two lines of the cache tell whether the rest is needed
    float extent[kBlockRows];    // largest scale; not a number where nothing can be drawn
    float quat[4][kBlockRows];   // w, x, y, z, any norm
    float scale[3][kBlockRows];
    float peak[kBlockRows];      // log2 of the opacity
};

// Rows are projected in chunks of so many blocks, each by one thread.
constexpr int64_t kChunkBlocks = 1024;

// Where the rows of a chunk that can be drawn lie; a chunk of no such row has a negative extent.
struct ChunkBounds {
    float low[3], high[3];  // of the means
    float extent;           // largest scale
};

struct Scene {
    int64_t count;
    const float* means;      // [N, 3]
    const float* quats;      // [N, 4] w, x, y, z, any norm
    const float* scales;     // [N, 3]
    const float* opacities;  // [N]
    const int64_t* ties;     // [N] numbers that decide between equal depths, or null: the rows themselves
    const SceneBlock* blocks = nullptr;  // of these rows, or null: they are made as they are needed
    const ChunkBounds* bounds = nullptr;  // of the chunks, or null: all of them are looked at in every view

    int64_t n_blocks() const { return (count + kBlockRows - 1) / kBlockRows; }
    int64_t n_chunks() const { return (n_blocks() + kChunkBlocks - 1) / kChunkBlocks; }
};

struct SceneKernels {
    // Makes the blocks first .. last - 1. Rows beyond the scene are never drawn.
    void (*make_blocks)(const Scene& scene, int64_t first, int64_t last, SceneBlock* out);
};

SCOUP_KERNEL_TABLE(SceneKernels, scene_kernels)

}  // namespace scoup
