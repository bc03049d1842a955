"""Sparse codes as a method: learned for the regions, voted onto the Gaussians, by the settings of a build."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from scoup.base import Progress, no_progress
from scoup.uplift import BuildSettings, GaussianCodes, vote
from scoup_lab.baselines.fitted import FittedField, fitted_field
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import UpliftInputs

Half = Literal["highest", "lowest"]
"""The half of the Gaussians whose votes have the highest or the lowest entropy."""


class SparseUplift:
    """Sparse codes and a vote by the settings of a build."""

    def __init__(self, dropped: Half | None = None, **changes: Any) -> None:
        self.dropped: Half | None = dropped
        self.changes = changes

    def __call__(self, inputs: UpliftInputs, settings: MethodSettings) -> FittedField:
        build = replace(settings.build, seed=settings.seed, **self.changes)
        codes, codebook = vote_codes(inputs, build, settings.progress)
        if self.dropped is not None:
            whole, _ = vote_codes(inputs, replace(build, keep=0), settings.progress)
            codes = without_half(codes, whole, self.dropped)
        things = inputs.things() if build.things else None
        return fitted_field(inputs.sums, codes.indices, codes.weights, codebook, not build.keep, things)


def vote_codes(
    inputs: UpliftInputs, build: BuildSettings, progress: Progress = no_progress
) -> tuple[GaussianCodes, Tensor]:
    """Return codes of the Gaussians, and the codebook [S, L, D]."""
    codes, codebook = inputs.codes(build, progress)
    return vote(inputs.sums, codes, codebook, build.rounds, build.keep or None, progress=progress), codebook


def without_half(codes: GaussianCodes, whole: GaussianCodes, half: Half) -> GaussianCodes:
    """Return codes without those of the Gaussians in the half with the highest (or lowest) entropy of their
    whole votes. *Choice*: halves are taken at each level, among Gaussians that have votes there."""
    entropy = vote_entropy(whole.weights)
    voted = whole.weights.any(-1)
    mask = torch.zeros_like(voted)
    for level in range(voted.shape[1]):
        members = voted[:, level].nonzero()[:, 0]
        order = members[torch.argsort(entropy[members, level], stable=True)]
        middle = len(order) // 2
        mask[order[:middle] if half == "highest" else order[middle:], level] = True
    return replace(codes, weights=torch.where(mask[..., None], codes.weights, 0.0))


def vote_entropy(weights: Tensor) -> Tensor:
    """Return [N, S] float32 entropy of votes, 0 (all views agree) to 1; 1 for a Gaussian without a code.

    ``weights``: [N, S, K] not negative: those of codes as stored, or of all atoms.
    """
    weights = weights.float()
    total = weights.sum(-1, keepdim=True)
    share = torch.where(total > 0, weights / total.clamp(min=1e-30), 0.0)
    entropy = torch.special.entr(share).sum(-1) / torch.tensor(float(max(2, weights.shape[-1]))).log()
    return torch.where(total[..., 0] > 0, entropy, 1.0)
