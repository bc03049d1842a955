"""Fields of any kind, asked alike: each Gaussian has some channels, channels are rendered, and pixels are compared with
words. What the channels mean is up to the method: an embedding, a code, three numbers for a network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.field.language_field import LanguageField
from scoup.field.relevancy import relevancy
from scoup.scene.cameras import Camera
from scoup.scene.codes import cosines_from_codes

ROWS_AT_A_TIME = 1 << 15  # pixels or Gaussians compared together

Cosines = Callable[[Tensor, Tensor], Tensor]
"""``cosines(rows [P, C], queries [Q, D])`` gives [P, Q]; zero where a row is zero."""


@dataclass(frozen=True, eq=False)
class ChannelField:
    """What a method has made of a scene.

    Attributes:
        values: per level [N, C] float32, what is rendered; zero rows where nothing is known.
        cosines: per level, how channels meet words (``Cosines``).
        bytes_per_gaussian: it keeps, all levels.
        shared_bytes: it keeps once a scene: codebooks, networks.
        quick: ``quick(view, words [Q, D])`` gives cosines [S, Q, H, W] without any image of channels, where there is
            such a way; the same up to rounding.
    """

    values: Sequence[Tensor]
    cosines: Sequence[Cosines]
    bytes_per_gaussian: float
    shared_bytes: float = 0.0
    quick: Callable[[raster.Projection, Tensor], Tensor] | None = None

    def relevancy(
        self, view: raster.Projection, queries: Tensor, canonical: Tensor, size: tuple[int, int] | None = None
    ) -> Tensor:
        """[S, Q, H, W] float32 relevancy of every pixel; 0.5 where nothing is rendered.

        Args:
            view: from ``raster.project``.
            queries, canonical: [Q, D] and [P, D], unit norm.
            size: (width, height) to bring the rendered channels to first (``resized_image``).
        """
        if self.quick is not None and size in (None, (view.width, view.height)):
            found = self.quick(view, torch.cat([queries, canonical]))
            return relevancy(found[:, : len(queries)], found[:, len(queries) :])
        levels = []
        for values, cosines in zip(self.values, self.cosines, strict=True):
            image, _ = raster.render_channels(view, values)
            levels.append(image_relevancy(_at(image, size), cosines, queries, canonical))
        return torch.stack(levels)

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        """[S, Q, N] float32 relevancy of every Gaussian by its own channels, without rendering."""
        found = [
            image_relevancy(values[None], cosines, queries, canonical)[:, 0]
            for values, cosines in zip(self.values, self.cosines, strict=True)
        ]
        return torch.stack(found)

    def coded(self) -> Tensor:
        """[S, N] boolean: the Gaussians that know something at each level."""
        return torch.stack([values.any(1) for values in self.values])


def image_relevancy(image: Tensor, cosines: Cosines, queries: Tensor, canonical: Tensor) -> Tensor:
    """[Q, H, W] relevancy of rendered channels [H, W, C], some pixels at a time."""
    both, count = torch.cat([queries, canonical]), len(queries)
    rows = image.reshape(-1, image.shape[2])
    found = torch.empty(count, len(rows))
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        part = cosines(rows[start : start + ROWS_AT_A_TIME], both).T
        found[:, start : start + ROWS_AT_A_TIME] = relevancy(part[None, :count], part[None, count:])[0]
    return found.view(count, *image.shape[:2])


def embedding_cosines(rows: Tensor, queries: Tensor) -> Tensor:
    """``Cosines`` of channels that are embeddings themselves."""
    return torch.nn.functional.normalize(rows, dim=1) @ queries.T


def code_cosines(atoms: Tensor) -> Cosines:
    """``Cosines`` of channels that are coefficients over atoms [L, D]."""
    return lambda rows, queries: cosines_from_codes(rows, atoms, queries)


def resized_image(image: Tensor, width: int, height: int) -> Tensor:
    """[height, width, C] of rendered channels [H, W, C], before anything is scaled to unit norm (protocols.md,
    Mip-NeRF360: "features resized to the label size"). *Choice*: bilinear, corners not aligned."""
    if tuple(image.shape[:2]) == (height, width):
        return image
    channels_first = image.permute(2, 0, 1)[None]
    found = torch.nn.functional.interpolate(
        channels_first, size=(height, width), mode="bilinear", align_corners=False
    )
    return found[0].permute(1, 2, 0).contiguous()


def field_relevancy(
    field: LanguageField,
    camera: Camera,
    queries: Tensor,
    canonical: Tensor,
    view: raster.Projection | None = None,
    size: tuple[int, int] | None = None,
) -> Tensor:
    """``LanguageField.relevancy`` [S, Q, H, W], with the rendered features brought to another size first if asked for:
    coefficients are resized in their stead, as features follow from them linearly."""
    if size is None or size == (camera.width, camera.height):
        return field.relevancy(camera, queries, canonical, view)
    codes = field.render_codes(camera, view)
    levels = [
        image_relevancy(_at(of_level, size).cpu(), code_cosines(atoms.cpu()), queries.cpu(), canonical.cpu())
        for of_level, atoms in zip(codes, field.codebook, strict=True)
    ]
    return torch.stack(levels)


def _at(image: Tensor, size: tuple[int, int] | None) -> Tensor:
    return image if size is None else resized_image(image, *size)
