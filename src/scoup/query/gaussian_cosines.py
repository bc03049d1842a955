"""Relevancy of the Gaussians themselves, with what one text after another reuses.

A cosine is W A / sqrt(W G W^T) (method.md, stage 3). The norm depends on the codes alone, the largest cosine of the
canonical phrases on those and the phrases: each is kept, 4 bytes per Gaussian and level. A text then costs a sum of K
products per Gaussian and level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup.query.cosine_cache import FieldCodes
from scoup.query.relevancy import TEMPERATURE
from scoup.scene.codes import code_norms, code_scores, float32_products, stable_products


@dataclass(frozen=True, eq=False)
class KeptCosines:
    """What is kept of a field.

    Attributes:
        codes: of the field; kept, so that no other tensor can get the id of theirs.
        versions: of the codes at that time (``FieldCodes.versions``).
        coded: [S, N] boolean, Gaussians with a code at each level.
        inverse_norms: [N, S] 1 / sqrt(W G W^T), 0 without a code.
        canonical: [P, D] the phrases of the last question.
        best: [N, S] their largest cosine.
    """

    codes: FieldCodes
    versions: tuple[int, ...]
    coded: Tensor
    inverse_norms: Tensor
    canonical: Tensor
    best: Tensor


class GaussianCosines:
    """Relevancy of one field's Gaussians. What is kept is replaced as a whole, so that threads may share it."""

    def __init__(self) -> None:
        self._kept: KeptCosines | None = None

    def __reduce__(self) -> tuple[type[GaussianCosines], tuple[()]]:
        return GaussianCosines, ()  # a copy starts empty

    def relevancy(self, codes: FieldCodes, queries: Tensor, canonical: Tensor) -> Tensor:
        """Relevancy [S, Q, N] of each Gaussian to queries [Q, D] beside canonical phrases [P, D]."""
        kept = self._known(codes)
        if not torch.equal(kept.canonical, canonical):
            best = torch.full_like(kept.best, -torch.inf)
            for phrase in canonical:
                torch.maximum(best, _cosines(kept, phrase), out=best)
            self._kept = kept = replace(kept, canonical=canonical.clone(), best=best)
        out = torch.empty(kept.best.shape[1], len(queries), len(kept.best), device=queries.device)
        # One by one, which is quicker than columns beside each other.
        for number, query in enumerate(queries):
            own = _cosines(kept, query).sub_(kept.best).mul_(TEMPERATURE)
            out[:, number] = own.sigmoid_().T
        return out

    def coded(self, codes: FieldCodes) -> Tensor:
        """Boolean [S, N]: Gaussians with a code at each level; not to be changed."""
        return self._known(codes).coded

    def _known(self, codes: FieldCodes) -> KeptCosines:
        kept, versions = self._kept, codes.versions()
        if kept is None or kept.versions != versions:
            coded = torch.zeros(codes.weights.shape[:2], dtype=torch.bool, device=codes.weights.device)
            for weights in codes.weights.unbind(-1):
                coded |= weights > 0
            norms = code_norms(codes.indices, codes.weights, codes.codebook)
            inverse_norms = torch.where(norms > 0, 1 / norms, 0.0)
            none = codes.codebook.new_zeros(0, codes.codebook.shape[2])
            kept = KeptCosines(
                codes, versions, coded.T.contiguous(), inverse_norms, none, torch.zeros_like(norms)
            )
            self._kept = kept
        return kept


def _cosines(kept: KeptCosines, vector: Tensor) -> Tensor:
    """[N, S] cosines with a vector [D]."""
    codes = kept.codes
    products = stable_products if vector.device.type == "cpu" else float32_products
    scores = torch.stack([products(atoms, vector[None]) for atoms in codes.codebook])  # [S, L, 1]
    return code_scores(codes.indices, codes.weights, scores)[..., 0].mul_(kept.inverse_norms)
