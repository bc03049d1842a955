// What a kernel is told of one tile of a view.
#pragma once

#include <cstdint>

#include "projected.h"

namespace scoup {

struct Tile {
    const Projected* projected;
    const uint32_t* slots;   // into `projected`, nearest first
    int64_t count;           // of slots
    int32_t x, y;            // first pixel
    int32_t width, height;   // of the image
    float alpha_max;
    float keep;              // a Gaussian is drawn if the transmittance after it is at least this
};

}  // namespace scoup
