// Rendering of dense per-Gaussian values in one tile.
#pragma once

#include <cstdint>

#include "isa.h"
#include "tile.h"

namespace scoup {

struct ChannelImage {
    const float* values;  // [N, channels]
    int32_t channels;
    float* image;         // [height, width, channels]
    float* alpha;         // [height, width]; null: not wanted
};

struct ChannelKernels {
    // `scratch`: room for channels * 256 floats on a 64 byte boundary.
    void (*render)(const Tile& tile, const ChannelImage& out, float* scratch);
};

SCOUP_KERNEL_TABLE(ChannelKernels, channel_kernels)

}  // namespace scoup
