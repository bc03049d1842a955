"""The ways compared by benchmarks/panoptic.py, each from the same region sums of one case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmarks.panoptic_maps import LEVEL, PanopticMaps, PanopticTruth, make_panoptic_maps
from scoup.coding import fit_codes
from scoup.coding.exact import solve_exact
from scoup.scene.codes import SparseCodes
from scoup.uplift.build_settings import BUILD_PRESETS
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import vote

DEFAULT, PAPER = BUILD_PRESETS["default"], BUILD_PRESETS["paper"]


class Voted(NamedTuple):
    """Codes of all Gaussians [N, 1, K], their codebook [L, D], and the vector [C, D] of each class."""

    indices: Tensor
    weights: Tensor
    codebook: Tensor
    vectors: Tensor


@dataclass(frozen=True, eq=False)
class Case:
    """One scene with the maps of one seed, rasterised.

    Attributes:
        truth, maps: see ``benchmarks.panoptic_maps``.
        sums: region sums of all building views.
        epochs: of the paper's solver.
        seed: of the maps, and of all codebooks.
    """

    truth: PanopticTruth
    maps: PanopticMaps
    sums: RegionSums
    epochs: int
    seed: int

    @classmethod
    def of(cls, truth: PanopticTruth, seed: int, epochs: int) -> Case:
        maps = make_panoptic_maps(truth, seed)
        sums = region_sums(truth.gaussians, truth.building, maps.regions)
        return cls(
            truth,
            maps,
            sums.of_views(maps.regions.view_names, [maps.regions.embeddings(LEVEL)[1]]),
            epochs,
            seed,
        )

    @cached_property
    def rows(self) -> Tensor:
        """[R, D] embeddings of the regions."""
        return torch.nn.functional.normalize(self.maps.regions.embeddings(LEVEL)[0], dim=1)

    @cached_property
    def histogram(self) -> Tensor:
        """[N, C] blending weight of each Gaussian in the regions of each class."""
        classes = np.eye(len(self.maps.vectors), dtype=np.float32)[self.maps.classes]
        return torch.from_numpy(self.sums.matrix(0) @ classes)

    @cached_property
    def learned(self) -> tuple[SparseCodes, Tensor]:
        """Codes of 4 atoms of the regions and their codebook, as the exact solver learns them."""
        solution = solve_exact(self.rows, DEFAULT.n_atoms, PAPER.k, self.seed)
        return solution.codes, solution.atoms

    @cached_property
    def default(self) -> tuple[SparseCodes, Tensor]:
        """The same of the default build."""
        book = fit_codes(self.rows, **{**DEFAULT.of_fit, "seed": self.seed})
        return book.codes, book.atoms

    @cached_property
    def paper(self) -> tuple[SparseCodes, Tensor]:
        """The same of the paper's build."""
        book = fit_codes(self.rows, **{**PAPER.of_fit, "epochs": self.epochs, "seed": self.seed})
        return book.codes, book.atoms

    def one_hot(self) -> Voted:
        """The plain vote; the class with most weight has the largest cosine where classes are at right angles."""
        codes = SparseCodes.from_dense(self.histogram, len(self.maps.vectors))
        classes = torch.eye(len(self.maps.vectors))
        return Voted(codes.indices[:, None], codes.weights[:, None], classes, classes)

    def dense(self) -> Voted:
        """The weighted mean of the embeddings, scaled to unit norm, as a sum of class vectors."""
        codes = SparseCodes.from_dense(self.histogram, len(self.maps.vectors))
        norms = torch.linalg.vector_norm(codes.to_dense() @ self.maps.vectors, dim=1).clamp(min=1e-12)
        weights = codes.weights / norms[:, None]
        return Voted(codes.indices[:, None], weights[:, None], self.maps.vectors, self.maps.vectors)

    def field(self, coded: tuple[SparseCodes, Tensor], rounds: int, keep: int | None = 4) -> Voted:
        """A language field of these codes."""
        codes, atoms = coded
        found = vote(self.sums, [codes], atoms[None], rounds, keep)
        return Voted(found.indices, found.weights, atoms, self.maps.vectors)


WAYS: dict[str, Callable[[Case], Voted]] = {
    "one-hot": Case.one_hot,
    "dense mean": Case.dense,
    "learned, one round": lambda case: case.field(case.learned, 1),
    "learned, two rounds": lambda case: case.field(case.learned, 2),
    "learned, one round, no top-K": lambda case: case.field(case.learned, 1, None),
    "default, one round": lambda case: case.field(case.default, 1),
    "default, one round, one atom kept": lambda case: case.field(case.default, 1, 1),
    "default, two rounds": lambda case: case.field(case.default, 2),
    "paper": lambda case: case.field(case.paper, 1),
    "paper, no top-K": lambda case: case.field(case.paper, 1, None),
}
