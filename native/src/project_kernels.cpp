#include "project_kernels.h"

#include "doubles.h"

namespace scoup::SCOUP_ISA {
namespace {

static_assert(kBlockRows % kGroup == 0);

// The largest value that v[0] x + v[1] y + v[2] z takes in a box, a little more for its rounding.
SCOUP_INLINE double largest(const double* v, const ChunkBounds& box) {
    double sum = 0, size = 0;
    for (int c = 0; c < 3; ++c) {
        const double low = v[c] * double(box.low[c]), high = v[c] * double(box.high[c]);
        const double larger = low > high ? low : high;
        sum += larger, size += larger < 0 ? -larger : larger;
    }
    return sum + 1e-9 * size;
}

// Which rows of a block, from row `at` on, may be visible, by their centre and largest scale alone.
struct Sieve {
    const Camera& camera;
    double near;
    double spread_x, spread_y;  // pixels of half extent per scale / depth, at the most

    Sieve(const Camera& c, const Preset& preset, double ray_x, double ray_y) : camera(c), near(preset.near) {
        constexpr double kReach = 3.34;  // standard deviations at opacity 1: sqrt(2 ln 255)
        spread_x = kReach * c.fx * __builtin_sqrt(1 + ray_x * ray_x);
        spread_y = kReach * c.fy * __builtin_sqrt(1 + ray_y * ray_y);
    }

    SCOUP_INLINE Longs operator()(const SceneBlock& block, int at) const {
        const double* v = camera.viewmat;
        const double right = camera.width - 0.5 - camera.cx, left = camera.cx - 0.5;
        const double bottom = camera.height - 0.5 - camera.cy, top = camera.cy - 0.5;
        const Doubles mx = doubles(block.mean[0] + at), my = doubles(block.mean[1] + at), mz = doubles(block.mean[2] + at);
        const Doubles x = v[0] * mx + v[1] * my + v[2] * mz + v[3];
        const Doubles y = v[4] * mx + v[5] * my + v[6] * mz + v[7];
        const Doubles z = v[8] * mx + v[9] * my + v[10] * mz + v[11];
        const Doubles extent = doubles(block.extent + at);
        const Doubles reach_x = spread_x * extent + kBlur * z, reach_y = spread_y * extent + kBlur * z;
        // Not `|`-ed from comparisons that NaN would pass: every test must hold.
        return (z > near) & (camera.fx * x + left * z + reach_x >= 0) & (camera.fx * x - right * z - reach_x <= 0) &
               (camera.fy * y + top * z + reach_y >= 0) & (camera.fy * y - bottom * z - reach_y <= 0);
    }

    // The same tests, each for the row of a chunk that would pass it best.
    bool chunk(const ChunkBounds& bounds) const {
        const double right = camera.width - 0.5 - camera.cx, left = camera.cx - 0.5;
        const double bottom = camera.height - 0.5 - camera.cy, top = camera.cy - 0.5;
        const double wide = spread_x * double(bounds.extent), high = spread_y * double(bounds.extent);
        return bounds.extent >= 0 && passes(0, 0, 1, -near, bounds) && passes(camera.fx, 0, left + kBlur, wide, bounds) &&
               passes(-camera.fx, 0, right + kBlur, wide, bounds) && passes(0, camera.fy, top + kBlur, high, bounds) &&
               passes(0, -camera.fy, bottom + kBlur, high, bounds);
    }

  private:
    static constexpr double kBlur = 1.9;  // what the low-pass adds to a half extent: 3.34 sqrt(0.3)

    // Whether a x + b y + c z + d >= 0, in the camera's frame, somewhere in the box; rounding is forgiven.
    bool passes(double a, double b, double c, double d, const ChunkBounds& bounds) const {
        const double* v = camera.viewmat;
        const double direction[3] = {a * v[0] + b * v[4] + c * v[8], a * v[1] + b * v[5] + c * v[9],
                                     a * v[2] + b * v[6] + c * v[10]};
        const double size = __builtin_fabs(a * v[3]) + __builtin_fabs(b * v[7]) + __builtin_fabs(c * v[11]) + __builtin_fabs(d);
        return largest(direction, bounds) + (a * v[3] + b * v[7] + c * v[11]) + d + 1e-9 * size >= 0;
    }
};

// In double precision: single precision makes region sums only a few per cent faster, even without compensated terms.
class Projector {
  public:
    Projector(const Camera& camera, const Preset& preset) : camera_(camera) {
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

    // Writes the visible ones of the rows wanted, a register of them from row `at` on, whose numbers in the scene are
    // `ids`; returns how many. There must be room for one more.
    int operator()(const SceneBlock& block, int at, Longs wanted, const uint32_t* ids, Projected* out, TileRect* rects,
                   float* depths) const {
        const double* v = camera_.viewmat;
        const Doubles mean[3] = {doubles(block.mean[0] + at), doubles(block.mean[1] + at), doubles(block.mean[2] + at)};
        const Doubles x = v[0] * mean[0] + v[1] * mean[1] + v[2] * mean[2] + v[3];
        const Doubles y = v[4] * mean[0] + v[5] * mean[1] + v[6] * mean[2] + v[7];
        const Doubles z = v[8] * mean[0] + v[9] * mean[1] + v[10] * mean[2] + v[11];
        const Doubles per_depth = 1 / z;
        const Doubles ray_x = at_least(at_most(x * per_depth, high_x_ + Doubles{}), low_x_ + Doubles{});
        const Doubles ray_y = at_least(at_most(y * per_depth, high_y_ + Doubles{}), low_y_ + Doubles{});

        // B = J W R S, with B B^T the 2D covariance before the low-pass.
        const Doubles qw = doubles(block.quat[0] + at), qx = doubles(block.quat[1] + at), qy = doubles(block.quat[2] + at);
        const Doubles qz = doubles(block.quat[3] + at);
        const Doubles two = 2 / (qw * qw + qx * qx + qy * qy + qz * qz), w = qw * two;
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
            const Doubles scale = doubles(block.scale[c] + at);
            row_x[c] = (axis_x - ray_x * axis_z) * (camera_.fx * per_depth) * scale;
            row_y[c] = (axis_y - ray_y * axis_z) * (camera_.fy * per_depth) * scale;
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

        const Doubles peak = doubles(block.peak + at);
        const Doubles radius2 = 2 / kLog2E * at_least(peak - double(kLog2AlphaMin), Doubles{});
        const Doubles half_width = sqrt(radius2 * xx), half_height = sqrt(radius2 * yy);
        const Doubles centre_x = x * per_depth * camera_.fx + camera_.cx;
        const Doubles centre_y = y * per_depth * camera_.fy + camera_.cy;
        // Bounds keep absurd sizes representable as float.
        const Doubles tiny = 1e-30 + Doubles{}, vast = 1e30 + Doubles{};
        const Doubles per_yy = 1 / yy;
        const Doubles pixels = at_most(sqrt(2 / kLog2E * determinant * per_yy), vast), ku = 1 / pixels;
        const Doubles kv = at_least(sqrt(0.5 * kLog2E * per_yy), tiny);
        const Doubles slope = at_least(at_most(xy * per_yy, vast), -vast);
        // Where the right border slope dy + sqrt(R^2 - (kv dy)^2) / ku has its maximum.
        const Doubles tip = at_least(at_most(half_width * xy / xx, vast), -vast);

        const Longs visible = wanted & (centre_x + half_width >= 0.5) &
                              (centre_x - half_width <= camera_.width - 0.5) & (centre_y + half_height >= 0.5) &
                              (centre_y - half_height <= camera_.height - 0.5);
        const Doubles reach = widened(half_width), rise = widened(half_height);
        // Pixel centres lie at +0.5. The first tile may be one too many to the left or above: a bound is all it is.
        const Ranges across = tiles(centre_x - reach - 0.5, centre_x + reach - 0.5, tiles_x_);
        const Ranges along = tiles(centre_y - rise - 0.5, centre_y + rise - 0.5, tiles_y_);
        // Through memory: numbers are taken out of long vectors at a high price.
        alignas(64) float ku_[kGroup], kv_[kGroup], peak_[kGroup], tip_[kGroup], reach_[kGroup], rise_[kGroup],
            pixels_[kGroup], depth_[kGroup];
        alignas(64) double x_[kGroup], y_[kGroup], slope_[kGroup], z_[kGroup];
        alignas(64) int64_t visible_[kGroup];
        store_singles(ku_, ku), store_singles(kv_, kv), store_singles(peak_, peak), store_singles(tip_, tip);
        store_singles(reach_, reach), store_singles(rise_, rise), store_singles(pixels_, pixels), store_singles(depth_, z);
        __builtin_memcpy(x_, &centre_x, sizeof x_), __builtin_memcpy(y_, &centre_y, sizeof y_);
        __builtin_memcpy(slope_, &slope, sizeof slope_), __builtin_memcpy(z_, &z, sizeof z_);
        __builtin_memcpy(visible_, &visible, sizeof visible_);
        int n = 0;
        for (int i = 0; i < kGroup; ++i) {
            out[n] = {x_[i], y_[i], slope_[i], z_[i], ku_[i], kv_[i], peak_[i], tip_[i], reach_[i], rise_[i], pixels_[i], ids[i]};
            rects[n] = {uint16_t(across.first[i]), uint16_t(across.end[i]), uint16_t(along.first[i]), uint16_t(along.end[i])};
            depths[n] = depth_[i];
            n += visible_[i] != 0;  // written always, kept only if visible: cheaper than a branch
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
    double low_x_, high_x_, low_y_, high_y_;
    int tiles_x_, tiles_y_;
};

// Gaussians of several blocks gathered in one.
struct Gathered {
    SceneBlock block{};
    uint32_t ids[kBlockRows] = {};
    int count = 0;

    SCOUP_INLINE void add(const SceneBlock& from, int i, uint32_t id) {
        for (int c = 0; c < 3; ++c) block.mean[c][count] = from.mean[c][i];
        for (int c = 0; c < 4; ++c) block.quat[c][count] = from.quat[c][i];
        for (int c = 0; c < 3; ++c) block.scale[c][count] = from.scale[c][i];
        block.peak[count] = from.peak[i];
        ids[count++] = id;
    }

    template <class Write>
    SCOUP_INLINE void write(const Write& write) {
        int64_t wanted[kBlockRows];
        for (int i = 0; i < kBlockRows; ++i) wanted[i] = -(i < count);
        if (count > 0) write(block, wanted, ids);
        count = 0;
    }
};

int64_t project(const Scene& scene, const Camera& camera, const Preset& preset, int64_t first, int64_t last,
                Projected* out, TileRect* rects, float* depths) {
    constexpr int kAtOnce = 8;  // blocks that are made here
    constexpr int kDense = 6;   // with fewer rows to project, a block is not projected as it is
    const Projector projector(camera, preset);
    const Sieve sieve(camera, preset, projector.widest_ray_x(), projector.widest_ray_y());
    SceneBlock made[kAtOnce];
    Gathered gathered;
    int64_t written = 0;
    const auto write = [&](const SceneBlock& block, const int64_t* wanted, const uint32_t* ids) {
        for (int at = 0; at < kBlockRows; at += kGroup) {
            Longs rows;
            __builtin_memcpy(&rows, wanted + at, sizeof rows);
            written += projector(block, at, rows, ids + at, out + written, rects + written, depths + written);
        }
    };
    for (int64_t at = first; at < last; ++at) {
        const SceneBlock* block = scene.blocks + at;
        if (scene.blocks == nullptr) {
            const int64_t place = (at - first) % kAtOnce;
            if (place == 0) scene_kernels.make_blocks(scene, at, at + kAtOnce < last ? at + kAtOnce : last, made);
            block = made + place;
        }
        alignas(64) int64_t wanted[kBlockRows];  // -1 or 0
        for (int i = 0; i < kBlockRows; i += kGroup) {
            const Longs rows = sieve(*block, i);
            __builtin_memcpy(wanted + i, &rows, sizeof rows);
        }
        int64_t count = 0;
        for (const int64_t row : wanted) count -= row;
        if (count == 0) continue;
        uint32_t ids[kBlockRows];
        for (int i = 0; i < kBlockRows; ++i) ids[i] = uint32_t(at * kBlockRows + i);
        if (count >= kDense) {
            write(*block, wanted, ids);
            continue;
        }
        for (int i = 0; i < kBlockRows; ++i) {
            if (wanted[i] == 0) continue;
            gathered.add(*block, i, ids[i]);
            if (gathered.count == kBlockRows) gathered.write(write);
        }
    }
    gathered.write(write);
    return written;
}

bool may_see(const ChunkBounds& bounds, const Camera& camera, const Preset& preset) {
    const Projector projector(camera, preset);
    return Sieve(camera, preset, projector.widest_ray_x(), projector.widest_ray_y()).chunk(bounds);
}

// The geometry is that of find_painters in walk.h; rows go through side by side.
void spans(const Projected& p, const TileRect& rect, Span* out) {
    const int width = rect.x1 - rect.x0, height = rect.y1 - rect.y0;
    const float dx = float(rect.x0 * kTile + 0.5 - p.x), dy = float(rect.y0 * kTile + 0.5 - p.y), slope = float(p.slope);
    const float slack = 2 * kSlack + 4 * kSlackShare * p.reach;
    const Floats radius2 = larger(all(p.peak - kLog2AlphaMin), Floats{});
    const Floats none{}, whole = all(float(width)), tip = all(p.tip), rise = all(p.rise);
    Floats lane;
    for (int i = 0; i < kLanes; ++i) lane[i] = float(i * kTile);
    for (int row = 0; row < height; row += kLanes) {
        const Floats begin = lane + (dy + float(row * kTile));
        const Floats top = larger(begin, -rise), bottom = smaller(begin + float(kTile - 1), rise);
        const Floats dy_right = smaller(larger(tip, top), bottom), dy_left = smaller(larger(-tip, top), bottom);
        const Floats v_right = p.kv * dy_right, v_left = p.kv * dy_left;
        const Floats half_right = sqrt(larger(radius2 - v_right * v_right, none)) * p.pixels + slack;
        const Floats half_left = sqrt(larger(radius2 - v_left * v_left, none)) * p.pixels + slack;
        // From the first pixel centre of the rectangle. What is not a number counts as the whole row.
        const Floats right = slope * dy_right + half_right - dx, left = slope * dy_left - half_left - dx;
        const Floats first = smaller(larger((left + 1.0f) * (1.0f / kTile), none), whole);
        const Floats end = larger(smaller(right * (1.0f / kTile) + 1.0f, whole), first);
        const Ints firsts = __builtin_convertvector(first, Ints), ends = __builtin_convertvector(end, Ints);
        for (int i = 0; i < kLanes && row + i < height; ++i)
            out[row + i] = {uint16_t(rect.x0 + firsts[i]), uint16_t(rect.x0 + ends[i])};
    }
}

}  // namespace

const ProjectKernels project_kernels = {project, may_see, spans};

}  // namespace scoup::SCOUP_ISA
