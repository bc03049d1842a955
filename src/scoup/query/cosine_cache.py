"""What later queries through one projection of a field reuse of the first.

A cosine is W A / sqrt(W G W^T) (method.md, stage 3). The norm depends on the projection and the codes; the largest
cosine of the canonical phrases depends on those and the phrases. Each is 4 bytes a pixel and level. Once both are
known, a further query is a render of one channel a level: each Gaussian's own product W A, which is linear in its code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from scoup import raster
from scoup.query.relevancy import TEMPERATURE, relevancy
from scoup.scene.codes import code_scores, float32_products, stable_products

MOST_CHANNELS = 18
"""Further queries and phrases times levels: beyond, it takes longer to render channels than cosines."""


def versions(*parts: object) -> tuple[int, ...]:
    """The state of tensors and other objects: it changes when one is replaced, and when a tensor is written to."""
    counted = [isinstance(part, Tensor) and not part.is_inference() for part in parts]
    return tuple(
        number
        for part, counts in zip(parts, counted, strict=True)
        for number in (id(part), part._version if counts else 0)  # pyright: ignore[reportAttributeAccessIssue]
    )


@dataclass(frozen=True, eq=False)
class FieldCodes:
    """The codes of a field: indices [N, S, K], weights [N, S, K] and codebook [S, L, D]."""

    indices: Tensor
    weights: Tensor
    codebook: Tensor

    def versions(self) -> tuple[int, ...]:
        """The state of each tensor: it changes when the tensor is replaced or written to."""
        return versions(self.indices, self.weights, self.codebook)


@dataclass(frozen=True, eq=False)
class CachedCosines:
    """What is kept of one projection.

    Attributes:
        codes: of the field; kept, so that no other tensor can get the id of theirs.
        versions: of the codes at that time.
        inverse_norms: [H, W, S] 1 / sqrt(W G W^T), 0 where no code is rendered.
        canonical: [P, D] the phrases of the last query.
        best: [H, W, S] their largest cosine.
    """

    codes: FieldCodes
    versions: tuple[int, ...]
    inverse_norms: Tensor
    canonical: Tensor
    best: Tensor


class CosineCache:
    """Relevancy of one field, with something kept of each projection for as long as the projection lives."""

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[raster.Projection, CachedCosines] = WeakKeyDictionary()

    def __len__(self) -> int:
        """How many projections something is kept of."""
        return len(self._kept)

    def __reduce__(self) -> tuple[type[CosineCache], tuple[()]]:
        return CosineCache, ()  # the copy of a field, in another process too, starts empty

    def relevancy(
        self, projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
    ) -> Tensor:
        """Relevancy [S, Q, H, W] of each pixel to queries [Q, D] beside canonical phrases [P, D]."""
        kept = self._kept.get(projection)
        if kept is not None and kept.versions != codes.versions():
            kept = None
        same_phrases = kept is not None and torch.equal(kept.canonical, canonical)
        vectors = queries if same_phrases else torch.cat([queries, canonical])
        if kept is None or len(vectors) * len(codes.codebook) > MOST_CHANNELS:
            found, self._kept[projection] = full_relevancy(projection, codes, queries, canonical)
            return found
        cosines = channel_cosines(projection, codes, vectors, kept.inverse_norms)
        own, others = cosines[..., : len(queries)], cosines[..., len(queries) :]
        if not same_phrases:
            kept = replace(kept, canonical=canonical.clone(), best=others.amax(-1))
            self._kept[projection] = kept
        maps = own.sub_(kept.best[..., None]).mul_(TEMPERATURE).sigmoid_()
        return maps.permute(2, 3, 0, 1).contiguous()


def full_relevancy(
    projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
) -> tuple[Tensor, CachedCosines]:
    """Relevancy [S, Q, H, W] from cosines rendered in full, and what further queries can reuse."""
    both = torch.cat([queries, canonical])
    cosines, norms = raster.render_cosines_and_norms(
        projection, codes.indices, codes.weights, codes.codebook, both
    )
    own, others = cosines[:, : len(queries)], cosines[:, len(queries) :]
    kept = CachedCosines(
        codes,
        codes.versions(),
        torch.where(norms > 0, 1 / norms, 0.0).permute(1, 2, 0).contiguous(),
        canonical.clone(),
        others.amax(1).permute(1, 2, 0).contiguous(),
    )
    return relevancy(own, others), kept


def channel_cosines(
    projection: raster.Projection, codes: FieldCodes, vectors: Tensor, inverse_norms: Tensor
) -> Tensor:
    """[H, W, S, Q] cosines with vectors [Q, D] by one rendered channel a vector and level.

    They differ from those of ``raster.render_cosines`` by rounding only: the order of sums over Gaussians and atoms is
    another.

    Args:
        inverse_norms: [H, W, S], see ``CachedCosines``.
    """
    products = stable_products if vectors.device.type == "cpu" else float32_products
    scores = torch.stack([products(atoms, vectors) for atoms in codes.codebook])  # [S, L, Q]
    values = code_scores(codes.indices, codes.weights, scores)  # [N, S, Q]
    image, _ = raster.render_channels(projection, values.flatten(1))
    return image.view(projection.height, projection.width, *values.shape[1:]).mul_(inverse_norms[..., None])
