"""Random region sums and codes, and what must hold for whoever votes on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raster.parity import beyond
from scoup.scene import SparseCodes, stable_products
from scoup.uplift.reweighting import EarlierRound
from scoup.uplift.storage.entries import BUCKET, pack
from scoup.uplift.vote_backends.reference import Vote as ReferenceVote
from scoup.uplift.voting import CodedEntries

SHARPNESS = torch.tensor([3.0, 0.0, 20.0])


@dataclass(frozen=True)
class Sizes:
    n_gaussians: int = 300
    views: int = 3
    levels: int = 3
    n_atoms: int = 24
    k: int = 4
    entries: int = 400  # per view
    without: int | None = None  # a level that has no regions


def random_vote(sizes: Sizes, seed: int) -> dict[str, Any]:
    """Arguments of a vote but for the device. The second view is empty; some codes are; Gaussians have no, few or
    many entries.
    """
    generator = torch.Generator().manual_seed(seed)
    numbers = np.random.default_rng(seed)
    views, totals = [], [0] * sizes.levels
    for view in range(sizes.views):
        count = 0 if view == 1 else int(numbers.integers(1, 40))
        regions = np.full((count, sizes.levels), -1, np.int64)
        for level in range(sizes.levels):
            if count and level != sizes.without:
                regions[:, level] = numbers.integers(-1, 9, count)
                regions[regions[:, level] >= 0, level] += totals[level]
                totals[level] += 9
        table = np.where(regions >= 0, regions, -1).astype(np.int32)
        some = min(sizes.entries, sizes.n_gaussians * count) if sizes.n_gaussians else 0
        # The square of a uniform number: the first Gaussians have many entries, the last few.
        gaussian = (numbers.random(some) ** 2 * sizes.n_gaussians).astype(np.int64)
        pairs = np.unique(gaussian * max(1, count) + numbers.integers(0, max(1, count), some))
        weights = (numbers.random(len(pairs)) * 20).astype(np.float32) + np.float32(1e-3)
        (entries,) = pack(pairs // max(1, count), pairs % max(1, count), weights, table)
        views.append(CodedEntries(entries, regions))
    codes = []
    for total in totals:
        dense = torch.rand(total, sizes.n_atoms, generator=generator)
        dense[torch.rand(total, generator=generator) < 0.1] = 0
        codes.append(SparseCodes.from_dense(dense, sizes.k))
    atoms = torch.randn(sizes.levels, sizes.n_atoms, 16, generator=generator) + 0.3
    grams = torch.stack([stable_products(of_level, of_level) for of_level in atoms])
    return {"n_gaussians": sizes.n_gaussians, "views": views, "codes": codes, "grams": grams}


def buckets_of(arguments: dict[str, Any]) -> range:
    return range(-(-arguments["n_gaussians"] // BUCKET))


def earlier_of(arguments: dict[str, Any], keep: int) -> EarlierRound:
    """The first round as the reference has it, a tenth of the Gaussians without a code."""
    reference = ReferenceVote(**arguments, device=torch.device("cpu"))
    indices, weights = reference.round(keep, None, True, buckets_of(arguments))
    weights[::10] = 0
    levels = len(arguments["codes"])
    return EarlierRound(indices, weights, SHARPNESS.repeat(levels)[:levels])


def check_rounds(prepared: type[Any], sizes: Sizes, keep: int, seed: int, device: str = "cpu") -> None:
    """One round and a second give what the reference gives, and the same bytes again."""
    arguments = random_vote(sizes, seed)
    reference = ReferenceVote(**arguments, device=torch.device("cpu"))
    tested = prepared(**arguments, device=torch.device(device))
    buckets = buckets_of(arguments)
    earlier = earlier_of(arguments, min(keep, 8))

    def voted(earlier: EarlierRound | None, unit_norm: bool) -> tuple[Tensor, Tensor]:
        indices, weights = tested.round(keep, earlier, unit_norm, buckets)
        return indices.cpu(), weights.cpu()

    assert_same_codes(voted(None, True), reference, keep, None, True, buckets)
    found, again = (voted(earlier, False) for _ in range(2))
    assert all(torch.equal(one, other) for one, other in zip(found, again, strict=True))
    assert_same_codes(found, reference, keep, earlier, False, buckets)
    expected = reference.deviations(earlier, buckets)
    for one, other in zip(tested.deviations(earlier, buckets), expected, strict=True):
        assert len(one) == len(other)
        assert not beyond(one.cpu().sort().values, other.sort().values, 10.0).any()


def assert_same_codes(
    found: tuple[Tensor, Tensor],
    reference: ReferenceVote,
    keep: int,
    earlier: EarlierRound | None,
    unit_norm: bool,
    buckets: range,
) -> None:
    """Codes of all Gaussians agree but where the last atom kept and the first left out weigh the same."""
    sums = reference.sums(earlier, buckets)
    expected = reference.round(keep, earlier, unit_norm, buckets)
    for one, other in zip(found, expected, strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
    falling = sums.sort(dim=2, descending=True).values
    clear = torch.ones(sums.shape[:2], dtype=torch.bool)
    if keep < sums.shape[2]:
        kept, left_out = falling[..., keep - 1], falling[..., keep]
        clear = (kept - left_out > 1e-5 * falling[..., 0]) | (left_out == 0)
    dense = [
        torch.zeros_like(sums).scatter_add_(2, indices.long(), weights)
        for indices, weights in (found, expected)
    ]
    off = beyond(dense[0], dense[1], 5.0).any(2)
    assert not (off & clear).any(), f"{int((off & clear).sum())} codes differ"
    assert float(clear.float().mean()) > 0.5 or not len(clear)
    assert (found[1][..., 1:] <= found[1][..., :-1] + 1e-7).all(), "largest first"
    assert ((found[1].sum(2) == 0) == (expected[1].sum(2) == 0)).all()


def damaged(arguments: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """By what is wrong, the same arguments with a first view that nobody can add up."""
    first, *others = arguments["views"]
    entries, regions = first.entries, first.regions.copy()
    regions[-1, 0] = len(arguments["codes"][0])
    assert arguments["n_gaussians"] % BUCKET, "the last bucket must be short"

    def spoiled(name: str, at: int, value: int) -> dict[str, Any]:
        array = getattr(entries, name).copy()
        array[at] = value
        return {**arguments, "views": [replace(first, entries=replace(entries, **{name: array})), *others]}

    found = {
        "no such Gaussian": spoiled("places", -1, 255),
        "no such combination": spoiled("combinations", 0, len(regions)),
        "a bucket before the first": spoiled("starts", 0, 1),
        "a bucket ends before it begins": spoiled("starts", 1, int(entries.starts[-1]) + 1),
        "no such bucket, far away": spoiled("buckets", -1, 2**32 - 1),
        "no such bucket": spoiled("buckets", -1, int(entries.buckets[-1]) + 1),
        "entries behind the last bucket": spoiled("starts", -1, int(entries.starts[-1]) - 1),
        "no such region": {**arguments, "views": [replace(first, regions=regions), *others]},
    }
    if len(entries.buckets) > 1:
        found["a bucket that is named twice"] = spoiled("buckets", -1, int(entries.buckets[0]))
    return found
