#include "channel_kernels.h"

#include "walk.h"

namespace scoup::SCOUP_ISA {
namespace {

// Walks a tile and writes its pixels that lie inside the image.
template <class Sink>
SCOUP_INLINE void render_with(Sink& sink, const Tile& tile, const ChannelImage& out, int channels) {
    const Transmittance transmittance = walk_blocks(tile, sink);
    for (int block = 0; block < kBlocks; ++block)
        for (int lane = 0; lane < kLanes; ++lane) {
            const int x = tile.x + block_x(block) + lane_x(lane), y = tile.y + block_y(block) + lane_y(lane);
            if (x >= tile.width || y >= tile.height) continue;
            const int64_t pixel = int64_t(y) * tile.width + x;
            for (int c = 0; c < channels; ++c) out.image[pixel * channels + c] = sink.sum(c, block)[lane];
            if (out.alpha != nullptr) out.alpha[pixel] = 1.0f - transmittance.last[block][lane];
        }
}

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

    SCOUP_INLINE const Floats& sum(int channel, int block) const { return sums_[channel * kBlocks + block]; }

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

// So few channels that adding each weight where it comes from costs less than keeping it.
template <int Count>
class FewChannelsSink {
  public:
    SCOUP_INLINE FewChannelsSink(const ChannelImage& out, const Projected* projected) : out_(out), projected_(projected) {
        for (int block = 0; block < kBlocks; ++block)
            for (int c = 0; c < Count; ++c) sums_[block][c] = Floats{};
    }

    SCOUP_INLINE void begin(const Stage& stage, int count) {
        for (int i = 0; i < count; ++i) {
            const float* values = out_.values + int64_t(projected_[stage.slot[i]].id) * Count;
            for (int c = 0; c < Count; ++c) values_[i][c] = values[c];
        }
    }
    SCOUP_INLINE void paint(int block, int i, Floats weight) {
        for (int c = 0; c < Count; ++c) sums_[block][c] += weight * values_[i][c];
    }
    SCOUP_INLINE void end(const Stage&, int) {}
    SCOUP_INLINE void soon(const Projected& p) const { __builtin_prefetch(out_.values + int64_t(p.id) * Count); }

    SCOUP_INLINE const Floats& sum(int channel, int block) const { return sums_[block][channel]; }

  private:
    const ChannelImage& out_;
    const Projected* projected_;
    float values_[kStage][Count];
    Floats sums_[kBlocks][Count];
};

template <int Count>
void render_few(const Tile& tile, const ChannelImage& out) {
    FewChannelsSink<Count> sink(out, tile.projected);
    render_with(sink, tile, out, Count);
}

void render(const Tile& tile, const ChannelImage& out, float* scratch) {
    switch (out.channels) {
        case 1: return render_few<1>(tile, out);
        case 2: return render_few<2>(tile, out);
        case 3: return render_few<3>(tile, out);
        default: break;
    }
    ChannelSink sink(out, tile.projected, reinterpret_cast<Floats*>(scratch));
    render_with(sink, tile, out, out.channels);
}

}  // namespace

const ChannelKernels channel_kernels = {render};

}  // namespace scoup::SCOUP_ISA
