"""Region sums of a view on a GPU, and their way to triplets and accumulators."""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from scoup.agreement import Agreement
from scoup.codes import SparseCodes
from scoup.raster.gpu_view import FUSED, TILE, GpuView
from scoup.raster.kernels.regions import alike_kernel, region_sums_kernel
from scoup.raster.kernels.votes import add_few_kernel, add_many_kernel

MOST_SUMS = 1 << 27  # float32 numbers at a time: half a gigabyte
FEW_TILES = 48  # Gaussians that reach more are added up by a program of their own
MOST_ATOMS_AT_ONCE = 4096
CHUNK = 32
COLUMNS = 16
WARPS = 2  # of a program that sums up: a thread a pixel
_OTHERS = 32
_LANES = 32


@dataclass(frozen=True, eq=False)
class Columns:
    """The pixels of each tile by their regions at all levels: a column is a set of regions that some pixel has.

    Attributes:
        of_pixel: [tiles, P] int16, the column of each pixel of a tile, -1 without any region.
        counts: [tiles] int32.
        firsts: [tiles] int64, where the columns of a tile begin in ``regions``.
        regions: [C, S] int32, region at each level, -1 for none.
    """

    of_pixel: Tensor
    counts: Tensor
    firsts: Tensor
    regions: Tensor


@dataclass(frozen=True, eq=False)
class TileSums:
    """How much each Gaussian paints of each column, for some of the tiles.

    Attributes:
        values: [.] float32: for each tile [its Gaussians, its columns].
        bases: [tiles] int64: where a tile's values begin, -1 for the other tiles.
    """

    values: Tensor
    bases: Tensor


def with_sign(labels: Tensor) -> Tensor:
    """Regions as integers that can be -1, which the kernels give to pixels outside the image."""
    return labels if labels.dtype.is_signed else labels.int()


def columns_of(view: GpuView, labels: Tensor) -> Columns:
    """See ``Columns``; labels [S, H, W]."""
    levels, pixels, device = len(labels), TILE * TILE, labels.device
    first_alike = torch.empty(view.n_tiles, pixels, dtype=torch.int32, device=device)
    labels = with_sign(labels).contiguous()
    alike_kernel[(view.n_tiles,)](
        labels, first_alike, view.width, view.height, view.across, levels, TILE=TILE, OTHERS=_OTHERS, **FUSED
    )  # fmt: skip
    is_first = first_alike == torch.arange(pixels, dtype=torch.int32, device=device)
    numbers = torch.cumsum(is_first, 1) - 1
    has_region = first_alike < pixels
    of_pixel = torch.where(has_region, numbers.gather(1, first_alike.long().clamp(max=pixels - 1)), -1)
    counts = is_first.sum(1)
    firsts = torch.cumsum(counts, 0) - counts
    tile, pixel = torch.nonzero(is_first, as_tuple=True)
    row = torch.div(tile, view.across, rounding_mode="floor") * TILE + torch.div(
        pixel, TILE, rounding_mode="floor"
    )
    regions = labels[:, row, tile % view.across * TILE + pixel % TILE].T
    # Numbers that mean "none" must not wrap around to a region.
    regions = regions.clamp(min=-1).int().contiguous()
    return Columns(of_pixel.short(), counts.int(), firsts, regions)


def tile_sums(view: GpuView, columns: Columns) -> Iterator[TileSums]:
    """Sums of all tiles, as many tiles at a time as ``MOST_SUMS`` allows; Gaussians that paint nothing have zeros."""
    ends = torch.cumsum(view.starts.diff() * columns.counts, 0)
    total = int(ends[-1]) if len(ends) else 0
    if total <= MOST_SUMS:
        if total:
            yield _sums_of(view, columns, ends, 0, len(ends), total)
        return
    ends_here = ends.cpu()
    first, before = 0, 0
    while before < total:
        last = int(torch.searchsorted(ends_here, before + MOST_SUMS, right=True))
        last = max(last, first + 1)
        behind = int(ends_here[last - 1])
        if behind > before:
            yield _sums_of(view, columns, ends, first, last, behind - before)
        first, before = last, behind


def _sums_of(view: GpuView, columns: Columns, ends: Tensor, first: int, last: int, count: int) -> TileSums:
    """Of the tiles from ``first`` to before ``last``, ``count`` numbers; ``ends`` [tiles] is where those of each tile
    end.
    """
    device = view.device
    begins = torch.nn.functional.pad(ends[:-1], (1, 0))
    values = torch.zeros(count, device=device)
    tiles = torch.arange(view.n_tiles, device=device)
    here = (tiles >= first) & (tiles < last)
    bases = torch.where(here, begins - begins[first], -1)
    region_sums_kernel[(last - first,)](
        view.records, view.starts, columns.of_pixel, columns.counts, bases, values, view.width, view.height,
        view.across, first, view.preset.alpha_max, view.preset.stop, STOP_INCLUSIVE=view.preset.stop_inclusive,
        TILE=TILE, CHUNK=CHUNK, COLUMNS=COLUMNS, PRECISION=view.products(), num_warps=WARPS, **FUSED,
    )  # fmt: skip
    return TileSums(values, bases)


def triplets(view: GpuView, labels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """``raster.region_weights``: (gaussian, key, weight) sorted, each pair once."""
    stride = int(labels.max()) + 1 if labels.numel() else 0
    columns = columns_of(view, labels)
    gaussians, keys, weights = [], [], []
    for sums in tile_sums(view, columns):
        at = torch.nonzero(sums.values).squeeze(1)
        here = torch.nonzero(sums.bases >= 0).squeeze(1)
        tile = here[torch.searchsorted(sums.bases[here], at, right=True) - 1]
        within = at - sums.bases[tile]
        row = torch.div(within, columns.counts[tile], rounding_mode="floor")
        regions = columns.regions[columns.firsts[tile] + within - row * columns.counts[tile]]  # [T, S]
        gaussian = view.pair_ids[view.starts[tile] + row].long()
        for level, region in enumerate(regions.unbind(1)):
            chosen = region >= 0
            gaussians.append(gaussian[chosen])
            keys.append(region[chosen].long() + level * stride)
            weights.append(sums.values[at[chosen]])
    if not any(len(part) for part in gaussians):  # torch reduces no empty lengths
        empty = torch.zeros(0, dtype=torch.int64, device=view.device)
        return empty, empty, torch.zeros(0, device=view.device)
    n_keys = max(1, len(labels) * stride)
    pair = torch.cat(gaussians) * n_keys + torch.cat(keys)
    pair, order = torch.sort(pair, stable=True)
    merged, counts = torch.unique_consecutive(pair, return_counts=True)
    # One after the other within a segment, unlike atomic additions.
    total = torch.segment_reduce(torch.cat(weights)[order].double(), "sum", lengths=counts)
    return torch.div(merged, n_keys, rounding_mode="floor"), merged % n_keys, total.float()


@dataclass(frozen=True, eq=False)
class CodeTables:
    """Codes of a view's regions, level after level.

    Attributes:
        firsts: [S] int64, where the regions of a level begin.
        atoms: [R, K] int32.
        weights: [R, K] float32.
        cosines: [R, L] float32 inner products with the atoms, see ``Agreement.region_cosines``; [0] without an earlier
            round.
    """

    firsts: Tensor
    atoms: Tensor
    weights: Tensor
    cosines: Tensor

    @classmethod
    def of(
        cls, codes: Sequence[SparseCodes], agreement: Agreement | None, device: torch.device
    ) -> CodeTables:
        k = max(level.k for level in codes)
        atoms, weights, firsts, total = [], [], [], 0
        for level in codes:
            pad = (0, k - level.k)
            atoms.append(torch.nn.functional.pad(level.indices.int(), pad))
            weights.append(torch.nn.functional.pad(level.weights, pad))
            firsts.append(total)
            total += len(level)
        cosines = torch.zeros(0, device=device)
        if agreement is not None:
            cosines = torch.cat([table.to(device) for table in agreement.region_cosines(list(codes))])
        return cls(
            torch.tensor(firsts, dtype=torch.int64).to(device),
            torch.cat(atoms).to(device),
            torch.cat(weights).to(device),
            cosines,
        )


def pairs_at_once(atoms: int) -> int:
    """Pairs of one Gaussian that a program adds up together, for so many padded atoms."""
    return max(1, min(64, 2048 // atoms))


def add_votes(
    view: GpuView,
    labels: Tensor,  # [S, H, W]
    codes: Sequence[SparseCodes],
    agreement: Agreement | None,
    out: Tensor,  # [N, S, L], on the view's device
) -> None:
    """Add what a view says to accumulators; the order of all additions is fixed."""
    columns = columns_of(view, labels)
    tables = CodeTables.of(codes, agreement, view.device)
    _, levels, n_atoms = out.shape
    visible = view.visible
    counts = visible.firsts.diff()
    at_once = n_atoms <= MOST_ATOMS_AT_ONCE
    few = torch.nonzero((counts > 0) & (counts <= FEW_TILES) if at_once else counts > 0).squeeze(1)
    # A warp takes as long as its lane with the most tiles: lanes with as many as each other go together.
    few = few[torch.sort(counts[few].clamp(max=255).to(torch.uint8), stable=True).indices]
    many = torch.nonzero(counts > FEW_TILES).squeeze(1) if at_once else few[:0]
    if agreement is None:
        earlier_k, nothing = 0, torch.zeros(0, device=view.device)
        earlier = (nothing, nothing, nothing, nothing)
    else:
        earlier_k = agreement.indices.shape[2]
        earlier = (
            agreement.indices.to(view.device).contiguous(),
            agreement.weights.to(view.device).contiguous(),
            tables.cosines,
            agreement.sharpness.to(view.device),
        )
    atoms_padded = triton.next_power_of_2(n_atoms)
    for sums in tile_sums(view, columns):
        shared = (
            visible.ids, visible.firsts, visible.tiles, visible.places, view.starts, columns.counts, sums.bases,
            sums.values, columns.firsts, columns.regions, tables.firsts, tables.atoms, tables.weights, *earlier, out,
        )  # fmt: skip
        sizes = {"K": tables.atoms.shape[1], "EARLIER_K": earlier_k, **FUSED}
        if len(few):
            add_few_kernel[(triton.cdiv(len(few), _LANES), levels)](
                few, *shared, len(few), levels, view.n_tiles, n_atoms, **sizes, BLOCK=_LANES, num_warps=1
            )
        if len(many):
            pairs = pairs_at_once(atoms_padded)
            add_many_kernel[(len(many), levels)](
                many, *shared, levels, view.n_tiles, n_atoms, **sizes, PAIRS=pairs, ATOMS=atoms_padded
            )
