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
from scoup import raster
from scoup.bench import Workload
from scoup.raster.projection import project_gaussians as projected
from scoup.raster.triton.kernels.blending import PADDING, RECORD
from scoup.raster.triton.kernels.codes import SLOTS
from scoup.raster.triton.projection import TILE, TritonProjection
from scoup.raster.triton.region_sums import Columns, columns_of

PIXELS = TILE * TILE
BLEND = 16
"""float32 instructions of a lane in ``blending.blend``: 3 multiply-adds to the ellipse's axes and 2 to the exponent;
cap, comparison and selection of alpha; 1 - alpha; 2 products of the running ones and 2 with the transmittance;
comparison with the bound and selection of the weight; minimum of what is left."""
SPLIT = 3
"""``blending.halves_of_weights``: two conversions and a difference for a number."""
SPLIT_SCALED = 4  # ``blending.halves``: and a product
DOTS = {"fp16x3": 3, "tf32x3": 3, "tf32": 1, "ieee": 0}  # tensor-core products that make one
DOTS_OF_HALVES = {"fp16x3": 2, "tf32x3": 3, "tf32": 1, "ieee": 0}  # where the other factor is float16


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
    view: TritonProjection

    def __post_init__(self) -> None:
        self.n = len(self.work.gaussians)
        self.visible = len(projected(self.work.gaussians, self.work.camera, self.view.preset))
        self.candidates = len(self.view.records) - PADDING
        self.tile_bytes = 2.0 if self.view.n_tiles < 2**15 else 4.0
        self.pairs = int(self.view.starts[-1])
        self.reached = len(torch.unique(self.view.pair_ids[: self.pairs]))
        self.pixels = self.view.width * self.view.height
        self.levels, self.k = self.work.indices.shape[1:]
        self.n_atoms, self.dim = self.work.codebook.shape[1:]
        self.code_bytes = self.work.indices.element_size() + self.work.weights.element_size()
        self.columns: Columns = columns_of(self.view, raster.combine(self.work.labels).map)
        self.walk: Callable[[int], Walk] = cache(lambda chunk: walk(self.view, chunk))
        # Sums that are kept: each tile's list times its columns.
        self.sums = int((self.view.starts.diff() * self.columns.counts).sum())

    def list_bytes(self) -> float:
        """The records of the pairs."""
        return 4.0 * RECORD.value * self.pairs

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


def blended(facts: Facts, constants: dict[str, Any], times: int = 1) -> tuple[Count, Walk]:
    """What every kernel that blends has in common, ``times`` over: lists read once, lanes evaluated each time."""
    own = facts.walk(constants["CHUNK"])
    split = SPLIT if constants["PRECISION"] == "fp16x3" else 0
    lanes = float(own.lanes * times)
    share = own.painting / own.lanes if own.lanes else 0.0
    kind = "fp16" if constants["PRECISION"] == "fp16x3" else "tf32"
    count = Count(facts.list_bytes(), lanes * (BLEND + split), powers=lanes, tensor_kind=kind, painting=share)
    return count, own


def sieve(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Centre, scales and opacity in, a byte out; 9 multiply-adds to the camera's frame, some 30 for the bounds."""
    return Count(bytes=29.0 * facts.n, float64=40.0 * facts.n)


def project_gaussians(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """In: row 8, geometry 44 bytes. Out: depth 8, ellipse 104, rectangle and count 16 bytes. Some 190 multiply-adds (9
    to the frame, 93 of the rotation and its two rows, 30 of covariance and determinant, the rest bounds and spans) and
    17 divisions, roots and logarithms at 10.
    """
    return Count(bytes=180.0 * facts.visible, float64=360.0 * facts.visible)


def expand(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """A rank of 8 bytes in and a tile out for each candidate; of each visible Gaussian order, start, rectangle and
    nine numbers of the ellipse (100 bytes). Some 40 additions and multiply-adds for each candidate.
    """
    moved = (8.0 + facts.tile_bytes) * facts.candidates + 100.0 * facts.visible
    return Count(bytes=moved, float64=40.0 * facts.candidates)


def lists(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """For each candidate its number, tile and rank in, a record out. Of each visible Gaussian
    order, row and six numbers of the ellipse (64 bytes). Some 10 multiply-adds for each pair.
    """
    moved = (8.0 + facts.tile_bytes + 8.0 + 4.0 * RECORD.value) * facts.candidates + 64.0 * facts.visible
    return Count(bytes=moved, float64=10.0 * facts.pairs)


def channels(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Values of the Gaussians reached in, channels and coverage out; E @ values on the tensor cores, padded, and one
    sum of the weights. Each block of channels blends again.
    """
    n_channels = facts.work.values.shape[1]
    blocks, width = grid[1], constants["CHANNELS"]
    count, own = blended(facts, constants, blocks)
    lanes = own.lanes * blocks
    moved = count.bytes + 4.0 * facts.reached * n_channels + 4.0 * facts.pixels * (n_channels + 1)
    tensor = 2.0 * DOTS[constants["PRECISION"]] * lanes * width
    return replace(count, bytes=moved, float32=count.float32 + lanes, tensor=tensor)


def pack(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Codes in, words out; for each two entries a comparison, a selection and an addition."""
    entries = float(facts.n * facts.levels * facts.k)
    slots = facts.n * facts.levels * constants["GROUPS"] * SLOTS.value
    moved = entries * facts.code_bytes + (8.0 if constants["WIDE"] else 4.0) * slots
    return Count(bytes=moved, float32=3.0 * entries * constants["K"])


def coefficients(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Words of the Gaussians reached in. In each chunk the codes are made dense (for every entry and atom, or two
    neighbouring ones, a comparison, a selection and an addition), and multiplied with E on the tensor cores.
    """
    blocks = grid[1] if len(grid) > 1 else 1
    count, own = blended(facts, constants, blocks)
    atoms, levels, wide = constants["ATOMS"], constants["LEVELS"], constants["WIDE"]
    slots = constants["GROUPS"] * SLOTS.value
    places = atoms if wide else atoms / 2
    dense = float(own.n_chunks * own.chunk * blocks * levels) * places * 3 * slots
    dots = DOTS if wide else DOTS_OF_HALVES
    tensor = 2.0 * dots[constants["PRECISION"]] * own.lanes * blocks * levels * atoms
    moved = count.bytes + (8.0 if wide else 4.0) * facts.reached * levels * slots
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
    lanes = float(grid[0] * PIXELS * levels)
    dots = DOTS[constants["TABLE_PRECISION"]]
    return replace(
        count,
        bytes=count.bytes + 4.0 * facts.pixels * levels * columns,
        float32=count.float32 + lanes * (atoms * (2 + SPLIT_SCALED) + padded),
        tensor=count.tensor + 2.0 * dots * lanes * atoms * (atoms + padded),
    )


def region_sums(facts: Facts, grid: tuple[int, ...], constants: dict[str, Any]) -> Count:
    """Columns of the pixels in, sums of the Gaussians walked over out. A tile is walked over once for each block of
    columns: lanes are evaluated, and E is multiplied with ones on the tensor cores.
    """
    count, own = blended(facts, constants)
    blocks = torch.div(
        facts.columns.counts + constants["COLUMNS"] - 1, constants["COLUMNS"], rounding_mode="floor"
    )
    chunks = own.chunks.long()
    turns = float((chunks * blocks).sum())
    walked = torch.minimum(chunks * own.chunk, facts.view.starts.diff())
    written = 4.0 * float((walked * facts.columns.counts).sum())
    again = turns / own.n_chunks if own.n_chunks else 0.0
    return replace(
        count,
        bytes=count.bytes + 2.0 * facts.view.n_tiles * PIXELS + written,
        float32=count.float32 * again,
        powers=count.powers * again,
        tensor=2.0
        * DOTS_OF_HALVES[constants["PRECISION"]]
        * turns
        * PIXELS
        * constants["COLUMNS"]
        * own.chunk,
    )


FORMULAS: dict[str, Callable[[Facts, tuple[int, ...], dict[str, Any]], Count]] = {
    "sieve_kernel": sieve,
    "project_kernel": project_gaussians,
    "expand_kernel": expand,
    "list_kernel": lists,
    "channels_kernel": channels,
    "pack_kernel": pack,
    "codes_kernel": codes,
    "products_kernel": products,
    "region_sums_kernel": region_sums,
}


def sorting(facts: Facts) -> Count:
    """What ``look`` leaves to torch: two stable radix sorts, each pass of 8 bits reading and writing keys and places
    (depths of 8 bytes: 8 passes of 16 bytes; tiles of 2 or 4 bytes beside places of 8), and a rank of 8 bytes out for
    each candidate.
    """
    depths = 8 * 2 * 16.0 * facts.visible
    tiles = facts.tile_bytes * 2 * (8.0 + facts.tile_bytes) * facts.candidates
    return Count(bytes=depths + tiles + 8.0 * facts.candidates)
