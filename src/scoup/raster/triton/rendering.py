"""The rasteriser on a GPU: Triton kernels behind the same functions as ``reference``.

Nothing here is imported before tensors on a GPU are rasterised. Kernels are compiled when first used (seconds, once
for each machine) and do not depend on the number of Gaussians or the image size. The result does not depend on which
program runs first: same input, same bytes. Code indices are not checked here, which would take as long as a picture;
an index beyond the codebook contributes nothing.
"""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from scoup.raster.combinations import CombinedLabels
from scoup.raster.decoding import cosines_and_norms
from scoup.raster.triton.kernels.blending import LOW_SCALE
from scoup.raster.triton.kernels.channels import channels_kernel
from scoup.raster.triton.kernels.codes import SLOTS, codes_kernel, pack_kernel
from scoup.raster.triton.kernels.products import products_kernel
from scoup.raster.triton.projection import FUSED, TILE, Precision, TritonProjection, product_precision
from scoup.raster.triton.projection import project as project
from scoup.raster.triton.region_sums import region_sums as sum_regions
from scoup.scene import float32_products

PREPARES = False  # reordering showed no benefit
# Coefficients of a pixel that stay on the chip; with more, products leave no registers.
MOST_ATOMS: dict[Precision, int] = {"fp16x3": 256, "tf32x3": 128, "ieee": 64}
# Of a program that renders codes. Hopper's matrix products use four warps; with eight, Triton gives a sum of two
# products two layouts and converts between them.
WARPS = 4
# Columns per product with the coefficients. With 16, ptxas 12.8 (Triton 3.4 to 3.6) reads a descriptor of
# a matrix product from a register that it has not written; twice as many of 256 rows exceed 99 KB.
COLUMNS = 32
_COEFFICIENTS = 128 * 32 * WARPS  # of a program: 128 registers of each thread
_BLOCK = 128


def region_sums(projection: TritonProjection, combined: CombinedLabels) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_sums``."""
    with torch.cuda.device_of(projection.records):
        return sum_regions(projection, combined.map.to(projection.device), len(combined.table))


def render_channels(projection: TritonProjection, values: Tensor) -> tuple[Tensor, Tensor]:
    """See ``raster.render_channels``."""
    channels, device = values.shape[1], projection.device
    values = values.to(device).contiguous()
    image = torch.empty(projection.height, projection.width, channels, device=device)
    alpha = torch.empty(projection.height, projection.width, device=device)
    blocks = channel_blocks(channels)
    with torch.cuda.device_of(values):
        channels_kernel[(projection.n_tiles, max(1, triton.cdiv(channels, blocks.channels)))](
            *_lists(projection), values, image, alpha, *_size(projection), channels, *_bounds(projection),
            **_constants(projection), CHUNK=blocks.chunk, CHANNELS=blocks.channels,
            PRECISION=product_precision(wide=True), num_warps=blocks.warps,
        )  # fmt: skip
    return image, alpha


@dataclass(frozen=True)
class ChannelBlocks:
    """Channels that one program renders, of so many Gaussians at a time, with so many warps."""

    channels: int
    chunk: int
    warps: int


def channel_blocks(channels: int) -> ChannelBlocks:
    """A thread for each pixel where the sums of few channels leave it the registers, else two."""
    return ChannelBlocks(16, 16, 2) if channels <= 16 else ChannelBlocks(64, 16, WARPS)


@dataclass(frozen=True, eq=False)
class PackedCodes:
    """Codes as the kernels read them, see ``kernels.codes.pack_kernel``."""

    words: Tensor  # [N, S, GROUPS * SLOTS] int32, or int64 where ``wide``
    wide: bool  # weights are float32

    @property
    def groups(self) -> int:
        """Number of groups of ``SLOTS`` entries."""
        return self.words.shape[2] // SLOTS.value


def is_wide(weights: Tensor, n_atoms: int) -> bool:
    """Return whether codes are multiplied as float32: numbers of float32 may be beyond what float16 can hold."""
    return weights.dtype != torch.float16 or n_atoms > 2**16


def pack(projection: TritonProjection, indices: Tensor, weights: Tensor, n_atoms: int) -> PackedCodes:
    """[N, S, K] sparse codes, packed."""
    count, levels, k = indices.shape
    wide = is_wide(weights, n_atoms)
    indices, weights = indices.to(projection.device).contiguous(), weights.to(projection.device).contiguous()
    groups = triton.cdiv(k, SLOTS.value)
    shape = count, levels, groups * SLOTS.value
    words = torch.empty(shape, dtype=torch.int64 if wide else torch.int32, device=projection.device)
    pack_kernel[(triton.cdiv(count * levels, _BLOCK),)](
        indices, weights, words, count * levels, n_atoms, K=k, GROUPS=groups, WIDE=wide, BLOCK=_BLOCK, **FUSED
    )  # fmt: skip
    return PackedCodes(words, wide)


def render_codes(projection: TritonProjection, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """See ``raster.render_codes``."""
    levels, k = indices.shape[1:]
    shape = (levels, projection.height, projection.width, n_atoms)
    if 0 in (projection.n_gaussians, k, *shape):
        return torch.zeros(shape, device=projection.device)
    out = torch.empty(shape, device=projection.device)  # every number is written
    with torch.cuda.device_of(out):
        codes = pack(projection, indices, weights, n_atoms)
        blocks = code_blocks(levels, n_atoms, product_precision(codes.wide))
        for first in range(0, levels, blocks.levels):
            codes_kernel[(projection.n_tiles, triton.cdiv(n_atoms, blocks.atoms))](
                *_lists(projection), codes.words, out, *_size(projection), levels, n_atoms, first, *_bounds(projection),
                **_constants(projection), **_of_codes(codes, blocks, levels - first), num_warps=WARPS,
            )  # fmt: skip
    return out


def render_cosines(
    projection: TritonProjection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> Tensor:
    """See ``raster.render_cosines``. No map of coefficients is kept."""
    codebook, queries = codebook.to(projection.device), queries.to(projection.device)
    scores = float32_products(codebook, queries)
    return _render_products(projection, indices, weights, codebook, scores, pixels_last=True)


def render_cosines_and_norms(
    projection: TritonProjection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> tuple[Tensor, Tensor]:
    """See ``raster.render_cosines_and_norms``."""
    count = len(queries)
    codebook, queries = codebook.to(projection.device), queries.to(projection.device)
    scores = float32_products(codebook, queries)
    # One column more, of ones: the sum of the coefficients by the norm. The sum itself is a render of channels.
    table = torch.cat([scores, scores.new_ones(*scores.shape[:2], 1)], 2)
    products = _render_products(projection, indices, weights, codebook, table, pixels_last=True)
    device = projection.device
    counting = indices.to(device).long() < codebook.shape[1]
    of_codes = (weights.to(device).float() * counting).sum(-1)
    sums = render_channels(projection, of_codes)[0].permute(2, 0, 1)  # [S, H, W]
    shares = products[:, count]
    return products[:, :count].contiguous(), torch.where(shares > 0, sums / shares, 0.0)


def render_features(
    projection: TritonProjection, indices: Tensor, weights: Tensor, codebook: Tensor
) -> Tensor:
    """See ``raster.render_features``."""
    codebook = codebook.to(projection.device)
    return _render_products(projection, indices, weights, codebook, codebook, pixels_last=False)


def _render_products(
    projection: TritonProjection,
    indices: Tensor,  # [N, S, K]
    weights: Tensor,  # [N, S, K]
    codebook: Tensor,  # [S, L, D]
    table: Tensor,  # [S, L, C]
    pixels_last: bool,
) -> Tensor:
    """Coefficients times ``table`` over the norm of the decoded feature, [S, C, H, W] or [S, H, W, C]."""
    n_atoms, columns = table.shape[1:]
    levels, k = indices.shape[1:]
    size = projection.height, projection.width
    shape = (levels, columns, *size) if pixels_last else (levels, *size, columns)
    if 0 in (projection.n_gaussians, k, n_atoms, *shape):
        return torch.zeros(shape, device=projection.device)
    out = torch.empty(shape, device=projection.device)  # every number is written
    grams = float32_products(codebook, codebook)
    of_codes = product_precision(is_wide(weights, n_atoms))
    if n_atoms > most_atoms_of_products(of_codes):
        return _products_by_level(projection, indices, weights, grams, table, out, pixels_last)
    # The quotient stays the same, and entries are within float16.
    scale = grams.amax((1, 2), keepdim=True).clamp(min=torch.finfo(torch.float32).tiny)
    tables = halves(grams / scale), halves(table / scale.sqrt())
    blocks = code_blocks(levels, n_atoms, of_codes)
    with torch.cuda.device_of(out):
        codes = pack(projection, indices, weights, n_atoms)
        for first in range(0, levels, blocks.levels):
            products_kernel[(projection.n_tiles,)](
                *_lists(projection), codes.words, *tables, out, *_size(projection), levels, n_atoms, columns, first,
                *_bounds(projection), **_constants(projection), **_of_codes(codes, blocks, levels - first),
                COLUMNS=COLUMNS, PIXELS_LAST=pixels_last, num_warps=WARPS,
            )  # fmt: skip
    return out


def most_atoms_of_products(precision: Precision) -> int:
    """Atoms whose products fit into the shared memory of every GPU served: 99 KB, or 64 KB of AMD. With 256, ptxas 12.8
    (Triton 3.4 to 3.6) computes descriptors of matrix products from the stack pointer on Hopper: illegal memory access.
    """
    return min(MOST_ATOMS[precision], 128)


def halves(table: Tensor) -> Tensor:
    """[2, ...] float16 that sum up to a table of float32, the second times LOW_SCALE: ``kernels.blending.halves``."""
    high = table.half()
    return torch.stack([high, ((table - high.float()) * LOW_SCALE.value).half()])


def _products_by_level(
    projection: TritonProjection,
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
        codes = render_codes(projection, indices[:, chosen], weights[:, chosen], table.shape[1])[0]
        for row, line in enumerate(codes):  # [W, L]
            cosines = cosines_and_norms(line, table[level], grams[level])[0]
            if pixels_last:
                out[level, :, row] = cosines.T
            else:
                out[level, row] = cosines
    return out


@dataclass(frozen=True)
class CodeBlocks:
    """Levels and atoms that one program renders, of so many Gaussians at a time."""

    levels: int
    atoms: int
    chunk: int


def code_blocks(levels: int, n_atoms: int, precision: Precision = "fp16x3") -> CodeBlocks:
    """The largest block whose coefficients fit into registers: more levels share the cost of the blending weights. With
    32 Gaussians at a time there are nearly as many barriers as with 16, for twice the work; float32 leaves no room.
    """
    atoms = max(16, min(MOST_ATOMS[precision], triton.next_power_of_2(n_atoms)))
    if precision == "tf32x3" and atoms == 64:
        atoms = 128  # with 64, ptxas 12.8 takes descriptors from registers of something else: wrong numbers
    if precision != "fp16x3":
        return CodeBlocks(1, atoms, 16)
    most = max(1, min(4, _COEFFICIENTS // (TILE * TILE * atoms)))
    passes = triton.cdiv(levels, most)
    return CodeBlocks(triton.cdiv(levels, passes), atoms, 32)


def _lists(projection: TritonProjection) -> tuple[Tensor, ...]:
    return projection.records, projection.numbers, projection.starts


def _size(projection: TritonProjection) -> tuple[int, int, int]:
    return projection.width, projection.height, projection.across


def _bounds(projection: TritonProjection) -> tuple[float, float]:
    return projection.preset.alpha_max, projection.preset.stop


def _constants(projection: TritonProjection) -> dict[str, object]:
    return {**FUSED, "STOP_INCLUSIVE": projection.preset.stop_inclusive, "TILE": TILE}


def _of_codes(codes: PackedCodes, blocks: CodeBlocks, levels_left: int) -> dict[str, object]:
    return {
        "CHUNK": blocks.chunk,
        "LEVELS": min(blocks.levels, levels_left),
        "GROUPS": codes.groups,
        "ATOMS": blocks.atoms,
        "WIDE": codes.wide,
        "PRECISION": product_precision(codes.wide),
    }
