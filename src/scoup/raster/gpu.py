"""The rasteriser on a GPU: Triton kernels behind the same functions as ``reference``.

Nothing here is imported before tensors on a GPU are rasterised. Kernels are compiled when first used (seconds, once
for each machine) and do not depend on the number of Gaussians or the image size. The result does not depend on which
program runs first: same input, same bytes. Code indices are not checked here, which would take as long as a picture;
an index beyond the codebook paints nothing.
"""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from scoup.agreement import Agreement
from scoup.codes import SparseCodes, add_codes, cosines_from_products, full_products
from scoup.raster.gpu_regions import add_votes, triplets
from scoup.raster.gpu_view import FUSED, TILE, GpuView
from scoup.raster.gpu_view import look as look
from scoup.raster.kernels.rendering import channels_kernel, codes_kernel, products_kernel

PREPARES = False  # rows in another order have not been seen to pay here
MOST_ATOMS = 256  # coefficients of a pixel that stay on the chip
_CHUNK = 16  # Gaussians at a time; tensor cores want no fewer
WARPS = 8  # of a program that renders
_COEFFICIENTS = 96 * 32 * WARPS  # of a program: 96 registers of each thread


def region_weights(view: GpuView, labels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_weights``."""
    with torch.cuda.device_of(view.records):
        return triplets(view, labels.to(view.device))


class Uplift:
    """See ``raster.Uplift``. Nothing is ever pending.

    Accumulators may also be on the CPU, where they are too large for the GPU: region sums are then brought there.
    """

    def __init__(self, out: Tensor, agreement: Agreement | None = None) -> None:
        self._out = out
        self._agreement = agreement
        self.intact = True
        self.n_taken = 0

    def add(self, view: GpuView, labels: Tensor, codes: list[SparseCodes]) -> None:
        labels = labels.to(view.device)
        if self._out.device != view.device:
            self._add_triplets(view, labels, codes)
            return
        self.intact = False
        with torch.cuda.device_of(view.records):
            add_votes(view, labels, codes, self._agreement, self._out)
        self.n_taken += 1
        self.intact = True

    def _add_triplets(self, view: GpuView, labels: Tensor, codes: list[SparseCodes]) -> None:
        stride = int(labels.max()) + 1 if labels.numel() else 0
        device = self._out.device
        gaussian, key, weight = (part.to(device) for part in region_weights(view, labels))
        here = [level.to(device) for level in codes]
        if self._agreement is not None:
            weight = weight * self._agreement.factors(gaussian, key, stride, here)
        self.intact = False
        add_codes(gaussian, key, weight, stride, here, self._out)
        self.n_taken += 1
        self.intact = True

    def flush(self) -> None:
        pass


def render_channels(view: GpuView, values: Tensor) -> tuple[Tensor, Tensor]:
    """See ``raster.render_channels``."""
    channels, device = values.shape[1], view.device
    values = values.to(device).contiguous()
    image = torch.empty(view.height, view.width, channels, device=device)
    alpha = torch.empty(view.height, view.width, device=device)
    block = min(64, max(16, triton.next_power_of_2(max(1, channels))))
    pixels = 128 if block == 64 else TILE * TILE
    with torch.cuda.device_of(values):
        grid = (view.n_tiles * (TILE * TILE // pixels), max(1, triton.cdiv(channels, block)))
        channels_kernel[grid](
            *_lists(view), values, image, alpha, *_size(view), channels, *_bounds(view),
            **_constants(view, values), PIXELS=pixels, CHANNELS=block, num_warps=WARPS,
        )  # fmt: skip
    return image, alpha


def render_codes(view: GpuView, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """See ``raster.render_codes``."""
    levels, k = indices.shape[1:]
    shape = (levels, view.height, view.width, n_atoms)
    if k == 0 or math.prod(shape) == 0:
        return torch.zeros(shape, device=view.device)
    out = torch.empty(shape, device=view.device)  # every number is written
    table = (indices.to(view.device).contiguous(), weights.to(view.device).contiguous())
    blocks = code_blocks(levels, min(n_atoms, MOST_ATOMS))
    with torch.cuda.device_of(out):
        for first in range(0, levels, blocks.levels):
            grid = (view.n_tiles * (TILE * TILE // blocks.pixels), triton.cdiv(n_atoms, blocks.atoms))
            codes_kernel[grid](
                *_lists(view), *table, out, *_size(view), levels, n_atoms, first, *_bounds(view),
                **_constants(view, weights), PIXELS=blocks.pixels, LEVELS=min(blocks.levels, levels - first), K=k,
                ATOMS=blocks.atoms, num_warps=WARPS,
            )  # fmt: skip
    return out


def render_cosines(
    view: GpuView, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> Tensor:
    """See ``raster.render_cosines``. The coefficients of a tile are used up at once; no map of them is kept."""
    levels, count = len(codebook), len(queries)
    codebook, queries = codebook.to(view.device), queries.to(view.device)
    scores = full_products(codebook, queries)
    shape = (levels, count, view.height, view.width)
    return _render_products(view, indices, weights, codebook, scores, shape, pixels_last=True)


def render_features(view: GpuView, indices: Tensor, weights: Tensor, codebook: Tensor) -> Tensor:
    """See ``raster.render_features``."""
    levels, _, dim = codebook.shape
    codebook = codebook.to(view.device)
    shape = (levels, view.height, view.width, dim)
    return _render_products(view, indices, weights, codebook, codebook, shape, pixels_last=False)


def _render_products(
    view: GpuView,
    indices: Tensor,  # [N, S, K]
    weights: Tensor,  # [N, S, K]
    codebook: Tensor,  # [S, L, D]
    table: Tensor,  # [S, L, C]
    shape: tuple[int, ...],  # of the result
    pixels_last: bool,
) -> Tensor:
    """Coefficients times ``table`` over the norm of the decoded feature."""
    n_atoms, columns = table.shape[1:]
    levels, k = indices.shape[1:]
    if k == 0 or n_atoms == 0 or math.prod(shape) == 0:
        return torch.zeros(shape, device=view.device)
    out = torch.empty(shape, device=view.device)  # every number is written
    grams = full_products(codebook, codebook)
    if n_atoms > MOST_ATOMS:
        return _products_by_level(view, indices, weights, grams, table, out, pixels_last)
    # The quotient stays the same, and entries are within float16.
    scale = grams.amax((1, 2), keepdim=True).clamp(min=torch.finfo(torch.float32).tiny)
    tables = (
        indices.to(view.device).contiguous(),
        weights.to(view.device).contiguous(),
        grams / scale,
        (table / scale.sqrt()).contiguous(),
    )
    blocks = code_blocks(levels, n_atoms)
    at_once = product_columns(blocks, pixels_last)
    with torch.cuda.device_of(out):
        for first in range(0, levels, blocks.levels):
            products_kernel[(view.n_tiles * (TILE * TILE // blocks.pixels),)](
                *_lists(view), *tables, out, *_size(view), levels, n_atoms, columns, first, *_bounds(view),
                **_constants(view, weights), PIXELS=blocks.pixels, LEVELS=min(blocks.levels, levels - first), K=k,
                ATOMS=blocks.atoms, COLUMNS=at_once, PIXELS_LAST=pixels_last,
                TABLE_PRECISION="fp16x3" if view.precision == "tf32x3" else view.products(),
                num_warps=WARPS,
            )  # fmt: skip
    return out


def _products_by_level(
    view: GpuView,
    indices: Tensor,
    weights: Tensor,
    grams: Tensor,
    table: Tensor,
    out: Tensor,
    pixels_last: bool,
) -> Tensor:
    """The slower path for large codebooks: the coefficient map of one level at a time."""
    for level in range(len(table)):
        chosen = slice(level, level + 1)
        codes = render_codes(view, indices[:, chosen], weights[:, chosen], table.shape[1])[0]
        for row, line in enumerate(codes):  # [W, L]
            found = cosines_from_products(line, table[level], grams[level])
            if pixels_last:
                out[level, :, row] = found.T
            else:
                out[level, row] = found
    return out


@dataclass(frozen=True)
class CodeBlocks:
    """What one program renders: so many pixels of a tile, levels, and atoms."""

    pixels: int
    levels: int
    atoms: int


def code_blocks(levels: int, n_atoms: int) -> CodeBlocks:
    """The largest block whose coefficients fit into registers: more pixels share the cost of making a Gaussian's code
    dense, more levels that of its blending weights.
    """
    atoms = max(16, triton.next_power_of_2(n_atoms))
    pixels = 128 if atoms <= 64 else 64 if atoms == 128 else 32
    most = 1 if atoms > 128 else min(4, _COEFFICIENTS // (pixels * atoms))
    passes = triton.cdiv(levels, most)
    return CodeBlocks(pixels, triton.cdiv(levels, passes), atoms)


def product_columns(blocks: CodeBlocks, pixels_last: bool) -> int:
    """Columns that coefficients are multiplied with at a time; twice as many of 256 rows are more than 99 KB."""
    return 16 if pixels_last or blocks.atoms > 128 else 32


def _lists(view: GpuView) -> tuple[Tensor, ...]:
    return view.pair_ids, view.corners, view.records, view.starts


def _size(view: GpuView) -> tuple[int, int, int]:
    return view.width, view.height, view.across


def _bounds(view: GpuView) -> tuple[float, float]:
    return view.preset.alpha_max, view.preset.stop


def _constants(view: GpuView, values: Tensor) -> dict[str, object]:
    """What is compiled in, and how; ``values`` are what is blended."""
    return {
        **FUSED,
        "STOP_INCLUSIVE": view.preset.stop_inclusive,
        "TILE": TILE,
        "CHUNK": _CHUNK,
        # Numbers of float32 may be beyond what float16 can hold.
        "PRECISION": view.products(wide=values.dtype != torch.float16),
    }
