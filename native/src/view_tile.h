#pragma once

#include <cmath>
#include <limits>

#include "tile.h"
#include "view.h"

namespace scoup {

// Tile number `index` (row by row) of a view, as kernels want it.
inline Tile tile_of(const View& view, int64_t index) {
    const float keep = view.preset.stop_inclusive
                           ? std::nextafter(view.preset.stop, std::numeric_limits<float>::infinity())
                           : view.preset.stop;
    return {view.projected.data(),
            view.lists.data() + view.starts[index],
            view.starts[index + 1] - view.starts[index],
            int32_t(index % view.tiles_x) * kTile,
            int32_t(index / view.tiles_x) * kTile,
            view.width,
            view.height,
            view.preset.alpha_max,
            keep};
}

}  // namespace scoup
