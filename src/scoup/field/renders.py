"""Renders of a field, and relevancy to vectors that come from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.field.relevancy import GaussianCosines, relevancy
from scoup.scene.directions import query_vectors

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.scene.cameras import Camera

GAUSSIANS_AT_A_TIME = 65536
LEAST_ALPHA = 0.5  # of a pixel with a depth

Vectors: TypeAlias = "Tensor | ArrayLike"


def fresh_relevancy(
    field: LanguageField, camera: Camera | str | int, queries: Vectors, canonical: Vectors
) -> Tensor:
    """Return the relevancy of every pixel; ``LanguageField.relevancy`` documents it."""
    queries, canonical = checked_vectors(field, queries, canonical)
    codes, both = field.codes, torch.cat([queries, canonical])
    cosines = raster.render_cosines(field.project(camera), codes.indices, codes.weights, codes.codebook, both)
    return relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])


def gaussian_relevancy(field: LanguageField, queries: Vectors, canonical: Vectors) -> Tensor:
    """Return the relevancy of every Gaussian; ``LanguageField.gaussian_relevancy`` documents it."""
    queries, canonical = checked_vectors(field, queries, canonical)
    norms = field.kept("inverse norms", field.codes.inverse_norms)
    key = "largest cosines", canonical.cpu().numpy().tobytes()
    return field.kept(key, lambda: GaussianCosines.of(field.codes, norms, canonical)).relevancy(queries)


def checked_vectors(field: LanguageField, queries: Vectors, canonical: Vectors) -> tuple[Tensor, Tensor]:
    """Return queries [Q, D] and phrases [P, D] as float32 on the field's device."""
    try:
        queries = query_vectors(queries, field.dim)
        canonical = query_vectors(canonical, field.dim, "canonical", lengthen=False)
    except InputError as error:
        raise InputError(
            f"{error}; this field contains embeddings of {field.embedding_model or 'an unnamed model'} with "
            f"{field.dim} dimensions"
        ) from error
    device = field.codebook.device
    return queries.to(device), canonical.to(device)


def render_codes(field: LanguageField, projection: raster.Projection) -> Tensor:
    """Render the coefficients of every level, [S, H, W, L] float32."""
    return raster.render_codes(projection, field.code_indices, field.code_weights, field.n_atoms)


def render_features(field: LanguageField, projection: raster.Projection, level: str | int) -> Tensor:
    """Render decoded features of one level, [H, W, D] float32, unit norm or, where nothing is rendered, zero."""
    index = field.level_index(level)
    chosen = slice(index, index + 1)
    indices, weights = field.code_indices[:, chosen], field.code_weights[:, chosen]
    return raster.render_features(projection, indices, weights, field.codebook[chosen])[0]


def render_depth(field: LanguageField, projection: raster.Projection, camera: Camera) -> Tensor:
    """Return the mean distance along the view direction by blending weights, in world units, [H, W] float32 on the CPU;
    NaN where alpha is below ``LEAST_ALPHA``.
    """
    means = field.gaussians.means.double()
    row = camera.viewmat[2].to(means.device)
    distances = (means @ row[:3] + row[3]).float().nan_to_num(0.0, 0.0, 0.0)
    image, alpha = raster.render_channels(projection, distances[:, None])
    return torch.where(alpha >= LEAST_ALPHA, image[..., 0] / alpha.clamp(min=1e-9), torch.nan).cpu()


def gaussian_features(field: LanguageField, level: str | int) -> Tensor:
    """Return the decoded codes of all Gaussians at one level, [N, D] float32, unit norm; zero without a code."""
    index, device = field.level_index(level), field.codebook.device
    out = torch.empty(len(field), field.dim, device=device)
    for start in range(0, len(field), GAUSSIANS_AT_A_TIME):
        rows = slice(start, start + GAUSSIANS_AT_A_TIME)
        indices, weights = field.code_indices[rows, index].long(), field.code_weights[rows, index]
        dense = torch.zeros(len(indices), field.n_atoms, device=device)
        dense.scatter_add_(1, indices, weights.float())
        out[rows] = torch.nn.functional.normalize(dense @ field.codebook[index], dim=1)
    return out
