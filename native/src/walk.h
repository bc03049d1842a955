// The tile loop: blending weights of a tile's Gaussians, front to back. For *_kernels.cpp files only.
//
// A tile of 16 x 16 pixels is cut into blocks of 4 x (lanes / 4) pixels, one vector each; blocks fit small round
// footprints better than rows of pixels do. Gaussians are staged sixteen at a time: their offsets from the tile, and
// which of them reach which block, are worked out side by side. Then each unfinished block is painted by those that
// reach it: a block after the other, with its transmittance in a register, or a Gaussian after the other.
#pragma once

#include "tile.h"
#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr int kColumns = 4;                      // blocks across a tile
constexpr int kBlockWidth = kTile / kColumns;
constexpr int kBlockHeight = kLanes / kBlockWidth;
constexpr int kRows = kTile / kBlockHeight;      // blocks down a tile
constexpr int kBlocks = kColumns * kRows;        // at most 64: a set of blocks is the bits of a word
constexpr int kStage = 16;

using Blocks = uint64_t;   // a set of blocks
using Members = uint32_t;  // a set of the Gaussians of a stage

// The pixel of a lane, from the first of its block.
SCOUP_INLINE int lane_x(int lane) { return lane % kBlockWidth; }
SCOUP_INLINE int lane_y(int lane) { return lane / kBlockWidth; }
// The first pixel of a block, from the first of its tile.
SCOUP_INLINE int block_x(int block) { return block % kColumns * kBlockWidth; }
SCOUP_INLINE int block_y(int block) { return block / kColumns * kBlockHeight; }

// Takes the lowest member out of a set.
SCOUP_INLINE int next(Blocks& set) {
    const int member = __builtin_ctzll(set);
    set &= set - 1;
    return member;
}
SCOUP_INLINE int next(Members& set) {
    const int member = __builtin_ctz(set);
    set &= set - 1;
    return member;
}

// Sixteen Gaussians, one a lane, as seen from the tile's first pixel centre:
// log2 alpha at pixel (i, j) = peak - (u + ku i - skew j)^2 - (v + kv j)^2.
struct Stage {
    alignas(64) float u[kStage], ku[kStage], skew[kStage], v[kStage], kv[kStage], peak[kStage];
    Members painters[kBlocks];  // the Gaussians that reach each block
    uint32_t slot[kStage];
    // What the ellipses are found by: the tile's first pixel centre from theirs, and as in Projected.
    alignas(64) float dx[kStage], dy[kStage], slope[kStage], tip[kStage], reach[kStage], rise[kStage], pixels[kStage];
};

// Which of the stage's Gaussians first .. first + kLanes - 1 reach which block, one row of blocks at a time. The
// geometry is that of spans in project_kernels.cpp.
SCOUP_INLINE void find_painters(Stage& stage, int first) {
    const Floats ku = load(stage.ku + first), kv = load(stage.kv + first), peak = load(stage.peak + first);
    const Floats dx = load(stage.dx + first), dy = load(stage.dy + first), slope = load(stage.slope + first);
    const Floats tip = load(stage.tip + first), rise = load(stage.rise + first), pixels = load(stage.pixels + first);
    store(stage.skew + first, ku * slope);
    store(stage.v + first, kv * dy);

    const Floats radius2 = larger(peak - kLog2AlphaMin, Floats{});
    const Floats slack = 2 * kSlack + 4 * kSlackShare * load(stage.reach + first);
    for (int row = 0; row < kRows; ++row) {
        const Floats begin = dy + float(row * kBlockHeight);
        const Floats top = larger(begin, -rise), bottom = smaller(begin + float(kBlockHeight - 1), rise);
        const Floats dy_right = smaller(larger(tip, top), bottom), dy_left = smaller(larger(-tip, top), bottom);
        const Floats v_right = kv * dy_right, v_left = kv * dy_left;
        const Floats half_right = sqrt(larger(radius2 - v_right * v_right, Floats{})) * pixels + slack;
        const Floats half_left = sqrt(larger(radius2 - v_left * v_left, Floats{})) * pixels + slack;
        const Floats right = slope * dy_right + half_right - dx, left = slope * dy_left - half_left - dx;
        const Members here = bits(top <= bottom);
        for (int column = 0; column < kColumns; ++column) {
            const Ints reached = (left <= float(column * kBlockWidth + kBlockWidth - 1)) & (right >= float(column * kBlockWidth));
            stage.painters[row * kColumns + column] |= (here & bits(reached)) << first;
        }
    }
}

// Stages `count` Gaussians, sixteen at the most. Lanes beyond keep what an earlier stage left there.
SCOUP_INLINE void stage_gaussians(const Tile& tile, const uint32_t* slots, int count, Stage& stage) {
    for (int i = 0; i < count; ++i) {
        const Projected& p = tile.projected[slots[i]];
        const double dx = tile.x + 0.5 - p.x, dy = tile.y + 0.5 - p.y;
        stage.u[i] = p.ku * float(dx - p.slope * dy);
        stage.dx[i] = float(dx), stage.dy[i] = float(dy), stage.slope[i] = float(p.slope);
        stage.ku[i] = p.ku, stage.kv[i] = p.kv, stage.peak[i] = p.peak, stage.tip[i] = p.tip;
        stage.reach[i] = p.reach, stage.rise[i] = p.rise, stage.pixels[i] = p.pixels;
        stage.slot[i] = slots[i];
    }
    for (int block = 0; block < kBlocks; ++block) stage.painters[block] = 0;
    for (int first = 0; first < count; first += kLanes) find_painters(stage, first);
    const Members staged = (Members{1} << count) - 1;
    for (int block = 0; block < kBlocks; ++block) stage.painters[block] &= staged;
}

// Which blocks each of a stage's Gaussians reaches.
SCOUP_INLINE void find_blocks(const Stage& stage, Blocks reached[kStage]) {
    constexpr int kHalf = 32;  // bits of a lane
    for (int first = 0; first < kStage; first += kLanes)
        for (int half = 0; half < kBlocks; half += kHalf) {
            Ints found{};
            for (int b = 0; b < kHalf && half + b < kBlocks; ++b)
                found |= mask_of(stage.painters[half + b] >> first) & int32_t(1u << b);
            for (int lane = 0; lane < kLanes; ++lane)
                reached[first + lane] = (half == 0 ? 0 : reached[first + lane]) | Blocks{uint32_t(found[lane])} << half;
        }
}

// What is left of the light at a tile's pixels.
struct Transmittance {
    Floats running[kBlocks];  // 0 once a pixel is finished, and outside the image
    Floats last[kBlocks];     // the last one of at least the bound: the final transmittance

    SCOUP_INLINE explicit Transmittance(const Tile& tile) {
        for (int block = 0; block < kBlocks; ++block)
            for (int lane = 0; lane < kLanes; ++lane) {
                const bool inside = tile.x + block_x(block) + lane_x(lane) < tile.width &&
                                    tile.y + block_y(block) + lane_y(lane) < tile.height;
                running[block][lane] = inside ? 1.0f : 0.0f;
                last[block][lane] = 1.0f;
            }
    }

    SCOUP_INLINE Blocks unfinished() const {
        Blocks found = 0;
        for (int block = 0; block < kBlocks; ++block)
            if (any(running[block] > 0.0f)) found |= Blocks{1} << block;
        return found;
    }
};

// Pixel coordinates of a block's lanes, from the first of the tile.
struct BlockPixels {
    Floats x, y;

    SCOUP_INLINE BlockPixels() = default;
    SCOUP_INLINE explicit BlockPixels(int block) {
        for (int lane = 0; lane < kLanes; ++lane) x[lane] = float(lane_x(lane)), y[lane] = float(lane_y(lane));
        x += float(block_x(block));
        y += float(block_y(block));
    }
};

// alpha of Gaussian i of a stage in a block, 0 where it is under 1/255.
SCOUP_INLINE Floats alpha_of(const Tile& tile, const Stage& stage, int i, const BlockPixels& pixels) {
    const Floats u = pixels.x * stage.ku[i] - (pixels.y * stage.skew[i] - stage.u[i]);
    const Floats v = pixels.y * stage.kv[i] + stage.v[i];
    const Floats exponent = stage.peak[i] - u * u - v * v;
    const Floats alpha = exp2(exponent);
    return only(exponent >= kLog2AlphaMin, smaller(alpha, all(tile.alpha_max)));
}

// Stages the Gaussians of a tile front to back, sixteen at a time, and calls paint(stage, count) for each stage until it
// returns false: all pixels are finished. The sink is told:
//   begin(stage, count)  these Gaussians come next
//   end(stage, count)    the stage is done
//   soon(p)              this Gaussian comes in the next stage: a chance to prefetch what belongs to it
template <class Sink, class Paint>
SCOUP_INLINE void for_stages(const Tile& tile, Sink& sink, const Paint& paint) {
    Stage stage{};
    bool going_on = true;
    for (int64_t first = 0; first < tile.count && going_on; first += kStage) {
        const int64_t left = tile.count - first;
        const int count = int(left < kStage ? left : kStage);
        for (int64_t i = kStage; i < left && i < 2 * kStage; ++i)
            __builtin_prefetch(tile.projected + tile.slots[first + i]);
        stage_gaussians(tile, tile.slots + first, count, stage);
        sink.begin(stage, count);
        going_on = paint(stage, count);
        sink.end(stage, count);
        for (int64_t i = kStage; i < left && i < 2 * kStage; ++i) sink.soon(tile.projected[tile.slots[first + i]]);
    }
}

// Walks the Gaussians of a tile, a block after the other within a stage: for what is added up by pixel. The sink is also
// told
//   paint(b, i, e)       Gaussian i of the stage has the weights e in block b; front to back within a block
template <class Sink>
SCOUP_INLINE Transmittance walk_blocks(const Tile& tile, Sink& sink) {
    Transmittance transmittance(tile);
    Blocks unfinished = transmittance.unfinished();
    for_stages(tile, sink, [&](const Stage& stage, int) __attribute__((always_inline)) {
        for (Blocks blocks = unfinished; blocks != 0;) {
            const int block = next(blocks);
            Members painters = stage.painters[block];
            if (painters == 0) continue;
            const BlockPixels pixels(block);
            // A pixel stops before the Gaussian that would take its transmittance below the bound. Transmittance only
            // falls, so that one and all behind it are those after which it is too low: no need to remember.
            Floats before = transmittance.running[block], last = transmittance.last[block];
            while (painters != 0) {
                const int i = next(painters);
                const Floats alpha = alpha_of(tile, stage, i, pixels);
                const Floats after = before - alpha * before;
                const Ints drawn = after >= tile.keep;
                sink.paint(block, i, only(drawn, alpha * before));
                last = drawn ? after : last;
                before = after;
            }
            const Ints going_on = before >= tile.keep;
            // Sixteen factors of 0.01 are not enough to make a number subnormal (and slow); a hundred might be.
            transmittance.running[block] = only(going_on, before);
            transmittance.last[block] = last;
            if (!any(going_on)) unfinished &= ~(Blocks{1} << block);
        }
        return unfinished != 0;
    });
    return transmittance;
}

// Walks the Gaussians of a tile one after the other: for what is added up by Gaussian. The sink is also told
//   paint(b, e)                the next Gaussian of the stage has the weights e in block b
//   painted(stage, i, blocks)  it was the i-th of the stage, and these were all its blocks
template <class Sink>
SCOUP_INLINE void walk_gaussians(const Tile& tile, Sink& sink) {
    Transmittance transmittance(tile);
    BlockPixels pixels[kBlocks];
    for (int block = 0; block < kBlocks; ++block) pixels[block] = BlockPixels(block);
    Blocks unfinished = transmittance.unfinished();
    for_stages(tile, sink, [&](const Stage& stage, int count) __attribute__((always_inline)) {
        Blocks reached[kStage];
        find_blocks(stage, reached);
        for (int i = 0; i < count; ++i) {
            const Blocks blocks = reached[i] & unfinished;
            for (Blocks left = blocks; left != 0;) {
                const int block = next(left);
                const Floats before = transmittance.running[block];
                const Floats alpha = alpha_of(tile, stage, i, pixels[block]);
                const Floats after = before - alpha * before;
                const Ints drawn = after >= tile.keep;
                transmittance.running[block] = only(drawn, after);
                sink.paint(block, only(drawn, alpha * before));
            }
            sink.painted(stage, i, blocks);
        }
        unfinished = transmittance.unfinished();
        return unfinished != 0;
    });
}

}  // namespace
}  // namespace scoup::SCOUP_ISA
