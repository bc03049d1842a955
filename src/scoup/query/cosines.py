"""Relevancy of a field's pixels and Gaussians, and what one query after another reuses of it.

A cosine is W A / sqrt(W G W^T) (method.md, stage 3). The norm depends on the codes, for pixels also on the projection;
the largest cosine of the canonical phrases also on the phrases. Each is kept: 4 bytes per level and Gaussian, and per
level and pixel while the projection lives. Once both are known, a further query costs a sum of K products per Gaussian
and level, or a render of one channel per level: each Gaussian's own product W A, which is linear in its code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from scoup import raster
from scoup.query.relevancy import TEMPERATURE, relevancy
from scoup.scene.code_sums import (
    atom_products,
    best_code_cosines,
    code_relevancy,
    code_scores,
    inverse_code_norms,
)

MOST_CHANNELS = 18
"""Further queries and phrases times levels: beyond, it takes longer to render channels than cosines."""


def versions(*parts: object) -> tuple[int, ...]:
    """Return the state of tensors and other objects: it changes when one is replaced or a tensor is written to."""
    counted = [isinstance(part, Tensor) and not part.is_inference() for part in parts]
    return tuple(
        number
        for part, counts in zip(parts, counted, strict=True)
        for number in (id(part), part._version if counts else 0)  # pyright: ignore[reportAttributeAccessIssue]
    )


@dataclass(frozen=True, eq=False)
class FieldCodes:
    """The codes of a field."""

    indices: Tensor  # [N, S, K]
    weights: Tensor  # [N, S, K]
    codebook: Tensor  # [S, L, D]

    def versions(self) -> tuple[int, ...]:
        """Return the state of each tensor."""
        return versions(self.indices, self.weights, self.codebook)


@dataclass(frozen=True, eq=False)
class KeptCosines:
    """Cached cosines of the pixels of one projection, [H, W, S], or of all Gaussians, [N, S]."""

    codes: FieldCodes  # kept alive, so that no other tensor can get the id of theirs
    versions: tuple[int, ...]  # of the codes at that time
    inverse_norms: Tensor  # 1 / sqrt(W G W^T), 0 without a code
    canonical: Tensor  # [P, D], the phrases of the last query
    best: Tensor  # their largest cosine


class FieldCosines:
    """Relevancy of one field. What is kept is replaced as a whole, so that threads may share it; copies start empty."""

    def __init__(self) -> None:
        self._pixels: WeakKeyDictionary[raster.Projection, KeptCosines] = WeakKeyDictionary()
        self._gaussians: tuple[KeptCosines, Tensor] | None = None

    def __reduce__(self) -> tuple[type[FieldCosines], tuple[()]]:
        return FieldCosines, ()

    def __len__(self) -> int:
        """Return the number of cached projections."""
        return len(self._pixels)

    def of_pixels(
        self, projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
    ) -> Tensor:
        """Return the relevancy [S, Q, H, W] of each pixel to queries [Q, D] beside canonical phrases [P, D]."""
        kept = self._pixels.get(projection)
        if kept is not None and kept.versions != codes.versions():
            kept = None
        same_phrases = kept is not None and torch.equal(kept.canonical, canonical)
        vectors = queries if same_phrases else torch.cat([queries, canonical])
        if kept is None or len(vectors) * len(codes.codebook) > MOST_CHANNELS:
            maps, self._pixels[projection] = _rendered_in_full(projection, codes, queries, canonical)
            return maps
        cosines = _channel_cosines(projection, codes, vectors, kept.inverse_norms)
        own, others = cosines[..., : len(queries)], cosines[..., len(queries) :]
        if not same_phrases:
            kept = replace(kept, canonical=canonical.clone(), best=others.amax(-1))
            self._pixels[projection] = kept
        maps = own.sub_(kept.best[..., None]).mul_(TEMPERATURE).sigmoid_()
        return maps.permute(2, 3, 0, 1).contiguous()

    def of_gaussians(self, codes: FieldCodes, queries: Tensor, canonical: Tensor) -> Tensor:
        """Return the relevancy [S, Q, N] of each Gaussian to queries [Q, D] beside canonical phrases [P, D]."""
        kept, coded = self._known_gaussians(codes)
        if not torch.equal(kept.canonical, canonical):
            scores = _atom_scores(codes, canonical)
            best = best_code_cosines(codes.indices, codes.weights, kept.inverse_norms, scores)
            kept = replace(kept, canonical=canonical.clone(), best=best)
            self._gaussians = kept, coded
        # Query by query, so that its company does not change the last bit.
        scores = [_atom_scores(codes, query[None]) for query in queries] or [_atom_scores(codes, queries)]
        return code_relevancy(
            codes.indices, codes.weights, kept.inverse_norms, kept.best, torch.cat(scores, 2), TEMPERATURE
        )

    def coded(self, codes: FieldCodes) -> Tensor:
        """Return which Gaussians have a code at each level, boolean [S, N]; do not change it."""
        return self._known_gaussians(codes)[1]

    def _known_gaussians(self, codes: FieldCodes) -> tuple[KeptCosines, Tensor]:
        known, versions = self._gaussians, codes.versions()
        if known is None or known[0].versions != versions:
            coded = torch.zeros(codes.weights.shape[:2], dtype=torch.bool, device=codes.weights.device)
            for weights in codes.weights.unbind(-1):
                coded |= weights > 0
            inverse_norms = inverse_code_norms(codes.indices, codes.weights, codes.codebook)
            none = codes.codebook.new_zeros(0, codes.codebook.shape[2])
            kept = KeptCosines(codes, versions, inverse_norms, none, torch.zeros_like(inverse_norms))
            self._gaussians = known = kept, coded.T.contiguous()
        return known


def _rendered_in_full(
    projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
) -> tuple[Tensor, KeptCosines]:
    """Relevancy [S, Q, H, W], and what further queries can reuse."""
    both = torch.cat([queries, canonical])
    cosines, norms = raster.render_cosines_and_norms(
        projection, codes.indices, codes.weights, codes.codebook, both
    )
    own, others = cosines[:, : len(queries)], cosines[:, len(queries) :]
    kept = KeptCosines(
        codes,
        codes.versions(),
        torch.where(norms > 0, 1 / norms, 0.0).permute(1, 2, 0).contiguous(),
        canonical.clone(),
        others.amax(1).permute(1, 2, 0).contiguous(),
    )
    return relevancy(own, others), kept


def _channel_cosines(
    projection: raster.Projection, codes: FieldCodes, vectors: Tensor, inverse_norms: Tensor
) -> Tensor:
    """[H, W, S, Q] cosines with vectors [Q, D] by one rendered channel per vector and level.

    They differ from those of ``raster.render_cosines`` only by rounding: sums over Gaussians and atoms have another
    order.
    """
    values = _code_products(codes, vectors)
    image = raster.render_values(projection, values.flatten(1))
    return image.view(projection.height, projection.width, *values.shape[1:]).mul_(inverse_norms[..., None])


def _code_products(codes: FieldCodes, vectors: Tensor) -> Tensor:
    """[N, S, Q] products W A of the codes with vectors [Q, D]."""
    return code_scores(codes.indices, codes.weights, _atom_scores(codes, vectors))


def _atom_scores(codes: FieldCodes, vectors: Tensor) -> Tensor:
    """[S, L, Q] products of the atoms with vectors [Q, D]."""
    return torch.stack([atom_products(atoms, vectors) for atoms in codes.codebook])
