"""Relevancy of Gaussians and pixels to queries (method.md, stage 3), without decoding, and what further queries reuse.

A cosine is W A / sqrt(W G W^T). The norm depends on the codes, for pixels also on the projection; the largest cosine of
the canonical phrases also on the phrases. Once both are known, a further query costs a sum of K products per Gaussian
and level, or a render of one channel per level: each Gaussian's own product W A, which is linear in its code.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError
from scoup.field.code_sums import (
    atom_products,
    best_code_cosines,
    code_relevancy,
    code_scores,
    inverse_code_norms,
)
from scoup.scene import rows_of

TEMPERATURE = 10.0
MOST_CHANNELS = 18
"""Further queries and phrases times levels: beyond, it takes longer to render channels than cosines."""
GAUSSIANS_AT_A_TIME = 65536


def relevancy(
    cosines: Tensor,  # [S, Q, ...] of queries, per level; of pixels or Gaussians
    canonical: Tensor,  # [S, P, ...] of canonical phrases, one at least
    temperature: float = TEMPERATURE,
) -> Tensor:
    """Return the advantage of a query over the best canonical phrase, [S, Q, ...] in 0..1; 0.5 is a draw.

    It is min over k of exp(a q) / (exp(a q) + exp(a canon_k)), computed as sigmoid(a (q - max_k canon_k)) with the
    temperature a. Where nothing is rendered, all cosines are 0 and relevancy is 0.5.
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


@dataclass(frozen=True, eq=False)
class FieldCodes:
    """The codes of N Gaussians."""

    indices: Tensor  # [N, S, K]
    weights: Tensor  # [N, S, K]
    codebook: Tensor  # [S, L, D]

    def inverse_norms(self) -> Tensor:
        """Return 1 / sqrt(W G W^T), [N, S] float32; 0 without a code."""
        grams = torch.stack([atom_products(atoms, atoms) for atoms in self.codebook.float()])
        return inverse_code_norms(self.indices, self.weights, grams)

    def coded(self) -> Tensor:
        """Return the mask of Gaussians with a code at each level, boolean [S, N]."""
        mask = torch.zeros(self.weights.shape[:2], dtype=torch.bool, device=self.weights.device)
        for weights in self.weights.unbind(-1):
            mask |= weights > 0
        return mask.T.contiguous()

    def atom_scores(self, vectors: Tensor) -> Tensor:
        """Return the products [S, L, Q] of the atoms with vectors [Q, D]."""
        return torch.stack([atom_products(atoms, vectors) for atoms in self.codebook])

    def cosines(self, canonical: Tensor, inverse_norms: Tensor) -> GaussianCosines:
        """Compare the codes, whose norms are known, with canonical phrases [P, D]."""
        best = best_code_cosines(self.indices, self.weights, self.atom_scores(canonical), inverse_norms)
        return GaussianCosines(self, inverse_norms, best)

    def features(self, level: int) -> Tensor:
        """Return the decoded codes of all Gaussians at one level, [N, D] float32, unit norm; zero without a code."""
        _, n_atoms, dim = self.codebook.shape
        out = torch.empty(len(self.indices), dim, device=self.codebook.device)
        for start in range(0, len(out), GAUSSIANS_AT_A_TIME):
            rows = slice(start, start + GAUSSIANS_AT_A_TIME)
            indices, weights = self.indices[rows, level].long(), self.weights[rows, level]
            dense = torch.zeros(len(indices), n_atoms, device=out.device)
            dense.scatter_add_(1, indices, weights.float())
            out[rows] = torch.nn.functional.normalize(dense @ self.codebook[level], dim=1)
        return out

    def rows(self, chosen: Tensor | slice) -> FieldCodes:
        """Return the codes of some Gaussians."""
        return FieldCodes(rows_of(self.indices, chosen), self.weights[chosen], self.codebook)

    def cpu(self) -> FieldCodes:
        """Return the codes on the CPU."""
        return FieldCodes(self.indices.cpu(), self.weights.cpu(), self.codebook.cpu())


@dataclass(frozen=True, eq=False)
class GaussianCosines:
    """Codes, and their largest cosine with canonical phrases."""

    codes: FieldCodes
    inverse_norms: Tensor  # [N, S]
    best: Tensor  # [N, S]

    @property
    def nbytes(self) -> int:
        """Bytes of the largest cosines: codes and norms are counted by themselves."""
        return self.best.nbytes

    def relevancy(self, queries: Tensor) -> Tensor:
        """Return the relevancy [S, Q, N] of each Gaussian to queries [Q, D]."""
        codes = self.codes
        # Query by query, so that other queries do not change the last bit.
        scores = [codes.atom_scores(query[None]) for query in queries] or [codes.atom_scores(queries)]
        parts = codes.indices, codes.weights, torch.cat(scores, 2), self.inverse_norms, self.best
        return code_relevancy(*parts, TEMPERATURE).transpose(0, 1)  # what belongs to one query is contiguous


@dataclass(frozen=True, eq=False)
class PixelCosines:
    """Terms of the cosines of one view's pixels that further queries reuse."""

    inverse_norms: Tensor  # [H, W, S], 0 without a code
    canonical: Tensor  # [P, D], the phrases of the last query
    best: Tensor  # [H, W, S], their largest cosine


def pixel_relevancy(
    projection: raster.Projection,
    codes: FieldCodes,
    queries: Tensor,
    canonical: Tensor,
    known: PixelCosines | None,
) -> tuple[Tensor, PixelCosines]:
    """Return the relevancy [S, Q, H, W] of each pixel to queries [Q, D] beside canonical phrases [P, D], of unit norm;
    and what to pass as ``known`` to the next call for this projection and these codes, None at first."""
    same_phrases = known is not None and torch.equal(known.canonical, canonical)
    vectors = queries if same_phrases else torch.cat([queries, canonical])
    if known is None or len(vectors) * len(codes.codebook) > MOST_CHANNELS:
        maps, pixel_cosines = _rendered_in_full(projection, codes, queries, canonical)
        return maps, known if known is not None and same_phrases else pixel_cosines
    cosines = _channel_cosines(projection, codes, vectors, known.inverse_norms)
    if not same_phrases:
        cosines, others = cosines[..., : len(queries)], cosines[..., len(queries) :]
        known = PixelCosines(known.inverse_norms, canonical.clone(), others.amax(-1))
    maps = cosines.sub_(known.best[..., None]).mul_(TEMPERATURE).sigmoid_()
    return maps.permute(2, 3, 0, 1).contiguous(), known


def _rendered_in_full(
    projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
) -> tuple[Tensor, PixelCosines]:
    both = torch.cat([queries, canonical])
    cosines, norms = raster.render_cosines_and_norms(
        projection, codes.indices, codes.weights, codes.codebook, both
    )
    of_queries, others = cosines[:, : len(queries)], cosines[:, len(queries) :]
    known = PixelCosines(
        torch.where(norms > 0, 1 / norms, 0.0).permute(1, 2, 0).contiguous(),
        canonical.clone(),
        others.amax(1).permute(1, 2, 0).contiguous(),
    )
    return relevancy(of_queries, others), known


def _channel_cosines(
    projection: raster.Projection, codes: FieldCodes, vectors: Tensor, inverse_norms: Tensor
) -> Tensor:
    """[H, W, S, Q] cosines with vectors [Q, D] by one rendered channel per vector and level.

    They differ from those of ``raster.render_cosines`` only by rounding: sums over Gaussians and atoms have another
    order.
    """
    values = code_scores(codes.indices, codes.weights, codes.atom_scores(vectors))  # [N, S, Q]
    image = raster.render_values(projection, values.flatten(1))
    return image.view(projection.height, projection.width, *values.shape[1:]).mul_(inverse_norms[..., None])
