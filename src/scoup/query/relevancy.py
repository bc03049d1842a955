"""Relevancy from cosines (method.md, stage 3)."""

from __future__ import annotations

from torch import Tensor

from scoup.base.errors import InputError

TEMPERATURE = 10.0


def relevancy(
    cosines: Tensor,  # [S, Q, ...]
    canonical: Tensor,  # [S, P, ...]
    temperature: float = TEMPERATURE,
) -> Tensor:
    """Return how much better a query fits than the best canonical phrase, [S, Q, ...] in 0..1; 0.5 is a draw.

    It is min over k of exp(a q) / (exp(a q) + exp(a canon_k)), computed as sigmoid(a (q - max_k canon_k)). Where
    nothing is rendered, all cosines are 0 and relevancy is 0.5.

    Args:
        cosines: of Q queries, per level; the trailing shape is free (pixels, Gaussians).
        canonical: of P >= 1 canonical phrases.
        temperature: a.
    """
    if cosines.dim() < 2 or cosines.dim() != canonical.dim():
        raise InputError(
            f"cosines {list(cosines.shape)} and canonical {list(canonical.shape)} must be [S, Q or P, ...]"
        )
    if cosines.shape[0] != canonical.shape[0] or cosines.shape[2:] != canonical.shape[2:]:
        raise InputError(
            f"cosines {list(cosines.shape)} and canonical {list(canonical.shape)} differ beyond axis 1"
        )
    if canonical.shape[1] == 0:
        raise InputError("relevancy needs at least one canonical phrase")
    # In place after the first step: maps of all pixels are large.
    return (cosines - canonical.amax(1, keepdim=True)).mul_(temperature).sigmoid_()
