"""Options that verbs on a language field share: the field, its cameras, the text encoder."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from scoup.base import InputError, MissingFileError, ScoupWarning, UnknownNameError, listed, share_of
from scoup.cli.options import Model, Names, arg

if TYPE_CHECKING:
    from scoup.query import Expression, Frame, LanguageField, Question
    from scoup.scene import Camera, Cameras

Asked = TypeVar("Asked", bound="list[str] | tuple[str, ...] | Expression")

_SAME_FRAME = "check that cameras and splat are in the same frame"


@dataclass(frozen=True, kw_only=True)
class FieldOptions:
    """Options of verbs that open a language field."""

    gaussians: Path | None = None
    """The splat the field was built on, if it has moved since. Default: the one the field names."""

    def open(self, path: Path, device: str, splat_option: str = "--gaussians") -> LanguageField:
        """The field with its geometry, on the device; a missing or wrong geometry is an error at once, not after
        other work.

        Raises:
            MissingFileError, FileFormatError: the field or its geometry is missing or damaged.
            GeometryMismatchError: the geometry is not the one the field was built on.
        """
        from scoup.io import load_gaussians
        from scoup.query import LanguageField

        field = LanguageField.load(path)
        if self.gaussians is not None:
            field.attach(load_gaussians(self.gaussians), str(self.gaussians))
        elif not field.has_geometry:
            if field.geometry_path is None:
                raise InputError(
                    f"{path}: does not say where its Gaussians are; name them with {splat_option}"
                )
            try:
                field.attach(load_gaussians(field.geometry_path), str(field.geometry_path))
            except MissingFileError as error:
                problem = f"is not there, and {path} was built on it"
                raise MissingFileError(
                    error.path, problem, f"say where it is now with {splat_option}"
                ) from error
        return field.to(device)


@dataclass(frozen=True, kw_only=True)
class TextOptions(FieldOptions):
    """Options of verbs that ask a language field."""

    text: Model = None
    """Text encoder: a word table, a CLIP model, or open_clip:ARCH/PRETRAINED. Default: the field's."""

    def open(self, path: Path, device: str, splat_option: str = "--gaussians") -> LanguageField:
        field = super().open(path, device, splat_option)
        return field if self.text is None else field.with_encoder(self.text)

    def question(self, field: LanguageField, texts: Asked, **options: Any) -> Question[Asked]:
        """Return the question that ``field.question`` makes of texts and options.

        Raises:
            InputError, UnknownNameError: as there; or neither the options nor the field name a model or table.
        """
        question = field.question(texts, **options)
        field.encoder.close()  # models are large
        return question


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Options of verbs that render a field in the views of cameras."""

    camera: Names = ()
    """Name of a camera (with or without extension), or all; repeat it for several. Default: the first."""
    scene: Path | None = None
    """Take the cameras of this scene folder or cameras file. Default: those the field was built from."""

    def all_cameras(self, field: LanguageField, path: Path) -> Cameras:
        """Return the cameras of --scene, or of the field at ``path``.

        Raises:
            InputError: there are no cameras.
        """
        from scoup.io import load_cameras

        cameras: Cameras | None = field.cameras
        if self.scene is not None:
            # Rendering is always through the ideal pinhole, so distortion is no obstacle here.
            cameras = load_cameras(self.scene, distorted="undistort", missing_images="keep")
        if cameras is None or not len(cameras):
            raise InputError(f"{path}: contains no cameras; name a scene that has them with --scene")
        return cameras

    def open_cameras(self, field: LanguageField, path: Path, default: str = "") -> list[Camera]:
        """Return the cameras named, else the default: all, or the first; further errors of ``all_cameras``.

        Raises:
            UnknownNameError: there is no camera of that name.
        """
        cameras = self.all_cameras(field, path)
        if "all" in (self.camera or (default,)):
            return list(cameras)
        try:
            chosen = [cameras[name] for name in self.camera] or [cameras[0]]
        except UnknownNameError as error:
            raise UnknownNameError("camera", error.name, cameras.names, str(self.scene or path)) from error
        return list(dict.fromkeys(chosen))

    def check_seen(self, path: Path, blind: list[Camera], count: int) -> None:
        """Warn of the cameras, among ``count``, in which nothing of the field is visible.

        Raises:
            InputError: nothing is visible in any of them.
        """
        names = listed([camera.name for camera in blind])
        if blind and len(blind) == count:
            raise InputError(
                f"{self.scene or path}: {'the camera sees' if count == 1 else 'the cameras see'} nothing of the field "
                f"({names}); {_SAME_FRAME}"
            )
        if blind:
            some, see = share_of(len(blind), count, "camera"), "sees" if len(blind) == 1 else "see"
            message = f"{some} {see} nothing of the field ({names}); {_SAME_FRAME}"
            warnings.warn(message, ScoupWarning, stacklevel=2)


@dataclass(frozen=True, kw_only=True)
class WordOptions:
    """Options of verbs that name things."""

    words: Path | None = None
    """Words to name things with, one per line. Default: all words of the table of --text, else everyday words
    and names that a model gave."""


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Options of verbs that understand relations between things."""

    seen_from: Annotated[str | None, arg(metavar="CAMERA")] = None
    """The camera from which left, right, in front of and behind are meant. Default: the one that sees the most."""

    def frame(self, field: LanguageField) -> Frame | None:
        """Return the directions of the options; None without any."""
        return None if self.seen_from is None else field.frame(self.seen_from)


@dataclass(frozen=True, kw_only=True)
class AnswerOptions:
    """Options of verbs that answer texts and phrases."""

    threshold: float | None = None
    """Let all Gaussians above this relevancy answer, 0 to 1 once it is rescaled over the scene. Default: things answer;
    in a field without things the Gaussians above the threshold at which the answer changes least."""
    presence: float | None = None
    """Least score of a text that is in the scene, 0 to 1: the share of everyday words whose best fit in this scene is
    lower, or less if some are nearer to what fits best. Below it, nothing answers. Default: 0.35, if the table of
    --text has 16 words or more."""
    always: bool = False
    """Answer every text, without judging presence."""

    def rules(self) -> dict[str, Any]:
        """Return the options as arguments of ``LanguageField.question``."""
        return {"threshold": self.threshold, "present_from": self.presence, "always": self.always}


@dataclass(frozen=True, kw_only=True)
class LevelOptions(AnswerOptions):
    """Options of verbs with a choice of the level that answers."""

    level: str | None = None
    """The level that answers: s (fine), m or l (coarse). Default: the one that fits best, for each text."""

    def rules(self) -> dict[str, Any]:
        return {**super().rules(), "level": self.level}


def output_folder(out: Path | None, field: Path, ending: str) -> Path:
    """Return the folder to write results into, by default <name of FIELD>_<ending> here."""
    folder = out or Path(f"{field.stem}_{ending}")
    if folder.is_file():
        raise InputError(f"{folder}: is a file; name a folder to write the results into with --out")
    if folder.suffix.lower() in (".png", ".jpg", ".jpeg", ".json", ".mp4") and not folder.is_dir():
        raise InputError(f"{folder}: the results are several files; name a folder with --out")
    return folder


def check_texts(texts: tuple[str, ...]) -> None:
    """Refuse a call without any text, or with a field for a text."""
    if not texts:
        raise InputError('name at least one text to look for, for example "kettle"')
    for text in texts:
        if text.lower().endswith(".scoup"):
            raise InputError(f"{text}: is a field, expected a text; ask one field at a time")
        if Path(text).suffix and Path(text).is_file():
            raise InputError(f"{text}: is a file, expected a text; type its words")
