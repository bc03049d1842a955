// Connected parts of a mask: what main_parts of scoup/query/segment.py asks for.
#pragma once

#include <cstdint>

namespace scoup {

constexpr int64_t kMostMaskPixels = int64_t(1) << 30;

// parts [height, width]: 0 outside of the mask, inside 1 .. n, numbered by the first pixels of the parts, row by row. Pixels
// that touch at a corner are connected. Returns n.
int32_t mask_parts(const uint8_t* mask, int64_t height, int64_t width, int32_t* parts);

}  // namespace scoup
