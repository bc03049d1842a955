"""The answer to a text: decided once, in the scene, and drawn in views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.html import card
from scoup.base.records import rounded_vector
from scoup.pictures import as_picture, heat_map, mask_overlay
from scoup.query.presence import Certainty, certainty

if TYPE_CHECKING:
    from PIL.Image import Image

    from scoup.query.coded_scene import CodedScene
    from scoup.query.question import Question
    from scoup.query.view_depth import ViewDepth
    from scoup.raster import Projection
    from scoup.scene.cameras import Camera


class RunnerUp(NamedTuple):
    """The next best thing."""

    thing: int
    """Its number."""
    score: float | None
    """As of ``Answer``: the difference says by how much it is worse."""


@dataclass(frozen=True, eq=False)
class AskedText:
    """A text of an answer, and the level that answers it."""

    question: Question  # of one text
    level: int


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """The answer of a scene to one text, or to an expression. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> answer = field.answer(field.question("kettle", always=True))
        >>> answer.mask.shape == (len(field),), answer.in_view("view_00").mask.shape
        (True, torch.Size([30, 40]))
    """

    text: str
    """What was asked."""
    mask: Tensor
    """[N] boolean, the Gaussians that answer; empty if the thing is not there."""
    level: str
    """Name of the level that answers."""
    score: float | None
    """The share of everyday words whose best fit in this scene is lower, 0 to 1; None with too few everyday words."""
    presence: bool = True
    """Whether the thing is there: its score is not below that of the question, or that was not judged."""
    things: tuple[int, ...] = ()
    """Numbers of the things that answer, best first (``field.things`` describes them); empty in a field without things,
    with a threshold, and for what is not there."""
    instances: tuple[int, ...] = ()
    """Numbers of the things that are one instance each, best first: their number is the count that "how many" asks for.
    They need not be the things that answer, which may be pieces or parts."""
    runner_up: RunnerUp | None = None
    """The best thing elsewhere; None where none is."""
    threshold: float | None = None
    """The Gaussians that answer are above it, on relevancy rescaled over the scene; None if things answer."""
    parts: tuple[Answer, ...] = ()
    """The answers to the texts of an expression."""
    asked: tuple[AskedText, ...] = ()
    """Whose relevancy is shown as heat: the text, or the wanted texts of an expression. Pickling drops it."""
    field: CodedScene | None = None
    """That was asked. Pickling drops it."""

    def __repr__(self) -> str:
        found = (
            f"{int(self.mask.sum()):,} of {len(self.mask):,} Gaussians, level {self.level}, {self.remark()}"
        )
        return f"Answer({self.text!r}: {found if self.presence else self.remark()})"

    def _repr_html_(self) -> str:
        return card(f"{self.text!r} in the scene", {**self.record(), "of": f"{len(self.mask):,} Gaussians"})

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "field": None, "asked": ()}  # which hold the scene

    def __deepcopy__(self, memo: dict[int, Any]) -> Answer:
        parts = tuple(part.__deepcopy__(memo) for part in self.parts)
        return replace(self, mask=self.mask.clone(), parts=parts)

    @property
    def certainty(self) -> Certainty | None:
        """The score in words: sure, likely, doubtful, not here."""
        return certainty(self.score, self.presence)

    def remark(self) -> str:
        """Return score and certainty in a few words."""
        if self.score is None:
            return "presence not judged" if self.presence else "not in this scene"
        where = "not in this scene" if not self.presence else str(self.certainty)
        return f"{where} (score {self.score:.2f})"

    def relevancy(self) -> Tensor:
        """Return the relevancy of every Gaussian at the level of the answer, [N] float32.

        Raises:
            InputError: the answer was pickled.
        """
        field = self._asked_field()
        each = [
            field.gaussian_relevancy(one.question.queries, one.question.canonical)[one.level, 0]
            for one in self.asked
        ]
        return torch.stack(each).amax(0).cpu()

    def in_view(
        self, camera: Camera | str | int = 0, projection: Projection | None = None, scale: float = 1.0
    ) -> ViewAnswer:
        """Draw the answer in one view: mask, heat map, box, point. Nothing is decided again.

        Args:
            camera: of the view, or its name or position among the field's cameras.
            projection: what ``field.project(camera)`` returned; further answers with it take less time.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.

        Raises:
            InputError, UnknownNameError: there is no such camera, or the answer was pickled.
        """
        from scoup.query.answering import draw_answers

        return draw_answers(self._asked_field(), [self], camera, projection, scale)[0]

    def _asked_field(self) -> CodedScene:
        if self.field is None:
            raise InputError(f"{self.text}: an answer that was pickled knows no scene; ask again")
        return self.field

    def record(self) -> dict[str, Any]:
        """Return the answer as plain JSON values, rounded."""
        return {
            "gaussians": int(self.mask.sum()),
            "things": list(self.things),
            "count": len(self.instances) if self.things or not self.presence else None,
            **self.verdict(),
            "runner_up": None if self.runner_up is None else _runner_up(self.runner_up),
        }

    def verdict(self) -> dict[str, Any]:
        """Return level, score and presence as plain JSON values, rounded."""
        return {
            "level": self.level,
            "score": _rounded(self.score),
            "certainty": self.certainty,
            "present": self.presence,
            **({} if self.threshold is None else {"threshold": round(self.threshold, 3)}),
        }


@dataclass(frozen=True, eq=False, repr=False)
class ViewAnswer:
    """An answer of the scene as one view shows it. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> seen = field.answer("kettle", "view_00")
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
    """[H, W] boolean, the mask without specks (``scoup.query.view_masks.main_parts``)."""
    box: tuple[int, int, int, int] | None
    """(x0, y0, x1, y1) around the main parts in pixels, x1 and y1 one past the last; None if nothing is visible."""
    point: tuple[int, int] | None
    """(x, y), the most relevant pixel of the largest part; None if nothing is visible."""
    render: Callable[[], Tensor] | None = None
    """Renders the colours of the view, [H, W, 3] 0..1, to draw the answer on. Pickling drops it."""
    depth: ViewDepth | None = None
    """Renders the depth of the view, for ``position``. Pickling drops it."""

    @property
    def text(self) -> str:
        """What was asked."""
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
        """Whether the thing is in the scene."""
        return self.answer.presence

    @property
    def visible(self) -> bool:
        """Whether the thing is visible from here."""
        return self.point is not None

    @property
    def coverage(self) -> float:
        """Share of the view in the mask, 0..1."""
        return int(self.mask.sum()) / max(1, self.mask.numel())

    @property
    def position(self) -> Tensor | None:
        """The middle of the surface that the main parts show, [3] float64 world units; None if nothing is visible or
        its depth is unknown. ``location`` finds the thing itself, from all sides."""
        return None if self.depth is None else self.depth.position(self.main_parts)

    def __repr__(self) -> str:
        found = f"point {self.point}, box {self.box}, {self.remark()}"
        return f"ViewAnswer({self.text!r} in {self.view!r}: {found if self.visible else self.remark()})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "render": None, "depth": None}  # which hold the scene

    def _repr_html_(self) -> str:
        return card(f"{self.text!r} in {self.view}", self.record(), as_picture(self.pictures()["overlay"]))

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
            rgb = torch.zeros(*self.heat.shape, 3) if self.render is None else self.render().cpu()
        return {
            "heat": heat_map(self.heat, rgb, self.text, self.level, float(self.heat.max())),
            "mask": self.mask,
            "overlay": mask_overlay(self.mask, rgb, self.box, self.point, self.text, self.remark()),
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

    def record(self) -> dict[str, Any]:
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


def _runner_up(found: RunnerUp) -> dict[str, Any]:
    return {"thing": found.thing, "score": _rounded(found.score)}


def _rounded(score: float | None) -> float | None:
    return None if score is None else round(score, 4)
