"""What verbs that ask a field share: opening it, its cameras, its text encoder."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from scoup.cli.options import FieldFile, OptionalPath, OptionalText, WritesCommon

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.field.language_field import LanguageField
    from scoup.raster import Projection
    from scoup.scene.cameras import Camera, Cameras

LONGEST_SIDE = 16384  # of a picture, in pixels

_SAME_FRAME = "check that cameras and splat are in the same frame"


@dataclass(frozen=True, kw_only=True)
class AsksField(WritesCommon):
    """Options of verbs that open a language field."""

    field: FieldFile
    """The .scoup file."""
    gaussians: OptionalPath = None
    """The splat the field was built on, if it has moved since. Default: the one the field names."""

    def open_field(self) -> LanguageField:
        """The field with its geometry: a missing or wrong one is told now, not after other work.

        Raises:
            MissingFileError, FileFormatError: the field or its geometry is missing or damaged.
            GeometryMismatchError: the geometry is not the one the field was built on.
        """
        from scoup.base.errors import InputError, MissingFileError
        from scoup.field.language_field import LanguageField
        from scoup.io import load_gaussians

        field = LanguageField.load(self.field)
        if self.gaussians is not None:
            field.attach(load_gaussians(self.gaussians), str(self.gaussians))
        elif not field.has_geometry:
            if field.geometry_path is None:
                raise InputError(
                    f"{self.field}: does not say where its Gaussians are; name them with --gaussians"
                )
            try:
                field.attach(load_gaussians(field.geometry_path), str(field.geometry_path))
            except MissingFileError as error:
                problem = f"is not there, and {self.field} was built on it"
                raise MissingFileError(error.path, problem, "say where it is now with --gaussians") from error
        return field.to(self.device)


@dataclass(frozen=True, kw_only=True)
class AsksViews(AsksField):
    """Options of verbs that look through cameras."""

    camera: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME", help_behavior_hint="")
    ] = ()
    """Name of a camera (with or without extension), or all; repeat it for several. Default: the first."""
    scene: OptionalPath = None
    """Look through the cameras of this scene folder or cameras file. Default: those the field was built from."""
    scale: float = 1.0
    """Size of the pictures relative to the cameras' own."""

    def open_cameras(self, field: LanguageField) -> list[Camera]:
        """The cameras asked for.

        Raises:
            UnknownNameError: there is no camera of that name.
            InputError: there are no cameras, or the pictures would be too large.
        """
        from scoup.base.errors import InputError, UnknownNameError
        from scoup.io import load_cameras

        cameras: Cameras | None = field.cameras
        if self.scene is not None:
            # Rendering is always through the ideal pinhole, so distortion is no obstacle here.
            cameras = load_cameras(self.scene, distorted="undistort", missing_images="keep")
        if cameras is None or not len(cameras):
            raise InputError(f"{self.field}: holds no cameras; name a scene that has them with --scene")
        longest = max(max(camera.width, camera.height) for camera in cameras)
        if not (self.scale > 0 and math.isfinite(self.scale)) or longest * self.scale > LONGEST_SIDE:
            most = LONGEST_SIDE / longest
            raise InputError(
                f"--scale {self.scale}: must be above 0 and at most {most:.3g} for these cameras"
            )
        cameras = cameras.scaled(self.scale) if self.scale != 1 else cameras
        if "all" in self.camera:
            return list(cameras)
        try:
            found = [cameras[name] for name in self.camera] or [cameras[0]]
        except UnknownNameError as error:
            raise UnknownNameError(
                "camera", error.name, cameras.names, str(self.scene or self.field)
            ) from error
        return list(dict.fromkeys(found))

    def tell_blind(self, blind: list[Camera], count: int) -> None:
        """Say which of ``count`` cameras see nothing.

        Raises:
            InputError: none of them sees anything.
        """
        from scoup.base.errors import InputError, ScoupWarning

        names = ", ".join(camera.name for camera in blind[:3]) + (", ..." if len(blind) > 3 else "")
        if blind and len(blind) == count:
            raise InputError(
                f"{self.scene or self.field}: the cameras see nothing of the field ({names}); {_SAME_FRAME}"
            )
        if blind:
            message = f"{len(blind)} of {count} cameras see nothing of the field ({names}); {_SAME_FRAME}"
            warnings.warn(message, ScoupWarning, stacklevel=2)


@dataclass(frozen=True, eq=False)
class TextVectors:
    """What a field is asked with.

    Attributes:
        source: the table or model they are from.
        queries: [Q, D].
        canonical: [P, D] of the canonical phrases.
        everyday: [B, D] of everyday words.
    """

    source: str
    queries: Tensor
    canonical: Tensor
    everyday: Tensor

    def standing_words(self, wanted: bool) -> Tensor | None:
        """Everyday words to judge presence by; None where a table has too few.

        Raises:
            InputError: it has too few, and presence was ``wanted`` by name.
        """
        from scoup.base.errors import InputError
        from scoup.models.words import LEAST_WORDS

        if len(self.everyday) >= LEAST_WORDS:
            return self.everyday
        if wanted:
            raise InputError(
                f"{self.source}: has {len(self.everyday)} words; --presence compares with {LEAST_WORDS} or more, so "
                "add any words to the table"
            )
        return None


def not_there(place: str, standing: float | None, bound: float) -> str:
    """What is said of a text that is judged to be absent; ``standing`` is None or infinite where nothing was found."""
    found = standing is not None and math.isfinite(standing)
    return (
        f"not in this {place} ({f'standing {standing:.1f}' if found else 'nothing found'}, {bound:g} asked)"
    )


@dataclass(frozen=True, kw_only=True)
class AsksText(AsksField):
    """Options of verbs that take words."""

    text: Annotated[OptionalText, tyro.conf.arg(metavar="TABLE|MODEL", help_behavior_hint="")] = None
    """Turns words into vectors: a table, a CLIP model, or open_clip:ARCH/PRETRAINED. Default: the field's."""

    def encode(self, field: LanguageField, phrases: Iterable[str]) -> TextVectors:
        """Vectors of the phrases, of the canonical phrases, and of everyday words.

        Raises:
            UnknownNameError: a word is not in the table; the nearest names are listed.
            InputError: the vectors have another size than the field's embeddings, or the table lacks the
                canonical phrases.
        """
        from scoup.base.errors import InputError, UnknownNameError
        from scoup.models.text import TextEncoder
        from scoup.models.words import CANONICAL_PHRASES

        source = self.text or self._named_by(field)
        if not source:
            raise InputError(f"{self.field}: names no embedding model; give a table or model with --text")
        with TextEncoder.open(source, device=self.device) as encoder:
            if encoder.dim != field.dim:
                raise InputError(
                    f"{source}: gives vectors of {encoder.dim} dimensions, but {self.field} holds embeddings of "
                    f"{field.dim}; name the model its regions were encoded with ({field.info.embedding_model}) "
                    "or a table made with it"
                )
            queries = encoder.encode(list(phrases))
            try:
                canonical = encoder.canonical()
            except UnknownNameError as error:
                raise InputError(
                    f"{source}: lacks {error.name!r}; relevancy compares every text with the phrases "
                    f"{', '.join(CANONICAL_PHRASES)}, so encode them into the table too"
                ) from error
            return TextVectors(source, queries, canonical, encoder.everyday())

    def _named_by(self, field: LanguageField) -> str:
        """The model the field names; a table is sought beside the field, as its geometry is."""
        from scoup.models.word_table import is_table

        name = field.info.embedding_model
        beside = self.field.parent / name
        return str(beside) if name and is_table(name) and beside.is_file() else name


def sees_nothing(field: LanguageField, view: Projection) -> bool:
    """Whether no Gaussian with a code paints a pixel of the view."""
    from scoup.raster import render_channels

    image, _ = render_channels(view, field.coded()[:, None].float())
    return not bool(image.any())
