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
    uint16_t lanes[kPixels][kBlocks];  // bits, of each combination in each block
    Blocks pure = 0;  // blocks all of whose lanes, or all that lie inside the image, have the same combination
    bool whole = true;  // all pixels of the tile that lie inside the image have the same combination

    int32_t numbers[kPixels];  // in the whole view, of each combination of the tile

    SCOUP_INLINE TileRegions(const Tile& tile, const CombinationMap& map) {
        __builtin_memset(table_, 0xff, sizeof table_);
        for (int block = 0; block < kBlocks; ++block) {
            in_block[block] = {};
            Ints numbers_here{};
            uint32_t left = read(tile, map, tile.x + block_x(block), tile.y + block_y(block), numbers_here);
            int parts = 0;
            bool empty = false;
            while (left != 0) {
                const int32_t number = numbers_here[__builtin_ctz(left)];
                const uint32_t same = bits(numbers_here == number) & left;
                left &= ~same;
                empty |= number < 0;
                if (number < 0) continue;
                const int here = place_of(number);
                lanes[here][block] = uint16_t(same);
                in_block[block].words[here / 64] |= uint64_t{1} << (here % 64);
                ++parts;
            }
            if (!empty && parts == 1) pure |= Blocks{1} << block;
            whole &= !empty;
        }
        words = (count + 63) / 64;
        whole &= count == 1;
    }

  private:
    // Reads the combinations of a block's pixels by their numbers in the view, below 0 where no level has a region. Returns
    // the lanes that lie inside the image.
    static SCOUP_INLINE uint32_t read(const Tile& tile, const CombinationMap& map, int x, int y, Ints& found) {
        const int32_t* const first = map.numbers + int64_t(y) * map.width + x;
        if (x + kBlockWidth <= tile.width && y + kBlockHeight <= tile.height) {
            int32_t rows[kLanes];
            for (int row = 0; row < kBlockHeight; ++row)
                __builtin_memcpy(rows + row * kBlockWidth, first + row * int64_t(map.width), kBlockWidth * sizeof(int32_t));
            __builtin_memcpy(&found, rows, sizeof found);
            return (1u << kLanes) - 1;
        }
        uint32_t inside = 0;
        for (int lane = 0; lane < kLanes; ++lane) {
            if (x + lane_x(lane) >= tile.width || y + lane_y(lane) >= tile.height) continue;
            found[lane] = first[int64_t(lane_y(lane)) * map.width + lane_x(lane)];
            inside |= 1u << lane;
        }
        return inside;
    }

    // The place of a combination among the tile's.
    SCOUP_INLINE int place_of(int32_t number) {
        if (last_ >= 0 && numbers[last_] == number) return last_;
        for (uint32_t slot = uint32_t(number) * 0x9e3779b1u >> 23;; slot = (slot + 1) % kTable) {
            int found = table_[slot];
            if (found < 0) {
                found = count++;
                table_[slot] = int16_t(found);
                numbers[found] = number;
                for (int block = 0; block < kBlocks; ++block) lanes[found][block] = 0;
            } else if (numbers[found] != number) {
                continue;
            }
            return last_ = found;
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

    SCOUP_INLINE void begin(const Stage&, int count) {
        if (__builtin_expect(out_.count + count > out_.capacity, 0)) out_.reserve(out_, count);
    }
    SCOUP_INLINE void paint(int, Floats weight) { total_ += weight; }
    SCOUP_INLINE void painted(const Stage& stage, int i, Blocks) {
        write(out_, projected_[stage.slot[i]].id, number_, sum(total_));
        total_ = Floats{};
    }
    SCOUP_INLINE void end(const Stage&, int) {}
    SCOUP_INLINE void soon(const Projected&) {}

  private:
    const int32_t number_;
    const Projected* projected_;
    Records& out_;
    Floats total_{};
};

// Adds up each Gaussian's weights over the lanes of each combination, and writes a record of each sum.
class RecordSink {
  public:
    SCOUP_INLINE RecordSink(const TileRegions& regions, const Projected* projected, Records& out)
        : regions_(regions), projected_(projected), out_(out) {}

    SCOUP_INLINE void begin(const Stage&, int count) {
        if (__builtin_expect(out_.count + count * regions_.count > out_.capacity, 0))
            out_.reserve(out_, count * regions_.count);
    }
    SCOUP_INLINE void paint(int block, Floats weight) {
        weights_[block] = weight;
        total_ += weight;
        touched_ |= regions_.in_block[block].words[0];
    }
    SCOUP_INLINE void painted(const Stage& stage, int i, Blocks blocks) {
        if (blocks == 0) return;
        const uint32_t id = projected_[stage.slot[i]].id;
        regions_.words == 1 ? record_few(id, blocks) : record_many(id, blocks);
        total_ = Floats{};
        touched_ = 0;
    }
    SCOUP_INLINE void end(const Stage&, int) {}
    SCOUP_INLINE void soon(const Projected&) {}

  private:
    SCOUP_INLINE Floats weights_of(int combination, int block) const {
        return only(mask_of(regions_.lanes[combination][block]), weights_[block]);
    }

    SCOUP_INLINE void record_few(uint32_t id, Blocks painted) {
        // Most Gaussians lie inside one combination.
        if ((touched_ & (touched_ - 1)) == 0 && (painted & ~regions_.pure) == 0)
            return write(out_, id, regions_.numbers[__builtin_ctzll(touched_)], sum(total_));
        for (uint64_t set = touched_; set != 0;) {
            const int c = next(set);
            Floats total{};
            for (Blocks blocks = painted; blocks != 0;) total += weights_of(c, next(blocks));
            write(out_, id, regions_.numbers[c], sum(total));
        }
    }

    // Looks only at the combinations of each block: not all of many for each of many blocks.
    SCOUP_INLINE void record_many(uint32_t id, Blocks painted) {
        CombinationSet touched{};
        for (Blocks blocks = painted; blocks != 0;) {
            const int block = next(blocks);
            for (int w = 0; w < kWords; ++w)
                for (uint64_t set = regions_.in_block[block].words[w]; set != 0;) {
                    const int bit = next(set), c = 64 * w + bit;
                    totals_[c] = (touched.words[w] >> bit & 1 ? totals_[c] : Floats{}) + weights_of(c, block);
                    touched.words[w] |= uint64_t{1} << bit;
                }
        }
        for (int w = 0; w < kWords; ++w)
            for (uint64_t set = touched.words[w]; set != 0;) {
                const int c = 64 * w + next(set);
                write(out_, id, regions_.numbers[c], sum(totals_[c]));
            }
    }

    const TileRegions& regions_;
    const Projected* projected_;
    Records& out_;
    Floats total_{};
    uint64_t touched_ = 0;
    Floats weights_[kBlocks];
    Floats totals_[kPixels];
};

void collect(const Tile& tile, const CombinationMap& map, Records& out) {
    if (tile.count == 0) return;
    const TileRegions regions(tile, map);
    if (regions.count == 0) return;
    if (regions.whole) {
        WholeTileSink sink(regions.numbers[0], tile.projected, out);
        walk_gaussians(tile, sink);
        return;
    }
    RecordSink sink(regions, tile.projected, out);
    walk_gaussians(tile, sink);
}

}  // namespace

const RegionKernels region_kernels = {collect};

}  // namespace scoup::SCOUP_ISA
