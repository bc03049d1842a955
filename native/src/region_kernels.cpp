#include "region_records.h"
#include "walk.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr int kPixels = kTile * kTile;
constexpr int kWords = kPixels / 64;

// A set of a tile's combinations: there are at most as many as pixels.
struct CombinationSet {
    uint64_t words[kWords];
};

// Where a tile's combinations of regions lie.
class TileRegions {
  public:
    int count = 0;  // combinations, in the order of pixels within blocks
    int words = 0;  // words of a set of them that are in use

    // Each block holds a few combinations, each in some of its lanes.
    CombinationSet in_block[kBlocks];
    Blocks blocks_of[kPixels];            // of each combination
    uint16_t part[kPixels][kBlocks];      // of each combination in each of its blocks, a place in `lanes`
    Ints lanes[kPixels];
    Blocks pure = 0;  // blocks all of whose lanes, or all that lie inside the image, have the same combination
    bool whole = true;  // all pixels of the tile that lie inside the image have the same combination

    int32_t numbers[kPixels];  // in the whole view, of each combination of the tile

    SCOUP_INLINE TileRegions(const Tile& tile, const CombinationMap& map) {
        __builtin_memset(table_, 0xff, sizeof table_);
        int parts = 0;
        for (int block = 0; block < kBlocks; ++block) {
            in_block[block] = {};
            int16_t of_lane[kLanes];
            int empty = 0;
            for (int lane = 0; lane < kLanes; ++lane)
                of_lane[lane] = place_of(tile, map, tile.x + block_x(block) + lane_x(lane),
                                         tile.y + block_y(block) + lane_y(lane));
            const int parts_before = parts;
            for (int lane = 0; lane < kLanes; ++lane) {
                const int16_t here = of_lane[lane];
                empty += here == kNone;
                if (here < 0) continue;
                Ints same{};
                for (int other = 0; other < kLanes; ++other) {
                    if (of_lane[other] != here) continue;
                    same[other] = -1;
                    of_lane[other] = kTaken;
                }
                blocks_of[here] |= Blocks{1} << block;
                part[here][block] = uint16_t(parts);
                lanes[parts++] = same;
                in_block[block].words[here / 64] |= uint64_t{1} << (here % 64);
            }
            if (empty == 0 && parts == parts_before + 1) pure |= Blocks{1} << block;
            if (empty != 0) whole = false;
        }
        words = (count + 63) / 64;
        whole &= count == 1;
    }

  private:
    static constexpr int16_t kNone = -1, kOutside = -2, kTaken = -3;

    // The place of a pixel's combination among the tile's; kNone where no level has a region.
    SCOUP_INLINE int16_t place_of(const Tile& tile, const CombinationMap& map, int x, int y) {
        if (x >= tile.width || y >= tile.height) return kOutside;
        const int32_t number = map.numbers[int64_t(y) * map.width + x];
        if (number < 0) return kNone;
        if (last_ >= 0 && numbers[last_] == number) return int16_t(last_);
        for (uint32_t slot = uint32_t(number) * 0x9e3779b1u >> 23;; slot = (slot + 1) % kTable) {
            int found = table_[slot];
            if (found < 0) {
                found = count++;
                table_[slot] = int16_t(found);
                numbers[found] = number;
                blocks_of[found] = 0;
            } else if (numbers[found] != number) {
                continue;
            }
            last_ = found;
            return int16_t(found);
        }
    }

    static constexpr uint32_t kTable = 512;  // 9 bits of hash, twice as many places as combinations
    int16_t table_[kTable];
    int last_ = -1;
};

// Written always, kept only if there is something: cheaper than a branch.
SCOUP_INLINE void write(Records& out, uint32_t id, int32_t number, float total) {
    out.records[out.count] = {id, number, total};
    out.count += total > 0;
}

// Adds up each Gaussian's weights over a tile of one combination, and writes a record of each sum.
class WholeTileSink {
  public:
    SCOUP_INLINE WholeTileSink(int32_t number, const Projected* projected, Records& out)
        : number_(number), projected_(projected), out_(out) {}

    SCOUP_INLINE void begin(const Stage&, int) {
        for (int i = 0; i < kStage; ++i) totals_[i] = Floats{};
    }
    SCOUP_INLINE void paint(int, int i, Floats weight) { totals_[i] += weight; }
    SCOUP_INLINE void end(const Stage& stage, int count) {
        if (__builtin_expect(out_.count + count > out_.capacity, 0)) out_.reserve(out_, count);
        for (int i = 0; i < count; ++i) write(out_, projected_[stage.slot[i]].id, number_, sum(totals_[i]));
    }
    SCOUP_INLINE void soon(const Projected&) {}

  private:
    const int32_t number_;
    const Projected* projected_;
    Records& out_;
    Floats totals_[kStage];
};

// Adds up each Gaussian's weights over the lanes of each combination, and writes a record of each sum.
class RecordSink {
  public:
    SCOUP_INLINE RecordSink(const TileRegions& regions, const Projected* projected, Records& out)
        : regions_(regions), projected_(projected), out_(out) {}

    SCOUP_INLINE void begin(const Stage&, int) {
        for (int i = 0; i < kStage; ++i) painted_[i] = 0;
    }
    SCOUP_INLINE void paint(int block, int i, Floats weight) {
        weights_[i][block] = weight;
        painted_[i] |= Blocks{1} << block;
    }

    SCOUP_INLINE void end(const Stage& stage, int count) {
        if (__builtin_expect(out_.count + count * regions_.count > out_.capacity, 0))
            out_.reserve(out_, count * regions_.count);
        for (int i = 0; i < count; ++i) {
            if (painted_[i] == 0) continue;
            const uint32_t id = projected_[stage.slot[i]].id;
            if (regions_.words == 1)
                record<1>(id, painted_[i], weights_[i]);
            else
                record<kWords>(id, painted_[i], weights_[i]);
        }
    }

    SCOUP_INLINE void soon(const Projected&) {}

  private:
    template <int Words>
    SCOUP_INLINE void record(uint32_t id, Blocks painted, const Floats* weights) {
        uint64_t touched[Words] = {};
        for (Blocks blocks = painted; blocks != 0;) {
            const int block = next(blocks);
            for (int w = 0; w < Words; ++w) touched[w] |= regions_.in_block[block].words[w];
        }
        // Most Gaussians lie inside one combination.
        if (Words == 1 && (touched[0] & (touched[0] - 1)) == 0 && (painted & ~regions_.pure) == 0) {
            Floats total{};
            while (painted != 0) total += weights[next(painted)];
            return write(out_, id, regions_.numbers[__builtin_ctzll(touched[0])], sum(total));
        }
        for (int w = 0; w < Words; ++w)
            while (touched[w] != 0) {
                const int c = 64 * w + next(touched[w]);
                Floats total{};
                for (Blocks blocks = painted & regions_.blocks_of[c]; blocks != 0;) {
                    const int block = next(blocks);
                    total += only(regions_.lanes[regions_.part[c][block]], weights[block]);
                }
                write(out_, id, regions_.numbers[c], sum(total));
            }
    }

    const TileRegions& regions_;
    const Projected* projected_;
    Records& out_;
    Blocks painted_[kStage];
    Floats weights_[kStage][kBlocks];
};

void collect(const Tile& tile, const CombinationMap& map, Records& out) {
    if (tile.count == 0) return;
    const TileRegions regions(tile, map);
    if (regions.count == 0) return;
    if (regions.whole) {
        WholeTileSink sink(regions.numbers[0], tile.projected, out);
        walk_tile(tile, sink);
        return;
    }
    RecordSink sink(regions, tile.projected, out);
    walk_tile(tile, sink);
}

}  // namespace

const RegionKernels region_kernels = {collect};

}  // namespace scoup::SCOUP_ISA
