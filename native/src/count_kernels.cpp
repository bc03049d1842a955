#include "count_kernels.h"

#include "walk.h"

namespace scoup::SCOUP_ISA {
namespace {

struct Counter {
    TileCounts counts{};
    SCOUP_INLINE void begin(const Stage&, int count) { counts.pairs += count; }
    SCOUP_INLINE void paint(int, int, Floats weight) {
        ++counts.blocks;
        for (int lane = 0; lane < kLanes; ++lane) counts.evaluations += weight[lane] > 0;
    }
    SCOUP_INLINE void end(const Stage&, int) {}
    SCOUP_INLINE void soon(const Projected&) {}
};

TileCounts count(const Tile& tile) {
    Counter counter;
    walk_blocks(tile, counter);
    return counter.counts;
}

}  // namespace

const CountKernels count_kernels = {kLanes, count};

}  // namespace scoup::SCOUP_ISA
