"""Renders of codes, and features and vectors of their embedding space."""

from __future__ import annotations

from typing import TypeAlias

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base import InputError
from scoup.field.cosines import FieldCodes, relevancy
from scoup.scene import query_vectors

GAUSSIANS_AT_A_TIME = 65536

Vectors: TypeAlias = "Tensor | ArrayLike"


def checked_vectors(
    codes: FieldCodes, model: str, queries: Vectors, canonical: Vectors
) -> tuple[Tensor, Tensor]:
    """Return queries [Q, D] and phrases [P, D] as float32 on the device of the codes; ``model`` is for messages."""
    dim, device = codes.codebook.shape[2], codes.codebook.device
    try:
        queries = query_vectors(queries, dim)
        canonical = query_vectors(canonical, dim, "canonical", lengthen=False)
    except InputError as error:
        raise InputError(
            f"{error}; this field contains embeddings of {model or 'an unnamed model'} with {dim} dimensions"
        ) from error
    return queries.to(device), canonical.to(device)


def fresh_relevancy(
    projection: raster.Projection, codes: FieldCodes, queries: Tensor, canonical: Tensor
) -> Tensor:
    """Return the relevancy [S, Q, H, W] of every pixel; ``LanguageField.relevancy`` documents it."""
    both = torch.cat([queries, canonical])
    cosines = raster.render_cosines(projection, codes.indices, codes.weights, codes.codebook, both)
    return relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])


def render_features(projection: raster.Projection, codes: FieldCodes, level: int) -> Tensor:
    """Render decoded features of one level, [H, W, D] float32, unit norm or, where nothing is rendered, zero."""
    chosen = slice(level, level + 1)
    indices, weights = codes.indices[:, chosen], codes.weights[:, chosen]
    return raster.render_features(projection, indices, weights, codes.codebook[chosen])[0]


def gaussian_features(codes: FieldCodes, level: int) -> Tensor:
    """Return the decoded codes of all Gaussians at one level, [N, D] float32, unit norm; zero without a code."""
    _, n_atoms, dim = codes.codebook.shape
    out = torch.empty(len(codes.indices), dim, device=codes.codebook.device)
    for start in range(0, len(out), GAUSSIANS_AT_A_TIME):
        rows = slice(start, start + GAUSSIANS_AT_A_TIME)
        indices, weights = codes.indices[rows, level].long(), codes.weights[rows, level]
        dense = torch.zeros(len(indices), n_atoms, device=out.device)
        dense.scatter_add_(1, indices, weights.float())
        out[rows] = torch.nn.functional.normalize(dense @ codes.codebook[level], dim=1)
    return out
