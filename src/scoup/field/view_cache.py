"""Asking one view of a field several times: what no query changes is kept with the view.

A cosine is W A / sqrt(W G W^T) (method.md, stage 3). The norm below depends on the view and the codes, the largest
cosine of the canonical phrases on those and the phrases. Both are 4 bytes a pixel and level; with them at hand, a
further query is a render of one channel a level: each Gaussian's own product W A, which is linear in its code.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from scoup import raster
from scoup.field.relevancy import TEMPERATURE, relevancy
from scoup.scene.codes import code_scores, float32_products, stable_products

MOST_CHANNELS = 18
"""Further queries and phrases times levels: beyond, it takes longer to render channels than cosines."""


@dataclass(frozen=True, eq=False)
class FieldCodes:
    """The codes that are asked: indices [N, S, K], weights [N, S, K] and codebook [S, L, D]."""

    indices: Tensor
    weights: Tensor
    codebook: Tensor

    def versions(self) -> tuple[int, ...]:
        """Which state of each tensor this is: it changes with its object and when it is written to."""
        tensors = (self.indices, self.weights, self.codebook)
        return tuple(
            number
            for tensor in tensors
            for number in (id(tensor), 0 if tensor.is_inference() else tensor._version)
        )


@dataclass(frozen=True, eq=False)
class KeptAnswers:
    """What is kept of one view.

    Attributes:
        codes: that were asked; kept, so that no other tensor can take the place of theirs.
        versions: of the codes when they were asked.
        inverse_norms: [H, W, S] 1 / sqrt(W G W^T), 0 where no code reaches.
        canonical: [P, D] the phrases asked last.
        best: [H, W, S] their largest cosine.
    """

    codes: FieldCodes
    versions: tuple[int, ...]
    inverse_norms: Tensor
    canonical: Tensor
    best: Tensor


class AskedViews:
    """The views that one field was asked through, each with what is kept of it for as long as the view lives."""

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[raster.Projection, KeptAnswers] = WeakKeyDictionary()

    def __reduce__(self) -> tuple[type[AskedViews], tuple[()]]:
        return AskedViews, ()  # a copy of a field, in another process too, begins with none

    def relevancy(
        self, view: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
    ) -> Tensor:
        """Relevancy [S, Q, H, W] of each pixel to queries [Q, D] beside canonical phrases [P, D]."""
        kept = self._kept.get(view)
        if kept is not None and kept.versions != codes.versions():
            kept = None
        known = kept is not None and torch.equal(kept.canonical, canonical)
        asked = queries if known else torch.cat([queries, canonical])
        if kept is None or len(asked) * len(codes.codebook) > MOST_CHANNELS:
            found, self._kept[view] = first_answers(view, codes, queries, canonical)
            return found
        cosines = further_cosines(view, codes, asked, kept.inverse_norms)
        own = cosines[..., : len(queries)]
        best = kept.best if known else cosines[..., len(queries) :].amax(-1)
        if not known:
            self._kept[view] = KeptAnswers(codes, kept.versions, kept.inverse_norms, canonical.clone(), best)
        maps = own.sub_(best[..., None]).mul_(TEMPERATURE).sigmoid_()
        return maps.permute(2, 3, 0, 1).contiguous()


def first_answers(
    view: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
) -> tuple[Tensor, KeptAnswers]:
    """Relevancy [S, Q, H, W], and what further queries can go by."""
    both = torch.cat([queries, canonical])
    cosines, norms = raster.render_cosines_and_norms(view, codes.indices, codes.weights, codes.codebook, both)
    own, others = cosines[:, : len(queries)], cosines[:, len(queries) :]
    kept = KeptAnswers(
        codes,
        codes.versions(),
        torch.where(norms > 0, 1 / norms, 0.0).permute(1, 2, 0).contiguous(),
        canonical.clone(),
        others.amax(1).permute(1, 2, 0).contiguous(),
    )
    return relevancy(own, others), kept


def further_cosines(
    view: raster.Projection, codes: FieldCodes, queries: Tensor, inverse_norms: Tensor
) -> Tensor:
    """[H, W, S, Q] cosines, the norms [H, W, S] known. Other than those of ``raster.render_cosines`` by rounding
    only: sums over Gaussians and atoms are taken in another order.
    """
    products = stable_products if queries.device.type == "cpu" else float32_products
    scores = torch.stack([products(atoms, queries) for atoms in codes.codebook])  # [S, L, Q]
    worth = code_scores(codes.indices, codes.weights, scores)  # [N, S, Q]
    image, _ = raster.render_channels(view, worth.flatten(1))
    return image.view(view.height, view.width, *worth.shape[1:]).mul_(inverse_norms[..., None])
