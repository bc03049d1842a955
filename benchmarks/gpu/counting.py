"""Bytes and operations of each kernel, counted by hand from its source.

Bytes are those that must come from or go to memory at least once: each array that is read counts once, however many
programs read it, because what they share is meant to come from the caches. Operations are those that are carried out,
for lanes that paint nothing, too: what part of them paints is a column of its own. An instruction of float32 is one
turn of a lane, so a multiply-add counts 1; a division counts 3 (a reciprocal and corrections), and so does a square
root; those of float64 count 10, which take a loop of corrections. A power of two runs on units of its own. On the
tensor cores a multiply-add counts 2, as everyone counts there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import torch

from benchmarks.gpu.walking import Walk, walk
from scoup.bench import Workload
from scoup.raster.gpu_regions import Columns, columns_of
from scoup.raster.gpu_view import TILE, GpuView

PIXELS = TILE * TILE
VOTES = "add_few_kernel and add_many_kernel"
BLEND = 19
"""float32 instructions of a lane in ``blending.blend``: 3 multiply-adds to the ellipse's axes and 2 to the exponent;
cap, comparison and selection of alpha; 1 - alpha; 1 product of the running one and 1 with the transmittance; comparison
with the bound; 3 of the division, product and selection of the weight; selection and minimum of what is left."""
SPLIT = 4
"""``blending.halves``: two conversions, a difference and a product for a number."""
DOTS = {"fp16x3": 3, "tf32x3": 3, "tf32": 1, "ieee": 0}  # tensor-core products that make one
DOTS_WITH_ONES = {"fp16x3": 2, "tf32x3": 3, "tf32": 1, "ieee": 0}


@dataclass(frozen=True)
class Count:
    """Attributes are numbers of what a kernel moves and does; ``tensor_kind`` is "fp16" or "tf32"."""

    bytes: float = 0.0
    float32: float = 0.0
    float64: float = 0.0
    powers: float = 0.0
    tensor: float = 0.0
    tensor_kind: str = "fp16"
    painting: float | None = None  # share of the evaluated lanes that paint


@dataclass(eq=False)
class Facts:
    """What the counts depend on.

    Attributes:
        work: scene, view and codes.
        view: as looked at.
    """

    work: Workload
    view: GpuView

    def __post_init__(self) -> None:
        self.n = len(self.work.gaussians)
        self.visible = len(self.view.visible.ids)
        self.candidates = len(self.view.visible.tiles)
        self.pairs = int(self.view.starts[-1])
        self.reached = len(torch.unique(self.view.pair_ids[: self.pairs]))
        self.pixels = self.view.width * self.view.height
        self.levels, self.k = self.work.indices.shape[1:]
        self.n_atoms, self.dim = self.work.codebook.shape[1:]
        self.code_bytes = self.work.indices.element_size() + self.work.weights.element_size()
        self.columns: Columns = columns_of(self.view, self.work.labels)
        self.walk: Callable[[int, int], Walk] = cache(lambda pixels, chunk: walk(self.view, pixels, chunk))
        # Sums that are kept: each tile's list times its columns.
        self.sums = int((self.view.starts.diff() * self.columns.counts).sum())

    def list_bytes(self) -> float:
        """Pairs with their corners, and the records of the Gaussians in them."""
        return 12.0 * self.pairs + 16.0 * self.reached

    def record(self) -> dict[str, int]:
        """For JSON."""
        names = (
            "n",
            "visible",
            "candidates",
            "pairs",
            "reached",
            "pixels",
            "levels",
            "k",
            "n_atoms",
            "dim",
            "sums",
        )
        return {name: int(getattr(self, name)) for name in names}


def blended(facts: Facts, constants: dict[str, Any], pixels: int, times: int = 1) -> tuple[Count, Walk]:
    """What every kernel that blends has in common, ``times`` over: lists read once, lanes evaluated each time."""
    own = facts.walk(pixels, constants["CHUNK"])
    split = SPLIT if constants["PRECISION"] == "fp16x3" else 0
    lanes = float(own.lanes * times)
    share = own.painting / own.lanes if own.lanes else 0.0
    kind = "fp16" if constants["PRECISION"] == "fp16x3" else "tf32"
    count = Count(facts.list_bytes(), lanes * (BLEND + split), powers=lanes, tensor_kind=kind, painting=share)
    return count, own


def sieve(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Centre, scales and opacity in, a byte out; 9 multiply-adds to the camera's frame, some 30 for the bounds."""
    return Count(bytes=29.0 * facts.n, float64=40.0 * facts.n)


def project(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """In: row 8, geometry 44 bytes. Out: depth 8, ellipse 56, rectangle and count 16, record 16 bytes. Some 190
    multiply-adds (9 to the frame, 93 of the rotation and its two rows, 30 of covariance and determinant, the rest
    bounds and spans) and 15 divisions, roots and logarithms at 10.
    """
    return Count(bytes=148.0 * facts.visible, float64=340.0 * facts.visible)


def expand(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """A rank of 8 bytes in and tile, number and corner out for each candidate; of each visible Gaussian order, start,
    row, rectangle and ellipse (92 bytes). Some 50 multiply-adds and 9 divisions and roots at 10 for each candidate.
    """
    tile_bytes = facts.view.visible.tiles.element_size()
    moved = (8.0 + tile_bytes + 12.0) * facts.candidates + 92.0 * facts.visible
    return Count(bytes=moved, float64=140.0 * facts.candidates)


def channels(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Values of the Gaussians reached in, channels and coverage out; E @ values on the tensor cores, padded, and one
    sum of the weights. Each block of channels blends again.
    """
    n_channels = facts.work.values.shape[1]
    blocks, width = grid[1], constants["CHANNELS"]
    count, own = blended(facts, constants, constants["PIXELS"], blocks)
    lanes = own.lanes * blocks
    moved = count.bytes + 4.0 * facts.reached * n_channels + 4.0 * facts.pixels * (n_channels + 1)
    tensor = 2.0 * DOTS[constants["PRECISION"]] * lanes * width
    return replace(count, bytes=moved, float32=count.float32 + lanes, tensor=tensor)


def coefficients(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Codes of the Gaussians reached in. In each chunk the codes are made dense (for every entry and atom a comparison,
    a selection and an addition), split, and multiplied with E on the tensor cores.
    """
    blocks = grid[1] if len(grid) > 1 else 1
    count, own = blended(facts, constants, constants["PIXELS"], blocks)
    atoms, levels = constants["ATOMS"], constants["LEVELS"]
    split = SPLIT if constants["PRECISION"] == "fp16x3" else 0
    dense = float(own.n_chunks * own.chunk * blocks * levels * atoms) * (3 * constants["K"] + split)
    tensor = 2.0 * DOTS[constants["PRECISION"]] * own.lanes * blocks * levels * atoms
    moved = count.bytes + float(facts.reached * levels * facts.k * facts.code_bytes)
    return replace(count, bytes=moved, float32=count.float32 + dense, tensor=tensor)


def codes(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """``coefficients``, and the map written out."""
    count = coefficients(facts, grid, constants)
    return replace(
        count, bytes=count.bytes + 4.0 * facts.pixels * min(constants["LEVELS"], facts.levels) * facts.n_atoms
    )


def products(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """``coefficients``, then for each pixel and level W G (L x L, a sum of L products after it) and W B (L x columns,
    padded to whole blocks) on the tensor cores; cosines or features out. Gram matrix and table stay in the caches.
    """
    count = coefficients(facts, grid, constants)
    atoms, levels = constants["ATOMS"], min(constants["LEVELS"], facts.levels)
    columns = len(facts.work.queries) if constants["PIXELS_LAST"] else facts.dim
    padded = math.ceil(columns / constants["COLUMNS"]) * constants["COLUMNS"]
    lanes = float(grid[0] * constants["PIXELS"] * levels)
    dots = DOTS[constants["TABLE_PRECISION"]]
    return replace(
        count,
        bytes=count.bytes + 4.0 * facts.pixels * levels * columns,
        float32=count.float32 + lanes * (atoms * (2 + SPLIT) + padded),
        tensor=count.tensor + 2.0 * dots * lanes * atoms * (atoms + padded),
    )


def alike(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Labels in, a number for each pixel of a tile out; for each pair of pixels of a tile two instructions a level and
    three to keep the first.
    """
    pairs_of_pixels = float(facts.view.n_tiles * PIXELS * PIXELS)
    moved = 4.0 * facts.pixels * facts.levels + 4.0 * facts.view.n_tiles * PIXELS
    return Count(bytes=moved, float32=pairs_of_pixels * (2 * facts.levels + 3))


def region_sums(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Columns of the pixels in, sums of the Gaussians walked over out. In each chunk, for each block of columns of the
    tile: which pixels are in it (2 instructions a pixel and column), and E^T with these ones on the tensor cores.
    """
    count, own = blended(facts, constants, PIXELS)
    blocks = torch.div(facts.columns.counts + constants["COLUMNS"] - 1, constants["COLUMNS"]).long()
    chunks = own.chunks.sum(1).long()
    ones = float((chunks * blocks).sum()) * PIXELS * constants["COLUMNS"]
    walked = torch.minimum(chunks * own.chunk, facts.view.starts.diff())
    written = 4.0 * float((walked * facts.columns.counts).sum())
    return replace(
        count,
        bytes=count.bytes + 2.0 * facts.view.n_tiles * PIXELS + written,
        float32=count.float32 + 2 * ones,
        tensor=2.0 * DOTS_WITH_ONES[constants["PRECISION"]] * ones * own.chunk,
    )


def votes(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Both kernels that add votes up together, as if one did all: tile and place of each candidate in, each sum read
    once for all levels (the other levels find it in the caches), and of the accumulators the 32 bytes around each entry
    of a code that is added, read and written. For each sum and level some 10 instructions, 2 for each entry of a code.
    """
    moved = (4.0 + facts.view.visible.tiles.element_size()) * facts.candidates + 4.0 * facts.sums
    moved += 2.0 * 32 * facts.reached * facts.levels * facts.k
    return Count(bytes=moved, float32=float(facts.sums * facts.levels) * (10 + 2 * constants["K"]))


FORMULAS: dict[str, Callable[[Facts, tuple[int, ...], dict[str, Any]], Count]] = {
    "sieve_kernel": sieve,
    "project_kernel": project,
    "expand_kernel": expand,
    "channels_kernel": channels,
    "codes_kernel": codes,
    "products_kernel": products,
    "alike_kernel": alike,
    "region_sums_kernel": region_sums,
    VOTES: votes,
}


def sorting(facts: Facts) -> Count:
    """What ``look`` leaves to torch: two stable radix sorts, each pass of 8 bits reading and writing keys and places
    (depths of 8 bytes: 8 passes of 16 bytes; tiles of 2 or 4 bytes beside places of 8), and the lists gathered in their
    new order (places 8 bytes in; numbers 4 and corners 8 in and out; the way back 4 out).
    """
    tile_bytes = facts.view.visible.tiles.element_size()
    depths = 8 * 2 * 16.0 * facts.visible
    tiles = tile_bytes * 2 * (8.0 + tile_bytes) * facts.candidates
    return Count(bytes=depths + tiles + (2 * 8 + 24 + 8) * 1.0 * facts.candidates)
