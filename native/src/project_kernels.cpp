#include "project_kernels.h"

#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

// Eight Gaussians go through together; the compiler splits the vectors where registers are shorter.
constexpr int kGroup = 8;
constexpr int kBatch = 64;
using Doubles = double __attribute__((vector_size(8 * kGroup)));
using Longs = int64_t __attribute__((vector_size(8 * kGroup)));
using Halves = int32_t __attribute__((vector_size(4 * kGroup)));

template <double (*function)(double)>
SCOUP_INLINE Doubles each(Doubles x) {
    for (int i = 0; i < kGroup; ++i) x[i] = function(x[i]);
    return x;
}
SCOUP_INLINE double root(double x) { return __builtin_sqrt(x); }
SCOUP_INLINE Doubles sqrt(Doubles x) { return each<root>(x); }
SCOUP_INLINE Doubles at_least(Doubles x, Doubles low) { return x > low ? x : low; }
SCOUP_INLINE Doubles at_most(Doubles x, Doubles high) { return x < high ? x : high; }

// log2 of 2^-126 <= x <= 1 to 1e-15: the exponent, and atanh's series of the mantissa brought near 1.
SCOUP_INLINE Doubles log2(Doubles x) {
    const Longs bits = (Longs)x - 0x3fe6a09e667f3bcdLL;  // of sqrt(1/2): mantissas end up in [sqrt(1/2), sqrt(2))
    const Longs exponent = bits >> 52;
    const Doubles m = (Doubles)((bits & 0x000fffffffffffffLL) + 0x3fe6a09e667f3bcdLL);
    const Doubles t = (m - 1) / (m + 1), t2 = t * t;
    Doubles p = t2 * (1.0 / 19) + 1.0 / 17;
    for (int odd = 15; odd > 0; odd -= 2) p = p * t2 + 1.0 / odd;
    return __builtin_convertvector(exponent, Doubles) + (2 * kLog2E) * t * p;
}

// Which of up to kBatch rows may be visible, by their centre and largest scale alone: writes their numbers.
struct Sieve {
    const Camera& camera;
    double near;
    double spread_x, spread_y;  // pixels of half extent per scale / depth, at the most

    Sieve(const Camera& c, const Preset& preset, double ray_x, double ray_y) : camera(c), near(preset.near) {
        constexpr double kReach = 3.34;  // standard deviations at opacity 1: sqrt(2 ln 255)
        spread_x = kReach * c.fx * __builtin_sqrt(1 + ray_x * ray_x);
        spread_y = kReach * c.fy * __builtin_sqrt(1 + ray_y * ray_y);
    }

    SCOUP_INLINE int operator()(const Scene& scene, int64_t first, int count, int32_t* found) const {
        alignas(64) int32_t keep[kBatch];
        const float* means = scene.means + 3 * first;
        const float* scales = scene.scales + 3 * first;
        const float* opacities = scene.opacities + first;
        const double* v = camera.viewmat;
        constexpr double kBlur = 1.9;  // what the low-pass adds to a half extent: 3.34 sqrt(0.3)
        const double right = camera.width - 0.5 - camera.cx, left = camera.cx - 0.5;
        const double bottom = camera.height - 0.5 - camera.cy, top = camera.cy - 0.5;
        for (int i = 0; i < count; ++i) {
            const double mx = means[3 * i], my = means[3 * i + 1], mz = means[3 * i + 2];
            const double x = v[0] * mx + v[1] * my + v[2] * mz + v[3];
            const double y = v[4] * mx + v[5] * my + v[6] * mz + v[7];
            const double z = v[8] * mx + v[9] * my + v[10] * mz + v[11];
            const float s0 = __builtin_fabsf(scales[3 * i]), s1 = __builtin_fabsf(scales[3 * i + 1]);
            const float s2 = __builtin_fabsf(scales[3 * i + 2]);
            const float scale = s0 > s1 ? (s0 > s2 ? s0 : s2) : (s1 > s2 ? s1 : s2);
            const double reach_x = spread_x * scale + kBlur * z, reach_y = spread_y * scale + kBlur * z;
            // Not `|`-ed from comparisons that NaN would pass: every test must hold.
            keep[i] = (z > near) & (opacities[i] >= float(kAlphaMin)) & (camera.fx * x + left * z + reach_x >= 0) &
                      (camera.fx * x - right * z - reach_x <= 0) & (camera.fy * y + top * z + reach_y >= 0) &
                      (camera.fy * y - bottom * z - reach_y <= 0);
        }
        int n = 0;
        for (int i = 0; i < count; ++i) {
            found[n] = i;
            n += keep[i];
        }
        return n;
    }
};

// Rows of the scene, one Gaussian a lane.
struct Group {
    Doubles mean[3], quat[4], scale[3], opacity;

    SCOUP_INLINE Group(const Scene& scene, int64_t first, const int32_t* rows, int count) {
        for (int i = 0; i < kGroup; ++i) {
            const int64_t row = first + rows[i < count ? i : 0];
            for (int c = 0; c < 3; ++c) mean[c][i] = scene.means[3 * row + c];
            for (int c = 0; c < 4; ++c) quat[c][i] = scene.quats[4 * row + c];
            for (int c = 0; c < 3; ++c) scale[c][i] = scene.scales[3 * row + c];
            opacity[i] = scene.opacities[row];
        }
    }

    // 0 where everything is finite, NaN elsewhere. An opacity of infinity is drawn as 1.
    SCOUP_INLINE Doubles poison() const {
        Doubles total{};
        for (int c = 0; c < 3; ++c) total += mean[c] * 0 + scale[c] * 0;
        for (int c = 0; c < 4; ++c) total += quat[c] * 0;
        return total;
    }
};

class Projector {
  public:
    Projector(const Camera& camera, const Preset& preset) : camera_(camera), near_(preset.near) {
        const double tan_x = 0.5 * camera.width / camera.fx, tan_y = 0.5 * camera.height / camera.fy;
        if (preset.centred_clamp) {
            low_x_ = -1.3 * tan_x, high_x_ = 1.3 * tan_x;
            low_y_ = -1.3 * tan_y, high_y_ = 1.3 * tan_y;
        } else {
            low_x_ = -camera.cx / camera.fx - 0.3 * tan_x;
            high_x_ = (camera.width - camera.cx) / camera.fx + 0.3 * tan_x;
            low_y_ = -camera.cy / camera.fy - 0.3 * tan_y;
            high_y_ = (camera.height - camera.cy) / camera.fy + 0.3 * tan_y;
        }
        tiles_x_ = (camera.width + kTile - 1) / kTile;
        tiles_y_ = (camera.height + kTile - 1) / kTile;
    }

    double widest_ray_x() const { return -low_x_ > high_x_ ? -low_x_ : high_x_; }
    double widest_ray_y() const { return -low_y_ > high_y_ ? -low_y_ : high_y_; }

    // Writes the visible ones of `count` Gaussians; returns how many. There must be room for one more.
    SCOUP_INLINE int operator()(const Group& g, const int32_t* rows, int count, uint32_t first, Projected* out,
                                TileRect* rects, float* keys) const {
        const double* v = camera_.viewmat;
        const Doubles x = v[0] * g.mean[0] + v[1] * g.mean[1] + v[2] * g.mean[2] + v[3];
        const Doubles y = v[4] * g.mean[0] + v[5] * g.mean[1] + v[6] * g.mean[2] + v[7];
        const Doubles z = v[8] * g.mean[0] + v[9] * g.mean[1] + v[10] * g.mean[2] + v[11];
        const Doubles per_depth = 1 / z;
        const Doubles ray_x = at_least(at_most(x * per_depth, high_x_ + Doubles{}), low_x_ + Doubles{});
        const Doubles ray_y = at_least(at_most(y * per_depth, high_y_ + Doubles{}), low_y_ + Doubles{});

        // B = J W R S, with B B^T the 2D covariance before the low-pass.
        const Doubles norm2 = g.quat[0] * g.quat[0] + g.quat[1] * g.quat[1] + g.quat[2] * g.quat[2] + g.quat[3] * g.quat[3];
        const Doubles two = 2 / norm2;
        const Doubles w = g.quat[0] * two, qx = g.quat[1], qy = g.quat[2], qz = g.quat[3];
        const Doubles wx = w * qx, wy = w * qy, wz = w * qz;
        const Doubles xx2 = two * qx * qx, yy2 = two * qy * qy, zz2 = two * qz * qz;
        const Doubles xy2 = two * qx * qy, xz2 = two * qx * qz, yz2 = two * qy * qz;
        const Doubles rotation[3][3] = {{1 - (yy2 + zz2), xy2 - wz, xz2 + wy},
                                        {xy2 + wz, 1 - (xx2 + zz2), yz2 - wx},
                                        {xz2 - wy, yz2 + wx, 1 - (xx2 + yy2)}};
        Doubles row_x[3], row_y[3];
        for (int c = 0; c < 3; ++c) {
            const Doubles axis_x = v[0] * rotation[0][c] + v[1] * rotation[1][c] + v[2] * rotation[2][c];
            const Doubles axis_y = v[4] * rotation[0][c] + v[5] * rotation[1][c] + v[6] * rotation[2][c];
            const Doubles axis_z = v[8] * rotation[0][c] + v[9] * rotation[1][c] + v[10] * rotation[2][c];
            row_x[c] = (axis_x - ray_x * axis_z) * (camera_.fx * per_depth) * g.scale[c];
            row_y[c] = (axis_y - ray_y * axis_z) * (camera_.fy * per_depth) * g.scale[c];
        }
        const Doubles square_x = row_x[0] * row_x[0] + row_x[1] * row_x[1] + row_x[2] * row_x[2];
        const Doubles square_y = row_y[0] * row_y[0] + row_y[1] * row_y[1] + row_y[2] * row_y[2];
        const Doubles xy = row_x[0] * row_y[0] + row_x[1] * row_y[1] + row_x[2] * row_y[2];
        // The determinant by the minors of B: a difference xx yy - xy^2 would lose every digit of a needle.
        const Doubles minor0 = row_x[1] * row_y[2] - row_x[2] * row_y[1];
        const Doubles minor1 = row_x[2] * row_y[0] - row_x[0] * row_y[2];
        const Doubles minor2 = row_x[0] * row_y[1] - row_x[1] * row_y[0];
        const Doubles determinant = minor0 * minor0 + minor1 * minor1 + minor2 * minor2 +
                                    kLowPass * (square_x + square_y) + kLowPass * kLowPass;
        const Doubles xx = square_x + kLowPass, yy = square_y + kLowPass;

        const Doubles peak = log2(at_most(g.opacity, 1 + Doubles{}));
        const Doubles radius2 = 2 / kLog2E * at_least(peak - double(kLog2AlphaMin), Doubles{});
        const Doubles half_width = sqrt(radius2 * xx), half_height = sqrt(radius2 * yy);
        const Doubles centre_x = x * per_depth * camera_.fx + camera_.cx;
        const Doubles centre_y = y * per_depth * camera_.fy + camera_.cy;
        // Bounds keep absurd sizes representable as float.
        const Doubles tiny = 1e-30 + Doubles{}, vast = 1e30 + Doubles{};
        const Doubles ku = at_least(sqrt(0.5 * kLog2E * yy / determinant), tiny);
        const Doubles kv = at_least(sqrt(0.5 * kLog2E / yy), tiny);
        const Doubles slope = at_least(at_most(xy / yy, vast), -vast);
        // Where the right border slope dy + sqrt(R^2 - (kv dy)^2) / ku has its maximum.
        const Doubles tip = at_least(at_most(half_width * xy / xx, vast), -vast);

        const Longs visible = (z > near_) & (norm2 > 0) & (g.opacity >= double(float(kAlphaMin))) &
                              (g.poison() == 0) & (centre_x + half_width >= 0.5) &
                              (centre_x - half_width <= camera_.width - 0.5) & (centre_y + half_height >= 0.5) &
                              (centre_y - half_height <= camera_.height - 0.5);
        const Doubles reach = widened(half_width), rise = widened(half_height);
        // Pixel centres lie at +0.5. The first tile may be one too many to the left or above: a bound is all it is.
        const Ranges across = tiles(centre_x - reach - 0.5, centre_x + reach - 0.5, tiles_x_);
        const Ranges along = tiles(centre_y - rise - 0.5, centre_y + rise - 0.5, tiles_y_);
        const Doubles pixels = 1 / ku;
        int n = 0;
        for (int i = 0; i < count; ++i) {
            Projected& p = out[n];
            p.x = centre_x[i], p.y = centre_y[i], p.slope = slope[i], p.depth = z[i];
            p.ku = float(ku[i]), p.kv = float(kv[i]), p.peak = float(peak[i]), p.tip = float(tip[i]);
            p.reach = float(reach[i]), p.rise = float(rise[i]), p.pixels = float(pixels[i]);
            p.id = first + uint32_t(rows[i]);
            rects[n] = {uint16_t(across.first[i]), uint16_t(across.end[i]), uint16_t(along.first[i]), uint16_t(along.end[i])};
            keys[n] = float(z[i]);
            n += visible[i] != 0;  // written always, kept only if visible: cheaper than a branch
        }
        return n;
    }

  private:
    struct Ranges {
        Halves first, end;
    };

    static SCOUP_INLINE Doubles widened(Doubles extent) {
        return at_most(extent * (1 + double(kSlackShare)) + double(kSlack), 1e30 + Doubles{});
    }

    // Tiles that hold pixels low .. high.
    static SCOUP_INLINE Ranges tiles(Doubles low, Doubles high, int count) {
        const Doubles none{}, last = double(count) + Doubles{};
        const Doubles begin = at_most(at_least(low * (1.0 / kTile), none), last);
        const Doubles end = at_most(at_least(high * (1.0 / kTile), none) + 1, last);
        return {__builtin_convertvector(begin, Halves), __builtin_convertvector(end, Halves)};
    }

    const Camera& camera_;
    double near_, low_x_, high_x_, low_y_, high_y_;
    int tiles_x_, tiles_y_;
};

int64_t project(const Scene& scene, const Camera& camera, const Preset& preset, int64_t first, int64_t last,
                Projected* out, TileRect* rects, float* keys) {
    const Projector projector(camera, preset);
    const Sieve sieve(camera, preset, projector.widest_ray_x(), projector.widest_ray_y());
    int64_t written = 0;
    int32_t rows[kBatch];
    for (int64_t at = first; at < last; at += kBatch) {
        const int found = sieve(scene, at, int(last - at < kBatch ? last - at : kBatch), rows);
        for (int i = 0; i < found; i += kGroup) {
            const int count = smaller(found - i, kGroup);
            const Group group(scene, at, rows + i, count);
            written += projector(group, rows + i, count, uint32_t(at), out + written, rects + written, keys + written);
        }
    }
    return written;
}

}  // namespace

const ProjectKernels project_kernels = {project};

}  // namespace scoup::SCOUP_ISA
