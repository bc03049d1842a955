#include "channel_kernels.h"

#include "walk.h"

namespace scoup::SCOUP_ISA {
namespace {

// Keeps the weights of a stage, then adds weights times values for each block: a small matrix product, in which a sum
// is loaded and stored once for the stage and not once for each Gaussian.
class ChannelSink {
  public:
    SCOUP_INLINE ChannelSink(const ChannelImage& out, const Projected* projected, Floats* sums)
        : out_(out), projected_(projected), sums_(sums) {
        for (int64_t s = 0; s < int64_t(out.channels) * kBlocks; ++s) sums_[s] = Floats{};
    }

    SCOUP_INLINE void begin(const Stage& stage, int count) {
        for (int i = 0; i < count; ++i)
            values_[i] = out_.values + int64_t(projected_[stage.slot[i]].id) * out_.channels;
    }
    SCOUP_INLINE void paint(int block, int i, Floats weight) {
        weights_[block][i] = weight;
        painters_[block] |= Members{1} << i;
    }
    SCOUP_INLINE void end(const Stage&, int) {
        for (int block = 0; block < kBlocks; ++block) {
            if (painters_[block] == 0) continue;
            for (int channel = 0; channel < out_.channels; channel += 8) add(block, channel);
            painters_[block] = 0;
        }
    }

    SCOUP_INLINE void soon(const Projected& p) const { __builtin_prefetch(out_.values + int64_t(p.id) * out_.channels); }

    SCOUP_INLINE void write(const Tile& tile, const Transmittance& transmittance) const {
        for (int block = 0; block < kBlocks; ++block)
            for (int lane = 0; lane < kLanes; ++lane) {
                const int x = tile.x + block_x(block) + lane_x(lane), y = tile.y + block_y(block) + lane_y(lane);
                if (x >= tile.width || y >= tile.height) continue;
                const int64_t pixel = int64_t(y) * tile.width + x;
                float* image = out_.image + pixel * out_.channels;
                for (int c = 0; c < out_.channels; ++c) image[c] = sums_[c * kBlocks + block][lane];
                out_.alpha[pixel] = 1.0f - transmittance.last[block][lane];
            }
    }

  private:
    SCOUP_INLINE void add(int block, int channel) {
        switch (out_.channels - channel) {
            case 1: return add_some<1>(block, channel);
            case 2: return add_some<2>(block, channel);
            case 3: return add_some<3>(block, channel);
            case 4: return add_some<4>(block, channel);
            case 5: return add_some<5>(block, channel);
            case 6: return add_some<6>(block, channel);
            case 7: return add_some<7>(block, channel);
            default: return add_some<8>(block, channel);
        }
    }

    // `Count` channels at once, in registers.
    template <int Count>
    SCOUP_INLINE void add_some(int block, int channel) {
        Floats total[Count];
        for (int c = 0; c < Count; ++c) total[c] = sums_[(channel + c) * kBlocks + block];
        for (Members left = painters_[block]; left != 0;) {
            const int i = next(left);
            const float* values = values_[i] + channel;
            for (int c = 0; c < Count; ++c) total[c] += weights_[block][i] * values[c];
        }
        for (int c = 0; c < Count; ++c) sums_[(channel + c) * kBlocks + block] = total[c];
    }

    const ChannelImage& out_;
    const Projected* projected_;
    Floats* sums_;  // [channels, blocks]
    const float* values_[kStage];
    Members painters_[kBlocks] = {};  // who painted in a block
    Floats weights_[kBlocks][kStage];
};

void render(const Tile& tile, const ChannelImage& out, float* scratch) {
    ChannelSink sink(out, tile.projected, reinterpret_cast<Floats*>(scratch));
    const Transmittance transmittance = walk_tile(tile, sink);
    sink.write(tile, transmittance);
}

}  // namespace

const ChannelKernels channel_kernels = {render};

}  // namespace scoup::SCOUP_ISA
