// Which Gaussian may paint in which tile.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "projected.h"

namespace scoup {

constexpr int kUntestedTiles = 4;

inline float between(float x, float low, float high) { return std::min(std::max(x, low), high); }

// Calls visit(row of tiles, first tile, one past the last) for each row of tiles that the ellipse
// alpha >= 1/255, slightly widened, reaches; `rect` holds the tiles around it.
template <class Visit>
inline void visit_tiles(const Projected& p, const TileRect& rect, const Visit& visit) {
    // An ellipse inside one row or one column of tiles reaches every tile of its rectangle. A few tiles more or less are
    // not worth the square roots: the tile loop finds out by itself.
    const int width = rect.x1 - rect.x0, height = rect.y1 - rect.y0;
    if (width < 2 || height < 2 || width * height <= kUntestedTiles) {
        for (int row = rect.y0; row < rect.y1; ++row) visit(row, int(rect.x0), int(rect.x1));
        return;
    }
    const float radius2 = std::max(p.peak - kLog2AlphaMin, 0.0f), slope = float(p.slope);
    const float slack = 2 * kSlack + 4 * kSlackShare * p.reach;
    const auto half_width = [&](float dy) {
        const float v = p.kv * dy;
        return std::sqrt(std::max(radius2 - v * v, 0.0f)) * p.pixels + slack;
    };
    for (int row = rect.y0; row < rect.y1; ++row) {
        const float top = std::max(float(row * kTile + 0.5 - p.y), -p.rise);
        const float bottom = std::min(float(row * kTile + (kTile - 0.5) - p.y), p.rise);
        const float dy_right = between(p.tip, top, bottom), dy_left = between(-p.tip, top, bottom);
        const double right = p.x + (slope * dy_right + half_width(dy_right)) - 0.5;
        const double left = p.x + (slope * dy_left - half_width(dy_left)) - 0.5;
        const double first = std::floor(std::ceil(left) / kTile), last = std::floor(std::floor(right) / kTile);
        const int x0 = first > rect.x0 ? int(std::min(first, double(rect.x1))) : rect.x0;
        const int x1 = last + 1 < rect.x1 ? int(std::max(last + 1, double(rect.x0))) : rect.x1;
        if (x0 < x1) visit(row, x0, x1);
    }
}

}  // namespace scoup
