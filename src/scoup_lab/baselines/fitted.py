"""Fitted methods: what a method has made of a scene, and how it gives relevancy.

A field of sparse codes is queried without an image of its channels (``FittedField``). All others give each Gaussian
some channels, which are rendered and then compared with texts (``FittedChannels``): an embedding, three numbers for a
network.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from scoup import raster
from scoup.field import Field, FieldInfo, ThingTable, relevancy
from scoup.uplift import RegionSums

ROWS_AT_A_TIME = 1 << 15  # pixels or Gaussians compared together

Cosines = Callable[[Tensor, Tensor], Tensor]
"""``cosines(rows [P, C], queries [Q, D])`` gives [P, Q]; zero where a row is zero."""


class FittedMethod(Protocol):
    """A method after it was fitted to a scene."""

    @property
    def bytes_per_gaussian(self) -> float:
        """Bytes stored for each Gaussian, all levels."""
        ...

    @property
    def shared_bytes(self) -> float:
        """Bytes stored once per scene: codebooks, networks."""
        ...

    def relevancy(
        self,
        projection: raster.Projection,
        queries: Tensor,
        canonical: Tensor,
        size: tuple[int, int] | None = None,
    ) -> Tensor:
        """Return [S, Q, H, W] float32 relevancy of every pixel; 0.5 where nothing is rendered.

        ``projection``: from ``raster.project``; ``queries``, ``canonical``: [Q, D] and [P, D], unit norm;
        ``size``: (width, height) that the rendered channels are resized to first (``resized_image``).
        """
        ...

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        """Return [S, Q, N] float32 relevancy of every Gaussian by itself, without rendering; 0.5 without channels."""
        ...

    def coded(self) -> Tensor:
        """Return [S, N] boolean: the Gaussians that have channels at each level."""
        ...


@dataclass(frozen=True, eq=False)
class FittedChannels:
    """A ``FittedMethod`` that renders channels."""

    channels: Sequence[Tensor]  # per level [N, C] float32; zero rows for Gaussians that nothing is known of
    cosines: Sequence[Cosines]  # per level, how channels are compared with texts
    bytes_per_gaussian: float
    shared_bytes: float = 0.0

    def relevancy(
        self,
        projection: raster.Projection,
        queries: Tensor,
        canonical: Tensor,
        size: tuple[int, int] | None = None,
    ) -> Tensor:
        images = (raster.render_channels(projection, channels)[0] for channels in self.channels)
        return _of_images(images, self.cosines, queries, canonical, size)

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        rows = (channels[None] for channels in self.channels)
        return _of_images(rows, self.cosines, queries, canonical, None)[:, :, 0]

    def coded(self) -> Tensor:
        return torch.stack([channels.any(1) for channels in self.channels])


@dataclass(frozen=True, eq=False)
class FittedField:
    """A ``FittedMethod`` of sparse codes."""

    field: Field  # the codes
    all_kept: bool = False  # whether it has every atom of the codebook: indices then need not be stored

    @property
    def bytes_per_gaussian(self) -> float:
        indices, weights = self.field.code_indices, self.field.code_weights
        atom = weights.element_size() + (0 if self.all_kept else indices.element_size())
        count = self.field.n_atoms if self.all_kept else indices.shape[2]
        owner = 0 if self.field.thing_table is None else 2  # bytes of a thing's number in the file
        return float((atom * count + owner) * indices.shape[1])

    @property
    def shared_bytes(self) -> float:
        return 4.0 * self.field.codebook.numel()

    def relevancy(
        self,
        projection: raster.Projection,
        queries: Tensor,
        canonical: Tensor,
        size: tuple[int, int] | None = None,
    ) -> Tensor:
        """See ``FittedMethod``. Coefficients are resized in place of features, which depend on them linearly."""
        indices, weights, codebook = self.field.code_indices, self.field.code_weights, self.field.codebook
        if size is None or size == (projection.width, projection.height):
            both = torch.cat([queries, canonical]).float().to(codebook.device)
            maps = raster.render_cosines(projection, indices, weights, codebook, both)
            return relevancy(maps[:, : len(queries)], maps[:, len(queries) :])
        images = (
            image.cpu() for image in raster.render_codes(projection, indices, weights, codebook.shape[1])
        )
        cosines = [code_cosines(atoms) for atoms in codebook.cpu()]
        return _of_images(images, cosines, queries.cpu(), canonical.cpu(), size)

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        return self.field.gaussian_relevancy(queries, canonical)

    def coded(self) -> Tensor:
        return self.field.code_weights.any(-1).T


def fitted_field(
    sums: RegionSums,
    indices: Tensor,
    weights: Tensor,
    codebook: Tensor,
    all_kept: bool = False,
    things: ThingTable | None = None,
) -> FittedField:
    """Return codes [N, S, K] over a codebook [S, L, D], as a field of the scene that the sums are of."""
    info = FieldInfo(sums.levels, "", sums.fingerprint, sums.n_gaussians, sums.raster_preset)
    return FittedField(Field(indices, weights, codebook, info, thing_table=things), all_kept)


def _of_images(
    images: Iterable[Tensor],
    cosines: Sequence[Cosines],
    queries: Tensor,
    canonical: Tensor,
    size: tuple[int, int] | None,
) -> Tensor:
    """Return [S, Q, H, W] relevancy of an image [H, W, C] a level, one level at a time."""
    levels = []
    for image, of_level in zip(images, cosines, strict=True):
        resized = image if size is None else resized_image(image, *size)
        levels.append(image_relevancy(resized, of_level, queries, canonical))
    return torch.stack(levels)


def image_relevancy(image: Tensor, cosines: Cosines, queries: Tensor, canonical: Tensor) -> Tensor:
    """Return [Q, H, W] relevancy of rendered channels [H, W, C], some pixels at a time."""
    both, count = torch.cat([queries, canonical]), len(queries)
    rows = image.reshape(-1, image.shape[2])
    result = torch.empty(count, len(rows))
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        block = cosines(rows[start : start + ROWS_AT_A_TIME], both).T
        result[:, start : start + ROWS_AT_A_TIME] = relevancy(block[None, :count], block[None, count:])[0]
    return result.view(count, *image.shape[:2])


def embedding_cosines(rows: Tensor, queries: Tensor) -> Tensor:
    """Return ``Cosines`` of channels that are embeddings themselves."""
    norms = torch.linalg.vector_norm(rows, dim=1, keepdim=True).clamp(min=1e-12)
    return (rows @ queries.T) / norms  # a copy of all rows, scaled, would take longer than the products


def code_cosines(atoms: Tensor) -> Cosines:
    """Return ``Cosines`` of channels that are coefficients over atoms [L, D]."""
    gram = atoms @ atoms.T
    return lambda rows, queries: raster.cosines_and_norms(rows, atoms @ queries.T, gram)[0]


def resized_image(image: Tensor, width: int, height: int) -> Tensor:
    """Return [height, width, C] of rendered channels [H, W, C], before anything is scaled to unit norm (evaluation.md,
    Mip-NeRF360: "features resized to the label size"). *Choice*: bilinear, corners not aligned."""
    if tuple(image.shape[:2]) == (height, width):
        return image
    channels_first = image.permute(2, 0, 1)[None]
    resized = torch.nn.functional.interpolate(
        channels_first, size=(height, width), mode="bilinear", align_corners=False
    )
    return resized[0].permute(1, 2, 0).contiguous()
