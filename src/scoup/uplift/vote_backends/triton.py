"""The vote on a GPU: entries are copied there and sorted by Gaussian, some Gaussians at a time; a kernel adds up.

Imports triton: import this module only if tensors are on a GPU.
"""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError
from scoup.scene import SparseCodes, index_dtype, rows_of
from scoup.uplift.reweighting import EarlierRound
from scoup.uplift.storage.entries import BUCKET, Entries
from scoup.uplift.vote_backends import reference
from scoup.uplift.vote_backends.kernels import vote_kernel
from scoup.uplift.voting import CodedEntries

MOST_ENTRIES = 1 << 24  # at a time: half a gigabyte, most of it to sort them
MOST_KNOWN = 1 << 28  # that stay there from round to round: two gigabytes
MOST_KEPT = 16  # atoms that the kernel finds itself
MOST_SUMS = 1 << 26  # float32 numbers at a time; finding the largest takes several times as much
_LANES = 1024  # entries times atoms that a program adds up together


@dataclass(frozen=True, eq=False)
class SortedEntries:
    """The entries of all views for some Gaussians: those of one lie together, by view, then label tuple."""

    starts: Tensor  # [n + 1] int64, first entry of each Gaussian
    combinations: Tensor  # [E] int32, numbered through all views
    weights: Tensor  # [E] float32


class Vote(reference.Vote):
    """See ``reference.Vote``."""

    batches = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._known: dict[range, SortedEntries] = {}
        self._entries_of_bucket = np.zeros(-(-self.n_gaussians // BUCKET), np.int64)
        for view in self.views:
            add_counts(view.entries, self._entries_of_bucket)
        self._first_combinations = np.cumsum([0, *(len(view.regions) for view in self.views)])
        k = max(level.k for level in self.codes)
        self._atoms = torch.cat([_padded(level.indices.int(), k) for level in self.codes])
        self._weights = torch.cat([_padded(level.weights, k) for level in self.codes])
        self._rows = self._rows_of_combinations()
        norms = [norms_of(level, gram) for level, gram in zip(self.codes, self.grams, strict=True)]
        self._inverse_norms = torch.cat(
            [torch.where(norm > 0, 1 / norm.clamp(min=1e-12), 0.0) for norm in norms]
        )

    def sums(self, earlier: EarlierRound | None, buckets: range) -> Tensor:
        """See ``reference.Vote.sums``."""
        return self._add_up(earlier, buckets, 0)[0]

    def largest(self, earlier: EarlierRound | None, buckets: range, keep: int) -> tuple[Tensor, Tensor]:
        """See ``reference.Vote.largest``."""
        n_atoms = self.codes[0].n_atoms
        if not self._finds(keep):
            return super().largest(earlier, buckets, keep)
        sums, indices = self._add_up(earlier, buckets, keep)
        sums = sums.double()
        total = sums.sum(2, keepdim=True)
        weights = torch.where(total > 0, sums / total, 0.0).float()
        dtype = index_dtype(n_atoms)
        # torch converts to few types without a sign.
        return indices.to(torch.uint8 if dtype == torch.uint8 else torch.int16).view(dtype), weights

    def _add_up(self, earlier: EarlierRound | None, buckets: range, keep: int) -> tuple[Tensor, Tensor]:
        """Return sums [n, S, L] for the Gaussians of some buckets, or with ``keep`` the largest and their atoms, both
        [n, S, keep].
        """
        entries = self._entries_of(buckets)
        first, count = buckets.start * BUCKET, len(entries.starts) - 1
        levels, n_atoms = len(self.codes), self.codes[0].n_atoms
        if earlier is None:
            earlier_k, nothing = 0, self._weights[:0]
            known = (nothing, nothing, nothing)
        else:
            rows = slice(first, first + count)
            earlier_k = earlier.indices.shape[2]
            atoms = rows_of(earlier.indices, rows).to(self.device).int()
            weights = earlier.weights[rows].to(self.device)
            known = (atoms.contiguous(), weights.contiguous(), earlier.sharpness.to(self.device))
        out = torch.empty(count, levels, keep or n_atoms, device=self.device)
        top_atoms = torch.empty(count, levels, keep, dtype=torch.int32, device=self.device)
        if out.numel():
            with torch.cuda.device_of(out):
                vote_kernel[(count, levels)](
                    entries.starts, entries.combinations, entries.weights, self._rows, self._atoms, self._weights,
                    self._inverse_norms, self.grams, *known, out, top_atoms, levels, n_atoms, K=self._atoms.shape[1],
                    EARLIER_K=earlier_k, KEEP=keep, **blocks(n_atoms),
                )  # fmt: skip
        return out, top_atoms

    def deviations(self, earlier: EarlierRound, buckets: range) -> list[Tensor]:
        there = EarlierRound(
            earlier.indices.to(self.device), earlier.weights.to(self.device), earlier.sharpness
        )
        deviations = [super(Vote, self).deviations(there, some) for some in self.chunks(buckets, 1)]
        return [torch.cat(of_level) for of_level in zip(*deviations, strict=True)]

    def chunks(self, buckets: range, keep: int) -> Iterator[range]:
        """Yield as many buckets at a time as the bounds above allow, one at least."""
        if not buckets:
            yield buckets
        numbers = keep if self._finds(keep) else self.codes[0].n_atoms
        most = max(1, MOST_SUMS // (BUCKET * len(self.codes) * numbers))
        ends = np.cumsum(self._entries_of_bucket)
        first = buckets.start
        while first < buckets.stop:
            before = ends[first - 1] if first else 0
            last = int(np.searchsorted(ends, before + MOST_ENTRIES, side="right"))
            last = min(max(last, first + 1), first + most, buckets.stop)
            yield range(first, last)
            first = last

    def _finds(self, keep: int) -> bool:
        """Return whether the kernel finds the largest sums itself."""
        return keep <= min(MOST_KEPT, self.codes[0].n_atoms)

    def _rows_of_combinations(self) -> Tensor:
        """Return [C, S] int32, the rows of all views' regions among the codes of all levels."""
        first, parts = 0, []
        for level, codes in enumerate(self.codes):
            regions = np.concatenate(
                [view.regions[:, level] for view in self.views] or [np.zeros(0, np.int64)]
            )
            parts.append(np.where(regions >= 0, regions + first, -1))
            first += len(codes)
        return torch.from_numpy(np.stack(parts, 1).astype(np.int32)).to(self.device)

    def _check(self, view: CodedEntries) -> None:
        """Entries are checked on the device, when they are sorted."""

    def _entries_of(self, buckets: range) -> SortedEntries:
        """Return the entries of some buckets; they stay on the device for the next round if all have room there."""
        known = self._known.get(buckets)
        if known is None:
            known = self._sorted(buckets)
            if int(self._entries_of_bucket.sum()) <= MOST_KNOWN:
                self._known[buckets] = known
        return known

    def _sorted(self, buckets: range) -> SortedEntries:
        n_buckets, device = len(buckets), self.device
        count = max(0, min(buckets.stop * BUCKET, self.n_gaussians) - buckets.start * BUCKET)
        groups, lengths = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        arrays: list[list[np.ndarray]] = [[np.zeros(0, kind)] for kind in (np.uint8, np.int16, np.float32)]
        for number, view in enumerate(self.views):
            entries = view.entries
            low, high = entries.find_buckets(buckets.start, buckets.stop)
            starts = entries.starts[low : high + 1].astype(np.int64)
            span = slice(int(starts[0]), int(starts[-1]))
            groups.append(number * n_buckets + entries.buckets[low:high].astype(np.int64) - buckets.start)
            lengths.append(np.diff(starts))
            # int16 for uint16: torch supports few operations on uint16.
            slices = entries.places[span], entries.combinations[span].view(np.int16), entries.weights[span]
            for array, slice_of_view in zip(arrays, slices, strict=True):
                array.append(slice_of_view)
        places, combinations, weights = (
            torch.from_numpy(np.concatenate(array)).to(device) for array in arrays
        )
        # Per entry: the number of its view times n_buckets, plus its bucket.
        distinct, repeats = (torch.from_numpy(np.concatenate(of)).to(device) for of in (groups, lengths))
        group = torch.repeat_interleave(distinct, repeats, output_size=len(places))
        number = torch.div(group, n_buckets, rounding_mode="floor")
        firsts = torch.from_numpy(self._first_combinations).to(device)
        combination = (combinations.int() & 0xFFFF) + firsts[number]
        gaussian = ((group - number * n_buckets) * BUCKET + places).int()
        if bool(((combination >= firsts[number + 1]) | (gaussian >= count)).any()):
            raise InputError("the region sums are damaged: an entry of a missing Gaussian or label tuple")
        gaussian, order = torch.sort(gaussian, stable=True)
        starts = torch.searchsorted(gaussian, torch.arange(count + 1, dtype=torch.int32, device=device))
        return SortedEntries(starts, combination[order].int(), weights.float()[order])


def blocks(n_atoms: int) -> dict[str, int]:
    """Return atoms and entries that a program takes at a time, and its warps: a few numbers per thread."""
    atoms = max(16, 1 << (n_atoms - 1).bit_length())
    return {
        "ATOMS": atoms,
        "ENTRIES": max(1, min(8, _LANES // atoms)),
        "num_warps": max(1, min(16, atoms // 256)),
    }


def add_counts(entries: Entries, counts: np.ndarray) -> None:
    """Add the entries of each bucket to ``counts`` [B] int64; an InputError if buckets have gaps."""
    lengths = np.diff(entries.starts.astype(np.int64))
    if (
        (np.diff(entries.buckets.astype(np.int64), append=len(counts)) <= 0).any()
        or entries.starts[0] != 0
        or entries.starts[-1] != len(entries.places)
        or (lengths < 0).any()
    ):
        raise InputError("the region sums are damaged: buckets have gaps")
    counts[entries.buckets] += lengths


def norms_of(codes: SparseCodes, gram: Tensor) -> Tensor:
    """Return [R] float32 norms of decoded codes; ``gram`` [L, L] are inner products of the atoms."""
    atoms = codes.indices.long()
    products = torch.zeros(len(codes), codes.n_atoms, device=gram.device)
    for slot in range(codes.k):
        products += codes.weights[:, slot, None] * gram[atoms[:, slot]]
    return (products.gather(1, atoms) * codes.weights).sum(1).clamp(min=0).sqrt()


def _padded(rows: Tensor, k: int) -> Tensor:
    return torch.nn.functional.pad(rows, (0, k - rows.shape[1]))
