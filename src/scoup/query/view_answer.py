"""The answer to a text as one view shows it: mask, heat, box and point."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError, card, rounded_vector
from scoup.field import Field
from scoup.pictures import as_picture, heat_map, mask_overlay
from scoup.query import constants
from scoup.query.answer import Answer
from scoup.query.boxes import PointSets
from scoup.raster import Projection, region_sums, render_channels, render_colors, render_values
from scoup.scene import Camera, Gaussians

if TYPE_CHECKING:
    from PIL.Image import Image


LEAST_ALPHA = 0.5  # of a pixel with a depth


class ViewRenders:
    """Colours and things of one view, rendered when asked for. The projection is not kept alive."""

    def __init__(self, field: Field, camera: Camera, projection: Projection) -> None:
        self.field, self.camera = field, camera
        self._projection = weakref.ref(projection)

    def projection(self) -> Projection:
        """Return the projection, made again if it has gone."""
        return self._projection() or self.field.project(self.camera)

    def colors(self) -> Tensor:
        """Render the colours, [H, W, 3] float 0..1."""
        return render_colors(self.field.gaussians, self.camera, self.projection())

    def thing_mask(self, thing: int) -> Tensor:
        """Return the pixels [H, W] boolean of a thing, on the CPU (``ViewAnswer.mask``)."""
        table = self.field.thing_table
        assert table is not None
        parts = table.members(torch.tensor([thing])), table.owned[int(table.levels[thing])]
        values = torch.stack([part.cpu() for part in parts], 1).float()
        image = render_values(self.projection(), values.to(self.field.codebook.device)).cpu()
        return image[..., 0] > constants.PIXEL_SHARE * image[..., 1]

    def position_of(self, answer: Answer, pixels: Tensor) -> Tensor | None:
        """Return the weighted median [3] float64 of the Gaussians of the thing that contributes most to some pixels
        [H, W] boolean, among those that answer; None if none does."""
        labels = torch.where(pixels, 0, -1).int()[None].to(self.field.codebook.device)
        rows, _, weights = (part.cpu() for part in region_sums(self.projection(), labels).triplets(0))
        answering = answer.mask[rows]
        rows, weights = rows[answering], weights[answering].double()
        if not len(rows):
            return None
        owners = torch.full_like(rows, -1)
        if answer.things and self.field.thing_table is not None:
            every = self.field.thing_table.owners[rows].cpu().long()
            owners = torch.where(torch.isin(every, torch.tensor(answer.things)), every, -1).amax(1)
        chosen = owners == torch.bincount(owners + 1, weights).argmax() - 1
        means = self.field.gaussians.means[rows[chosen].to(self.field.gaussians.device)].double().cpu()
        return torch.from_numpy(PointSets.of_one_thing(means, weights[chosen]).medians()[0])


@dataclass(frozen=True, eq=False, repr=False)
class ViewAnswer:
    """An answer of the scene as one view shows it. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> seen = field.at("view_00").answer("kettle")
        >>> seen.mask.dtype, seen.mask.shape == seen.heat.shape
        (torch.bool, True)
    """

    answer: Answer
    """Of the scene."""
    view: str
    """Name of the camera."""
    mask: Tensor
    """[H, W] boolean: the pixels to which the Gaussians of the answer contribute more than half. Of that, Gaussians of
    no thing of its level do not count, such as haze before the camera."""
    heat: Tensor
    """[H, W] float32 relevancy at the level of the answer, 0..1."""
    main_parts: Tensor
    """[H, W] boolean, the mask without specks (``main_parts``)."""
    box: tuple[int, int, int, int] | None
    """(x0, y0, x1, y1) around the main parts in pixels, x1 and y1 one past the last; None if nothing is visible."""
    point: tuple[int, int] | None
    """(x, y), the most relevant pixel of the largest part; None if nothing is visible."""
    source: ViewRenders | None = None
    """Renders the view, for ``pictures`` and ``position``. Pickling drops it."""

    @property
    def text(self) -> str:
        """The text asked."""
        return self.answer.text

    @property
    def level(self) -> str:
        """Name of the level that answers."""
        return self.answer.level

    @property
    def score(self) -> float | None:
        """As of ``Answer``: the same in every view."""
        return self.answer.score

    @property
    def presence(self) -> bool:
        """True if the thing is in the scene."""
        return self.answer.presence

    @property
    def visible(self) -> bool:
        """True if the thing is visible from here."""
        return self.point is not None

    @property
    def coverage(self) -> float:
        """Share of the view in the mask, 0..1."""
        return int(self.mask.sum()) / max(1, self.mask.numel())

    @property
    def position(self) -> Tensor | None:
        """The median of the visible Gaussians of the thing that the main parts show most, [3] float64 world units; None
        if nothing is visible. ``location`` finds the middle of the thing, from all sides."""
        return None if self.source is None else self.source.position_of(self.answer, self.main_parts)

    @cached_property
    def runner_up(self) -> Tensor | None:
        """[H, W] boolean, the pixels of the runner-up; None without one."""
        rival = self.answer.runner_up if self.presence else None
        return None if rival is None or self.source is None else self.source.thing_mask(rival.thing)

    def __repr__(self) -> str:
        facts = f"point {self.point}, box {self.box}, {self.remark()}"
        return f"ViewAnswer({self.text!r} in {self.view!r}: {facts if self.visible else self.remark()})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "source": None}  # it contains the scene

    def _repr_html_(self) -> str:
        return card(f"{self.text!r} in {self.view}", self.to_dict(), as_picture(self.pictures()["overlay"]))

    def remark(self) -> str:
        """Return level, score and coverage in a few words; or why nothing is shown."""
        if not self.presence:
            return self.answer.remark()
        if not self.visible:
            return "not visible from here"
        parts = (f"level {self.level}", f"{self.coverage:.1%} of the view")
        return ", ".join([*parts, self.answer.remark()] if self.score is not None else parts)

    def pictures(self, rgb: Tensor | None = None) -> dict[str, np.ndarray | Tensor]:
        """Draw the answer.

        Args:
            rgb: [H, W, 3] float 0..1, the background; by default the colours of the view, or black.

        Returns:
            "heat": the relevancy over the background, [.., .., 3] uint8; "mask": [H, W] boolean; "overlay": mask, box
            and point over the background, [.., .., 3] uint8.
        """
        if rgb is None:
            rgb = torch.zeros(*self.heat.shape, 3) if self.source is None else self.source.colors().cpu()
        return {
            "heat": heat_map(self.heat, rgb, self.text, self.level, float(self.heat.max())),
            "mask": self.mask,
            "overlay": mask_overlay(
                self.mask, rgb, self.box, self.point, self.text, self.remark(), other=self.runner_up
            ),
        }

    def crop(self, image: Tensor | ArrayLike | Image, margin: int = 0) -> Tensor | np.ndarray | None:
        """Return the part of an image of the view [H, W, ...] in the box; None if nothing is visible.

        Args:
            image: of the view's size; a picture of Pillow becomes an array.
            margin: pixels added on every side, as far as the image reaches.

        Raises:
            InputError: the image has another size, or the margin is negative.
        """
        pixels = image if isinstance(image, Tensor) else np.asarray(image)
        if tuple(pixels.shape[:2]) != tuple(self.mask.shape) or margin < 0:
            raise InputError(
                f"an image of {list(pixels.shape)} with a margin of {margin} cannot be cropped by a view of "
                f"{list(self.mask.shape)}"
            )
        if self.box is None:
            return None
        x0, y0, x1, y1 = self.box
        return pixels[max(0, y0 - margin) : y1 + margin, max(0, x0 - margin) : x1 + margin]

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded."""
        position = self.position
        return {
            **self.answer.verdict(),
            "visible": self.visible,
            "pixel": None if self.point is None else list(self.point),
            "coverage": round(self.coverage, 6),
            "box": None if self.box is None else list(self.box),
            "position": None if position is None else rounded_vector(position.tolist()),
        }


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """Return (x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None of an empty mask."""
    if not mask.numel():
        return None
    bits = mask.view(torch.uint8)  # torch reduces bytes much faster than booleans
    rows, columns = bits.amax(1).nonzero()[:, 0], bits.amax(0).nonzero()[:, 0]
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def main_parts(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return a mask [H, W] without specks, and its largest part.

    Pixels that touch at a corner are connected. Things are often seen in pieces, with something in front of them, and
    several may answer, so the largest part alone would be too little.
    """
    box = mask_box(mask)
    if box is None:
        return mask, mask
    from scipy import ndimage  # takes a fifth of a second

    window = slice(box[1], box[3]), slice(box[0], box[2])  # most answers fill little of a view
    inside = mask[window].numpy()
    labels = np.empty(inside.shape, np.int32)
    ndimage.label(inside, np.ones((3, 3)), output=labels)  # pyright: ignore[reportArgumentType]
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    is_main = areas >= constants.SPECK * areas.max()
    is_main[0] = False
    parts, largest = torch.zeros_like(mask), torch.zeros_like(mask)
    parts[window] = torch.from_numpy(is_main[labels])
    largest[window] = torch.from_numpy(labels == areas.argmax())
    return parts, largest


def most_relevant_pixel(heat: Tensor, part: Tensor) -> tuple[int, int] | None:
    """Return (x, y) of the largest averaged relevancy [H, W] within a part [H, W]; of equals the one nearest to their
    mean; None if the part is empty.
    """
    if not part.any():
        return None
    averaged = torch.nn.functional.avg_pool2d(
        heat[None], constants.AVERAGED, stride=1, padding=constants.AVERAGED // 2, count_include_pad=False
    )[0]
    values = torch.where(part, averaged, -torch.inf)
    pixels = (values == values.max()).nonzero().flip(1)
    # A pixel in the middle of a plateau says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return x, y


def render_depth(projection: Projection, gaussians: Gaussians, camera: Camera) -> Tensor:
    """Return the mean distance along the view direction by blending weights, in world units, [H, W] float32 on the CPU;
    NaN where alpha is below ``LEAST_ALPHA``.
    """
    means = gaussians.means.double()
    row = camera.viewmat[2].to(means.device)
    distances = (means @ row[:3] + row[3]).float().nan_to_num(0.0, 0.0, 0.0)
    image, alpha = render_channels(projection, distances[:, None])
    return torch.where(alpha >= LEAST_ALPHA, image[..., 0] / alpha.clamp(min=1e-9), torch.nan).cpu()
