"""Sparse codes as a method: learned for the regions, voted onto the Gaussians, by the settings of a build."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from scoup.coding import fit_codes
from scoup.coding.adam import AdamSettings, solve_adam
from scoup.scene.directions import normalise_embeddings
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.vote import GaussianCodes, vote
from scoup_lab.baselines.fitted import FittedField, fitted_field
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import Coder, Codes, UpliftInputs

Half = Literal["highest", "lowest"]
"""The half of the Gaussians whose votes have the highest or the lowest entropy."""


def learn_codes(embeddings: Sequence[Tensor], settings: BuildSettings) -> Codes:
    """Return codes of the regions of each level, as ``scoup.build`` learns them."""
    books = [fit_codes(rows, **settings.of_fit) for rows in embeddings]
    return [book.codes for book in books], torch.stack([book.atoms for book in books])


@dataclass(frozen=True)
class AdamCoder:
    """Codes by the paper's solver, from a start of choice."""

    # of the atoms; None is the solver's own k-means
    start: Literal["random regions", "random directions"] | None = None
    logit_scale: float = 4.0  # first logits are this times the cosine to each atom; 0 starts all equal

    def __call__(self, embeddings: Sequence[Tensor], settings: BuildSettings) -> Codes:
        adam = AdamSettings(settings.epochs, logit_scale=self.logit_scale)
        codes, atoms = [], []
        for rows in embeddings:
            unit = normalise_embeddings(rows)
            first = self.first_atoms(unit, settings.n_atoms, settings.seed)
            solution = solve_adam(
                unit, settings.n_atoms, settings.k, settings.seed, adam, initial_atoms=first
            )
            codes.append(solution.codes)
            atoms.append(solution.atoms)
        return codes, torch.stack(atoms)

    def first_atoms(self, rows: Tensor, n_atoms: int, seed: int) -> Tensor | None:
        """Return [L, D] first atoms for unit rows [R, D]; None for the solver's own."""
        random = torch.Generator().manual_seed(seed)
        if self.start == "random regions":
            return rows[torch.randint(len(rows), (n_atoms,), generator=random)]
        if self.start == "random directions":
            return torch.nn.functional.normalize(torch.randn(n_atoms, rows.shape[1], generator=random), dim=1)
        return None


class SparseUplift:
    """Sparse codes and a vote by the settings of a build."""

    def __init__(self, coder: Coder = learn_codes, dropped: Half | None = None, **changes: Any) -> None:
        self.coder = coder
        self.dropped: Half | None = dropped
        self.changes = changes

    def __call__(self, inputs: UpliftInputs, settings: MethodSettings) -> FittedField:
        build = replace(settings.build, seed=settings.seed, **self.changes)
        found, codebook = vote_codes(inputs, build, self.coder)
        if self.dropped is not None:
            whole, _ = vote_codes(inputs, build, self.coder, all_kept=True)
            found = without_half(found, whole, self.dropped)
        things = inputs.things() if build.things else None
        return fitted_field(inputs.sums, found.indices, found.weights, codebook, not build.keep, things)


def vote_codes(
    inputs: UpliftInputs, build: BuildSettings, coder: Coder = learn_codes, all_kept: bool = False
) -> tuple[GaussianCodes, Tensor]:
    """Return codes of the Gaussians, and the codebook [S, L, D]; ``all_kept`` keeps every atom whatever the
    settings say."""
    codes, codebook = inputs.codes(coder, build)
    keep = None if all_kept else build.keep or None
    return vote(inputs.sums, codes, codebook, build.rounds, keep, build.keep or build.k), codebook


def without_half(found: GaussianCodes, whole: GaussianCodes, half: Half) -> GaussianCodes:
    """Return codes without those of the Gaussians in the half with the highest (or lowest) entropy of their
    whole votes. *Choice*: halves are taken at each level, among Gaussians that have votes there."""
    entropy = vote_entropy(whole.weights)
    voted = whole.weights.any(-1)
    kept = torch.zeros_like(voted)
    for level in range(voted.shape[1]):
        members = voted[:, level].nonzero()[:, 0]
        order = members[torch.argsort(entropy[members, level], stable=True)]
        middle = len(order) // 2
        kept[order[:middle] if half == "highest" else order[middle:], level] = True
    return replace(found, weights=torch.where(kept[..., None], found.weights, 0.0))


def vote_entropy(weights: Tensor) -> Tensor:
    """Return [N, S] float32 entropy of votes, 0 (all views agree) to 1; 1 for a Gaussian without a code.

    ``weights``: [N, S, K] not negative: those of codes as stored, or of all atoms.
    """
    weights = weights.float()
    total = weights.sum(-1, keepdim=True)
    share = torch.where(total > 0, weights / total.clamp(min=1e-30), 0.0)
    found = torch.special.entr(share).sum(-1) / torch.tensor(float(max(2, weights.shape[-1]))).log()
    return torch.where(total[..., 0] > 0, found, 1.0)
