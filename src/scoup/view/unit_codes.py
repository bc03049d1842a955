"""The codes of a field scaled so that a sum of few products is the cosine of a Gaussian with a text."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.field import Field


@dataclass(frozen=True, eq=False)
class UnitCodes:
    """Codes whose decoded features have norm 1. Tensors are on the CPU.

    The cosine of a Gaussian with a text is (w A) / sqrt(w G w^T) with A = C T^T and G = C C^T (method.md, stage 3).
    The divisor does not depend on the text: it is taken out of the weights once.
    """

    indices: Tensor  # [N, S, K] as in the field
    weights: (
        Tensor  # [N, S, K] float32, divided by the norm of the decoded code; zeros where there is no code
    )
    confidence: Tensor  # [N, S] float32
    """0 to 1, norm of the decoded code when its weights sum to 1: 1 where all regions that voted for the Gaussian have
    one embedding, and less the more they differ; 0 where there is no code."""

    @classmethod
    def of(cls, field: Field, rows: Tensor | slice = slice(None)) -> UnitCodes:
        """Return the unit codes of a field, or of some rows of it, on the CPU."""
        codes = field.codes.cpu().rows(rows)
        weights, inverse_norms = codes.weights.float(), codes.inverse_norms()
        lengths = weights.sum(-1) * inverse_norms
        confidence = torch.where(lengths > 0, 1 / lengths, 0.0).clamp(0, 1)
        unit = weights * inverse_norms[..., None]
        return cls(codes.indices, unit, confidence)

    def __len__(self) -> int:
        return len(self.indices)


def atom_scores(field: Field, vectors: Tensor) -> Tensor:
    """Return [S, L, Q] float32 on the CPU: inner products A = C T^T of the codebooks and text vectors [Q, D]."""
    return field.codebook.float().cpu() @ vectors.float().cpu().T
