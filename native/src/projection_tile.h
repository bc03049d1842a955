#pragma once

#include <cmath>
#include <limits>

#include "tile.h"
#include "projection.h"

namespace scoup {

// Tile number `index` (row by row) of a view, as kernels want it.
inline Tile tile_of(const Projection& projection, int64_t index) {
    const float keep = projection.preset.stop_inclusive
                           ? std::nextafter(projection.preset.stop, std::numeric_limits<float>::infinity())
                           : projection.preset.stop;
    return {projection.projected.data(),
            projection.lists.data() + projection.starts[index],
            projection.starts[index + 1] - projection.starts[index],
            int32_t(index % projection.tiles_x) * kTile,
            int32_t(index / projection.tiles_x) * kTile,
            projection.width,
            projection.height,
            projection.preset.alpha_max,
            keep};
}

}  // namespace scoup
