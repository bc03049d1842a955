"""The Gaussians of a page in parts, each near its own place, and few that stand for all until the parts are there."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.raster import morton_codes
from scoup.scene import Gaussians
from scoup.view.decimation import PageGaussians, cover, decimate, drawable

PART_GAUSSIANS = 250_000
"""A part is about so many Gaussians of the scene, before they are merged."""
COARSE_GAUSSIANS = 60_000
"""The first picture of a large scene shows so many: about 2 MB."""
_SAMPLE = 1 << 18  # Gaussians, of which the coarse ones are made: more than four times as many
_AT_A_TIME = 1 << 16  # rows whose numbers in double precision stay in the cache


class Parts:
    """A large scene, cut along a Z-order curve into parts of about equal numbers of Gaussians.

    Parts and coarse Gaussians are made when they are asked for. Of a scene with more than ``most``, each part merges as
    large a share as the others, unless it is asked for whole. ``owners`` [N] are the things of the Gaussians.
    """

    def __init__(self, gaussians: Gaussians, most: int, owners: Tensor | None = None) -> None:
        self._gaussians, self._most, self._owners = gaussians, most, owners
        step = max(1, len(gaussians) // _SAMPLE)
        rows = np.arange(0, len(gaussians), step)
        self._sample, self._step = rows[drawable(gaussians.select(torch.from_numpy(rows)))], step
        self._around = gaussians.means[torch.from_numpy(self._sample)]
        places = np.sort(morton_codes(self._around)[0].numpy())
        count = -(-len(gaussians) // PART_GAUSSIANS) if len(places) else 1
        self._ends = places[[len(places) * number // count for number in range(1, count)]]

    def __len__(self) -> int:
        return len(self._ends) + 1

    def coarse(self) -> tuple[PageGaussians, list[int]]:
        """Return Gaussians that stand for all, part by part, and how many each part has.

        Of a very large scene they are made of a sample, and of all that cover more than most.
        """
        gaussians, rows, copies = self._gaussians, self._sample, np.ones(len(self._sample), np.int64)
        if self._step > 1:
            covers = self._covers()
            most = np.quantile(covers[rows], 1 - COARSE_GAUSSIANS / len(gaussians)) if len(rows) else 0.0
            chosen = covers > most
            chosen[rows] = True
            rows = np.flatnonzero(chosen)
            copies = np.where(covers[rows] > most, 1, self._step)
        number = self._numbers(gaussians.means[torch.from_numpy(rows)])
        parts = []
        for index in range(len(self)):
            chosen = number == index
            most = max(1, COARSE_GAUSSIANS * int(chosen.sum()) // max(1, len(rows)))
            parts.append(self._decimated(rows[chosen], most, copies[chosen]))
        tensors = zip(*(shown.gaussians.tensors().values() for shown in parts), strict=True)
        joined = Gaussians(*map(torch.cat, tensors))
        rows_of_parts = [shown.rows for shown in parts]
        return PageGaussians(joined, torch.cat(rows_of_parts)), [*map(len, rows_of_parts)]

    def _covers(self) -> NDArray[np.float32]:
        """Return the cover of each Gaussian, [N]."""
        covers = np.empty(len(self._gaussians), np.float32)
        scales, opacities = self._gaussians.scales.numpy(), self._gaussians.opacities.numpy()
        for start in range(0, len(covers), _AT_A_TIME):
            rows = slice(start, start + _AT_A_TIME)
            covers[rows] = cover(scales[rows], opacities[rows])
        return covers

    @property
    def merges(self) -> bool:
        """Return whether parts have fewer Gaussians than the scene, unless they are asked for whole."""
        return len(self._gaussians) > self._most

    def part(self, number: int, whole: bool = False) -> PageGaussians:
        """Return the Gaussians of a part, counted from 0; ``whole`` without merging any."""
        rows = self._rows[number]
        merges = self.merges and not whole
        return self._decimated(rows, self._most * len(rows) // len(self._gaussians) if merges else len(rows))

    def _decimated(
        self, rows: NDArray[np.integer], most: int, copies: NDArray[np.int64] | None = None
    ) -> PageGaussians:
        chosen = torch.from_numpy(rows)
        owners = None if self._owners is None else self._owners[chosen]
        decimated = decimate(self._gaussians.select(chosen), max(1, most), owners, copies)
        return PageGaussians(decimated.gaussians, chosen[decimated.rows].long())

    @cached_property
    def _rows(self) -> list[NDArray[np.int32]]:
        means = self._gaussians.means
        number = np.concatenate([self._numbers(batch) for batch in means.split(_AT_A_TIME)])
        order = number.argsort(kind="stable").astype(np.int32)
        return np.split(order, np.bincount(number, minlength=len(self)).cumsum()[:-1])

    def _numbers(self, means: Tensor) -> NDArray[np.uint16]:
        """Return the part of each mean [M, 3]."""
        if not len(self._ends):
            return np.zeros(len(means), np.uint16)
        return self._ends.searchsorted(morton_codes(means, self._around)[0].numpy(), side="right").astype(
            np.uint16
        )
