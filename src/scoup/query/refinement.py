"""Answers refined on demand: a model with words looks for texts in some photographs, and things get names.

Views are chosen one by one: those that show things that may answer, largest where they fit best, and things that few
views chosen before have shown. All things count a little, for the field may be wrong.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.base import InputError, check_arguments
from scoup.field import Field
from scoup.io import attach_images, load_image
from scoup.models import ConceptModel, open_concepts
from scoup.pictures import as_picture
from scoup.query import constants
from scoup.query.field_view import FieldView
from scoup.query.language_field import LanguageField
from scoup.query.question import literal
from scoup.query.thing_judge import thing_index
from scoup.scene import Camera, Cameras, Detections
from scoup.uplift import name_field


@dataclass(frozen=True, eq=False)
class Refined:
    """A field with the names that a model gave to its things, and the views, photographed or rendered, that it saw."""

    field: LanguageField
    texts: tuple[str, ...]
    views: tuple[str, ...]
    rendered: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        facts = {"texts": self.texts, "views": self.views, "rendered": self.rendered}
        return {**facts, "seconds": round(self.seconds, 2)}

    def describe(self) -> str:
        """Return it in words, for people."""
        pictures = f"{len(self.views) - self.rendered} photographs"
        if self.rendered:
            pictures += f" and {self.rendered} rendered views"
        return f"looked for {', '.join(self.texts)} in {pictures}, {self.seconds:.1f} s"


def refine(
    field: LanguageField,
    texts: str | Sequence[str],
    model: ConceptModel | str,
    cameras: Cameras | None = None,
) -> Refined:
    """Look for texts in photographs of a field with a model, and name the things that it finds.

    The field of the result answers these texts by the model's votes and its own embeddings (``scoup.query.named``).

    Args:
        field: with things; it is not changed.
        texts: to look for, or phrases with them.
        model: or its name (``scoup.models.concepts.CONCEPTS``).
        cameras: with their photographs; by default the field's own. A camera without one is rendered.

    Raises:
        InputError: the field has no things or no cameras.

    Example:
        >>> from scoup.scene import Detections
        >>> class Finder:  # finds the first text everywhere; in place of "owlv2"
        ...     def detect(self, image, texts):
        ...         box = torch.tensor([[0.0, 0.0, image.shape[1], image.shape[0]]])
        ...         return Detections(torch.tensor([0]), torch.tensor([0.9]), box, image.shape[1::-1])
        >>> refined = scoup.refine(field, "kettle", Finder())
        >>> refined.field.thing_table.names.texts, field.thing_table.names
        (('kettle',), None)
    """
    started = time.perf_counter()
    check_arguments("refine", field=(field, LanguageField))
    words, table = field.question(texts if isinstance(texts, str) else list(texts)).texts, field.thing_table
    if table is None or not len(table):
        raise InputError(
            f"{field.path or 'this field'}: contains no things to name; build it again with things"
        )
    cameras = photographed_cameras(field) if cameras is None else cameras
    if not len(cameras):
        raise InputError("there is no camera to look through; pass those of the photographs")
    model = open_concepts(model, device=field.codebook.device) if isinstance(model, str) else model
    views: list[tuple[Camera, Detections]] = []
    rendered = 0
    for camera in choose_views(field, words, cameras):
        if camera.image_path is not None and camera.image_path.is_file():
            shown = load_image(camera).numpy()
        else:
            shown = as_picture(FieldView(field, camera).renders.colors())
            rendered += 1
        views.append((camera, model.detect(shown, words)))
    looked_at = tuple(camera.name for camera, _ in views)
    return Refined(name_field(field, words, views), words, looked_at, rendered, time.perf_counter() - started)


def photographed_cameras(field: Field) -> Cameras:
    """Return the cameras of a field with their photographs, as far as they are known or beside its splat."""
    cameras = field.cameras
    if cameras is None or not len(cameras):
        raise InputError(f"{field.path or 'this field'}: contains no cameras; pass those of its photographs")
    if field.geometry_path is None or any(camera.image_path is not None for camera in cameras):
        return cameras
    return attach_images(
        cameras, field.geometry_path, tuple(field.geometry_path.parents[:4]), None, None, "keep", warn=False
    )


def choose_views(
    field: LanguageField, texts: Sequence[str], cameras: Cameras, most: int = constants.MOST_PHOTOGRAPHS
) -> list[Camera]:
    """Return up to ``most`` cameras in which things that may answer texts are seen best, in order of their names."""
    question = field.question(literal(list(texts)))
    known = thing_index(field, question)
    assert known is not None
    fits = known.fits(question.queries)[known.usable]
    weights = (fits - fits.amax(0)).exp().amax(1) + constants.ALL_THINGS / max(1, len(fits))
    sizes = field.kept(
        (_apparent_sizes, *(camera.fingerprint() for camera in cameras)),
        lambda: _apparent_sizes(field, cameras),
    )[:, known.usable]
    chosen: list[int] = []
    seen = torch.zeros(len(weights))
    for _ in range(min(most, len(cameras))):
        gains = (weights * sizes / (1 + seen)).sum(1)
        gains[chosen] = -1
        chosen.append(int(gains.argmax()))
        seen += sizes[chosen[-1]]
    return [cameras[number] for number in sorted(chosen)]


def _apparent_sizes(field: Field, cameras: Cameras) -> Tensor:
    """Return the apparent size of each of T things in each camera, [V, T] 0..1, ignoring occlusion."""
    table = field.thing_table
    assert table is not None
    means = field.gaussians.means.float().cpu()
    means = torch.where(means.isfinite(), means, 0.0)
    counts = table.sums(torch.ones(len(means)))
    middles = torch.stack([table.sums(axis) for axis in means.T], 1) / counts.clamp(min=1)[:, None]
    squares = table.sums(means.square().sum(1)) / counts.clamp(min=1)
    radii = (squares - middles.square().sum(1)).clamp(min=0).sqrt()
    sizes = []
    for camera in cameras:
        size = (
            camera.fx
            * radii
            / camera.pixels(middles)[1]
            / (constants.LARGE * max(camera.width, camera.height))
        )
        sizes.append(torch.where(camera.shows(middles) & (counts > 0), size.clamp(max=1), 0.0))
    return torch.stack(sizes).float()
