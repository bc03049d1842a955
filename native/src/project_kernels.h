// Projection of 3D Gaussians to image-plane Gaussians (EWA splatting), in double precision.
#pragma once

#include <cstdint>

#include "isa.h"
#include "projected.h"

namespace scoup {

struct Scene {
    int64_t count;
    const float* means;      // [N, 3]
    const float* quats;      // [N, 4] w, x, y, z, any norm
    const float* scales;     // [N, 3]
    const float* opacities;  // [N]
    const int64_t* ties;     // [N] numbers that decide between equal depths, or null: the rows themselves
};

struct ProjectKernels {
    // Projects rows first .. last - 1 and writes those that can paint a pixel, in the order of the rows, to out,
    // rects and keys (depth as float). Returns how many; the arrays hold last - first + 1,
    // of which the last one is scratch.
    int64_t (*project)(const Scene& scene, const Camera& camera, const Preset& preset, int64_t first, int64_t last,
                       Projected* out, TileRect* rects, float* keys);
};

SCOUP_KERNEL_TABLE(ProjectKernels, project_kernels)

}  // namespace scoup
