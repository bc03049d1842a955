#include "scene_kernels.h"

#include "doubles.h"

namespace scoup::SCOUP_ISA {
namespace {

static_assert(kBlockRows % kGroup == 0);

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

SCOUP_INLINE Doubles absolute(Doubles x) { return (Doubles)((Longs)x & 0x7fffffffffffffffLL); }

void make_block(const Scene& scene, int64_t first, SceneBlock& block) {
    alignas(64) float opacity[kBlockRows];
    const int64_t left = scene.count - first;
    for (int i = 0; i < kBlockRows; ++i) {
        const int64_t row = first + (i < left ? i : 0);
        for (int c = 0; c < 3; ++c) block.mean[c][i] = scene.means[3 * row + c];
        for (int c = 0; c < 4; ++c) block.quat[c][i] = scene.quats[4 * row + c];
        for (int c = 0; c < 3; ++c) block.scale[c][i] = scene.scales[3 * row + c];
        opacity[i] = i < left ? scene.opacities[row] : 0.0f;
    }
    for (int at = 0; at < kBlockRows; at += kGroup) {
        Doubles poison{}, norm2{}, extent{};  // poison: 0 where everything is finite, not a number elsewhere
        for (int c = 0; c < 3; ++c) {
            const Doubles scale = doubles(block.scale[c] + at);
            poison += doubles(block.mean[c] + at) * 0 + scale * 0;
            extent = at_least(absolute(scale), extent);
        }
        for (int c = 0; c < 4; ++c) {
            const Doubles q = doubles(block.quat[c] + at);
            poison += q * 0;
            norm2 += q * q;
        }
        const Doubles o = doubles(opacity + at);
        const Longs drawn = (norm2 > 0) & (o >= double(float(kAlphaMin))) & (poison == 0);
        // An opacity of infinity is drawn as 1.
        store_singles(block.peak + at, log2(drawn ? at_most(o, 1 + Doubles{}) : 1 + Doubles{}));
        store_singles(block.extent + at, drawn ? extent : __builtin_nan("") + Doubles{});
    }
}

void make_blocks(const Scene& scene, int64_t first, int64_t last, SceneBlock* out) {
    for (int64_t block = first; block < last; ++block) make_block(scene, block * kBlockRows, *out++);
}

}  // namespace

const SceneKernels scene_kernels = {make_blocks};

}  // namespace scoup::SCOUP_ISA
