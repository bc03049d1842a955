"""A kernel that splits blending weights as the products with codes do. Imports triton."""

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.triton.kernels.blending import WEIGHT_SCALE, halves_of_weights


@triton.jit
def split_kernel(values, high_out, low_out, COUNT: tl.constexpr):
    """``values`` [COUNT] float32 as ``high_out`` + ``low_out`` [COUNT] float32, each exact."""
    place = tl.arange(0, COUNT)
    high, low = halves_of_weights(tl.load(values + place) * WEIGHT_SCALE)
    tl.store(high_out + place, high.to(tl.float32) * (1.0 / WEIGHT_SCALE))
    tl.store(low_out + place, low.to(tl.float32) * (1.0 / WEIGHT_SCALE))
