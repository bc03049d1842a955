"""The answer to a text, in one view or in the whole scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.html import card
from scoup.pictures import as_picture, heat_map, mask_overlay

if TYPE_CHECKING:
    from PIL.Image import Image

    from scoup.query.view_depth import ViewDepth


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """The answer to one text in one view. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> answer = field.answer("kettle", "view_00")
        >>> answer.mask.dtype, answer.mask.shape == answer.heat.shape
        (torch.bool, True)
    """

    mask: Tensor
    """[H, W] boolean; empty if the thing is not there."""
    heat: Tensor
    """[H, W] float32 relevancy at the level of the mask, 0..1."""
    main_parts: Tensor
    """[H, W] boolean, the mask without strays: the connected part with the point, and those alike in size and relevancy
    (``scoup.query.segment.main_parts``)."""
    box: tuple[int, int, int, int] | None
    """(x0, y0, x1, y1) around the main parts in pixels, x1 and y1 one past the last; None if it is empty."""
    coverage: float
    """Share of the view in the mask, 0..1."""
    level: str
    """Name of the level of the mask."""
    score: float
    """The largest smoothed relevancy at that level, 0..1."""
    point: tuple[int, int] | None
    """(x, y), the pixel of the mask that fits best; None if the thing is not there."""
    z_score: float | None = None
    """See ``scoup.query.presence``; minus infinity if nothing was found, None if presence was not judged."""
    presence: bool = True
    """Whether the thing is there; true if that was not judged."""
    text: str = ""
    """What was asked."""
    view: str = ""
    """Name of the camera."""
    render: Callable[[], Tensor] | None = None
    """Renders the colours of the view, [H, W, 3] 0..1, to draw the answer on. Pickling drops it."""
    depth: ViewDepth | None = None
    """Renders the depth of the view, for ``position``. Pickling drops it."""
    threshold: float | None = None
    """Threshold of the mask on the relevancy rescaled over the view; None if things answered."""

    @property
    def position(self) -> Tensor | None:
        """The middle of the surface that the main parts show, [3] float64 world units; None if it is not there or its
        depth is unknown. ``location`` finds the thing itself, from all sides."""
        return None if self.depth is None else self.depth.position(self.main_parts)

    def __repr__(self) -> str:
        found = f"point {self.point}, box {self.box}, level {self.level}, score {self.score:.2f}"
        return f"Answer({_said(self)} in {self.view!r}: {found if self.presence else 'not in this view'})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "render": None, "depth": None}  # which hold the scene

    def _repr_html_(self) -> str:
        facts = self.record()
        return card(f"{_said(self)} in {self.view}", facts, as_picture(self.pictures()["overlay"]))

    def remark(self) -> str:
        """Return level, score, coverage and z-score in a few words; or that the thing is not there."""
        judged = self.z_score is not None and math.isfinite(self.z_score)
        z_score = f"z-score {self.z_score:.2f}" if judged else ""
        if not self.presence:
            return f"not in this view ({z_score or 'nothing found'})"
        parts = (
            f"level {self.level}",
            f"score {self.score:.2f}",
            f"{self.coverage:.1%} of the view",
            z_score,
        )
        return ", ".join(part for part in parts if part)

    def pictures(self, rgb: Tensor | None = None) -> dict[str, np.ndarray | Tensor]:
        """Draw the answer.

        Args:
            rgb: [H, W, 3] float 0..1, the background; by default the colours of the view, or black.

        Returns:
            "heat": the relevancy over the background, [.., .., 3] uint8; "mask": [H, W] boolean; "overlay": mask, box
            and point over the background, [.., .., 3] uint8.
        """
        if rgb is None:
            rgb = torch.zeros(*self.heat.shape, 3) if self.render is None else self.render().cpu()
        return {
            "heat": heat_map(self.heat, rgb, self.text, self.level, self.score),
            "mask": self.mask,
            "overlay": mask_overlay(self.mask, rgb, self.box, self.point, self.text, self.remark()),
        }

    def crop(self, image: Tensor | ArrayLike | Image, margin: int = 0) -> Tensor | np.ndarray | None:
        """Return the part of an image of the view [H, W, ...] in the box; None if the thing is not there.

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

    def record(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded; ``z_score`` and ``present`` only if presence was judged."""
        return {
            "level": self.level,
            "score": round(self.score, 4),
            "threshold": _threshold_record(self.threshold),
            "pixel": None if self.point is None else list(self.point),
            "coverage": round(self.coverage, 6),
            "box": None if self.box is None else list(self.box),
            **_presence_record(self.z_score, self.presence),
        }


@dataclass(frozen=True, eq=False, repr=False)
class SceneAnswer:
    """The answer to one text in the whole scene, by the Gaussians' own codes. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> answer = field.select(field.question("kettle", always=True))
        >>> answer.mask.shape == (len(field.gaussians),)
        True
    """

    mask: Tensor
    """[N] boolean, the Gaussians that answer; empty if the thing is not there."""
    relevancy: Tensor
    """[N] float32 at the level chosen, after blending with neighbours."""
    level: str
    """Name of the level chosen."""
    score: float
    """The largest relevancy of a Gaussian at that level; minus infinity if none has a code."""
    z_score: float | None = None
    """As in ``Answer``."""
    presence: bool = True
    """As in ``Answer``."""
    text: str = ""
    """As in ``Answer``."""
    threshold: float | None = None
    """The Gaussians that answer are above it, on the relevancy (by default rescaled over the Gaussians with a code at
    that level); None if things answered."""
    parts: tuple[SceneAnswer, ...] = ()
    """The answers to the texts of an expression."""

    def __repr__(self) -> str:
        found = f"{int(self.mask.sum()):,} of {len(self.mask):,} Gaussians, level {self.level}, score {self.score:.2f}"
        return f"SceneAnswer({_said(self)}: {found if self.presence else 'not in this scene'})"

    def _repr_html_(self) -> str:
        return card(f"{_said(self)} in the scene", {**self.record(), "of": f"{len(self.mask):,} Gaussians"})

    def record(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded; ``z_score`` and ``present`` only if presence was judged."""
        return {
            "gaussians": int(self.mask.sum()),
            "level": self.level,
            "score": _rounded(self.score, 4),
            "threshold": _threshold_record(self.threshold),
            **_presence_record(self.z_score, self.presence),
        }


def _said(answer: Answer | SceneAnswer) -> str:
    return repr(answer.text) if answer.text else "a query"


def _threshold_record(threshold: float | None) -> float | None:
    return None if threshold is None else round(threshold, 3)


def _presence_record(z_score: float | None, presence: bool) -> dict[str, Any]:
    return {} if z_score is None else {"z_score": _rounded(z_score, 3), "present": presence}


def _rounded(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None  # JSON knows no infinity
