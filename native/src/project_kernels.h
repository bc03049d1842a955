// Projection of 3D Gaussians to image-plane Gaussians (EWA splatting), in double precision.
#pragma once

#include <cstdint>

#include "isa.h"
#include "projected.h"
#include "scene_kernels.h"

namespace scoup {

struct ProjectKernels {
    // Projects the scene's blocks first .. last - 1 and writes those Gaussians that can paint a pixel, in an order that
    // depends on nothing else. Returns how many; the arrays hold one more than there are rows, which is scratch.
    int64_t (*project)(const Scene& scene, const Camera& camera, const Preset& preset, int64_t first, int64_t last,
                       Projected* out, TileRect* rects, float* depths);
    // Whether a row of a chunk may be visible; false only if none is.
    bool (*may_see)(const ChunkBounds& bounds, const Camera& camera, const Preset& preset);
    // Of each row of tiles of `rect`, those that the ellipse alpha >= 1/255, slightly widened, reaches.
    void (*spans)(const Projected& p, const TileRect& rect, Span* out);
};

SCOUP_KERNEL_TABLE(ProjectKernels, project_kernels)

}  // namespace scoup
