// What the rasteriser knows of a camera, and of a Gaussian once projected.
#pragma once

#include <cfloat>
#include <cstdint>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ != 0)
#error "the compiled core must be built without -ffast-math: it relies on infinities and on what is not a number"
#endif
// 0: floats are worked out as floats; 16: so are they, only numbers of 16 bits differ.
#if FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16
#error "the compiled core must be built without excess precision (32-bit x86: -msse2 -mfpmath=sse): its bounds are of floats"
#endif

namespace scoup {

constexpr int kTile = 16;                 // edge of a tile in pixels
constexpr double kAlphaMin = 1.0 / 255;   // a Gaussian paints exactly the pixels where its alpha reaches this
constexpr double kLowPass = 0.3;          // added to the diagonal of the 2D covariance, in square pixels
constexpr double kLog2E = 1.4426950408889634;
constexpr float kLog2AlphaMin = -7.994353436858858f;

struct Camera {
    double viewmat[12];  // world to camera, three rows of four
    double fx, fy, cx, cy;
    int32_t width, height;
};

struct Preset {
    double near;
    float alpha_max;
    float stop;           // a pixel is finished before the Gaussian that would bring its transmittance below this
    bool stop_inclusive;  // ... or equal to this
    bool centred_clamp;   // Jacobian clamp about the image centre (Inria) or beyond the image border (gsplat)
};

// alpha at pixel centre (x, y) is 2^(peak - u^2 - v^2) with dx = px - x, dy = py - y,
// u = ku (dx - slope dy) and v = kv dy: two squares instead of the conic's three terms, which cancel badly for
// needles. Positions and slope are double because dx and slope dy may be thousands of pixels and cancel, too.
struct alignas(64) Projected {
    double x, y;       // centre in pixels
    double slope;      // xy / yy of the 2D covariance
    double depth;      // view-space z in world units
    float ku, kv;      // scaled by sqrt(log2 e), so that powers of two take the place of e
    float peak;        // log2 of the opacity
    float tip;         // dy where the ellipse alpha >= 1/255 is farthest right; by symmetry, farthest left at -tip
    float reach;       // half width of that ellipse in pixels, with slack
    float rise;        // its half height, with slack
    float pixels;      // 1 / ku
    uint32_t id;       // row in the scene
};
static_assert(sizeof(Projected) == 64, "one Gaussian is one cache line");

// Half-open ranges of tiles around a Gaussian's ellipse.
struct TileRect {
    uint16_t x0, x1, y0, y1;
};

// A half-open range of tiles in a row of tiles.
struct Span {
    uint16_t first, end;
};

// The ellipse is widened by this many pixels wherever only a bound is wanted, so that the alpha of each pixel alone
// decides what is painted.
constexpr float kSlack = 0.01f;
// ... and by this share of its size, for the rounding of large ones.
constexpr float kSlackShare = 2e-6f;

}  // namespace scoup
