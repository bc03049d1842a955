"""A field as one camera sees it: answers, relevancy and renders that share one projection."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.field import Cache, Field
from scoup.query import constants
from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.boxes import PointSets
from scoup.query.question import AskedText
from scoup.query.view_answer import ViewAnswer, ViewRenders, main_parts, mask_box, most_relevant_pixel
from scoup.scene import Camera

COVERED = 0.5  # share of a pixel's light from which it shows a thing
BYTES_PER_PIXEL = 8
"""A view keeps so many bytes per pixel and level of what its next question reuses."""


class FieldView:
    """A field as one camera sees it. The first answer that it shows takes longest: further ones reuse its projection,
    norms and the cosines of the canonical phrases, and differ by rounding, about 1e-6.

    Attributes:
        camera: of the view.
        projection: of the scene to it.
        cache: what further questions reuse.

    Example:
        >>> view = field.at("view_00.png", scale=0.5)
        >>> {seen.mask.shape for seen in view.show(field.answer(["kettle", "wooden table"]))}
        {torch.Size([15, 20])}
    """

    def __init__(
        self, field: Field, camera: Camera | str | int, scale: float = 1.0, backend: str | None = None
    ) -> None:
        self.field, self.camera = field, field.camera(camera)
        if scale != 1.0:
            self.camera = self.camera.scaled(scale)
        self.projection = field.project(self.camera, backend)
        n_pixels = self.camera.width * self.camera.height
        self.cache = Cache((1 << 20) + BYTES_PER_PIXEL * n_pixels * len(field.levels))

    def show(self, answers: Sequence[Answer]) -> list[ViewAnswer]:
        """Draw answers of the field. Nothing is decided again."""
        masks = self.masks(answers)
        heats = iter(self._heats([asked for answer in answers for asked in answer.heats]))
        views = []
        for answer, mask in zip(answers, masks, strict=True):
            heat = torch.stack([next(heats) for _ in answer.heats]).amax(0)
            parts, largest = main_parts(mask)
            point = most_relevant_pixel(heat, largest)
            views.append(
                ViewAnswer(answer, self.camera.name, mask, heat, parts, mask_box(parts), point, self.renders)
            )
        return views

    def masks(self, answers: Sequence[Answer]) -> list[Tensor]:
        """Return the pixels [H, W] boolean of each answer, on the CPU (``ViewAnswer.mask``)."""
        size = self.camera.height, self.camera.width
        masks = [torch.zeros(size, dtype=torch.bool) for _ in answers]
        present = [number for number, answer in enumerate(answers) if bool(answer.mask.any())]
        if not present:
            return masks
        wholes: list[Tensor] = []
        places: list[int] = []
        for number in present:
            whole = counting_gaussians(self.field, answers[number])
            # Most answers have the same ones, which are rendered once.
            places.append(next((k for k, one in enumerate(wholes) if torch.equal(one, whole)), len(wholes)))
            if places[-1] == len(wholes):
                wholes.append(whole)
        values = torch.stack([*wholes, *(answers[number].mask for number in present)], 1)
        image = raster.render_values(self.projection, values.float().to(self.field.codebook.device)).cpu()
        for column, (number, whole_column) in enumerate(zip(present, places, strict=True), start=len(wholes)):
            masks[number] = image[..., column] > constants.PIXEL_SHARE * image[..., whole_column]
        return masks

    def relevancy(self, queries: Tensor | ArrayLike, canonical: Tensor | ArrayLike) -> Tensor:
        """Return the relevancy of every pixel, [S, Q, H, W] float32; see ``field.relevancy``."""
        return self.field.view_relevancy(self.projection, self.cache, queries, canonical)

    @cached_property
    def renders(self) -> ViewRenders:
        """Colours and depth of the view."""
        return ViewRenders(self.field, self.camera, self.projection)

    def render_codes(self) -> Tensor:
        """Render the coefficients of every level, [S, H, W, L] float32."""
        codes = self.field.codes
        return raster.render_codes(self.projection, codes.indices, codes.weights, self.field.n_atoms)

    def shares(self, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return the contribution of the Gaussians in a mask [N] boolean to each pixel, and alpha, [H, W] each."""
        members = mask.float()[:, None].to(self.field.codebook.device)
        image, alpha = raster.render_channels(self.projection, members)
        return image[..., 0], alpha

    def mask_of(self, gaussians: Tensor) -> Tensor:
        """Return the pixels [H, W] boolean, on the CPU, that the Gaussians [M] of a thing contribute most of."""
        members = torch.zeros(len(self.field), dtype=torch.bool)
        members[gaussians] = True
        share, alpha = self.shares(members)
        return (share > COVERED * alpha.clamp(min=0.1)).cpu()

    def position_at(self, pixel: tuple[int, int], gaussians: Tensor, weights: Tensor) -> Tensor:
        """Return [3] float64: the point of a pixel's ray at the median depth of the weight of some Gaussians."""
        camera, means = self.camera, self.field.gaussians.means
        means = means[gaussians.to(means.device)].double().cpu()
        depths = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        depth = PointSets.of_one_thing(depths[:, None], weights).medians().item()
        x, y = pixel[0] + 0.5, pixel[1] + 0.5
        ray = torch.tensor(
            [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0], dtype=torch.float64
        )
        return camera.position + depth * (camera.viewmat[:3, :3].T @ ray)

    def is_visible(self) -> bool:
        """Return whether a Gaussian with a code contributes to any pixel."""
        return bool(raster.render_values(self.projection, self.field.coded()[:, None].float()).any())

    def _heats(self, asked: Sequence[AskedText]) -> list[Tensor]:
        """Return the relevancy [H, W] of each text at its level, on the CPU; texts of one question in one pass."""
        heats: list[Tensor] = [torch.empty(0)] * len(asked)
        for canonical in {id(one.canonical): one.canonical for one in asked}.values():
            numbers = [number for number, one in enumerate(asked) if one.canonical is canonical]
            maps = self.relevancy(torch.cat([asked[number].query for number in numbers]), canonical)
            for row, number in enumerate(numbers):
                # A copy, so that the other levels can be freed.
                heats[number] = maps[asked[number].level, row].clone().cpu()
        return heats


def counting_gaussians(field: Field, answer: Answer) -> Tensor:
    """Return the Gaussians [N] boolean whose contributions an answer must exceed half of.

    These belong to any thing of its level or, where the votes answer, have a code there.
    """
    counting = answer.mask.clone()
    for one in answer.parts if isinstance(answer, ExpressionAnswer) else (answer,):
        level = field.level_index(one.level)
        if field.thing_table is None or one.threshold is not None:
            counting |= field.coded_levels()[level].cpu()
        else:
            counting |= field.thing_table.owned[level].cpu()
    return counting
