"""What a field needs besides its codes: its geometry, its cameras, and the encoder of its texts."""

from __future__ import annotations

from pathlib import Path

from scoup.base.counts import counted
from scoup.base.errors import GeometryMismatchError, InputError, MissingFileError
from scoup.io import load_gaussians
from scoup.models.text import COLORS, NO_WORDS_FOR_COLORS
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.field_info import FieldInfo
from scoup.scene.gaussians import Gaussians


def named_geometry(path: Path | None, field: str) -> Gaussians:
    """Read the geometry that a field names; ``field`` is its name in messages."""
    if path is None:
        raise InputError(
            f"{field}: does not say where its Gaussians are; pass them: LanguageField.load(path, gaussians)"
        )
    return load_gaussians(path)


def check_geometry(gaussians: Gaussians, info: FieldInfo, source: str, known: bool) -> None:
    """Refuse Gaussians that a field was not built on; ``LanguageField.attach`` documents the arguments."""
    as_many = len(gaussians) == info.n_gaussians
    if not as_many or (not known and gaussians.fingerprint() != info.fingerprint):
        difference = "as many Gaussians, but others"
        if not as_many:
            difference = f"{counted(len(gaussians), 'Gaussian')}, the field has {info.n_gaussians:,}"
        raise GeometryMismatchError(
            f"{source}: not the geometry this field was built on ({difference}); "
            "pass the original splat, or build the field again"
        )


def camera_of(cameras: Cameras | None, camera: str | int) -> Camera:
    """Return a camera by name or position; ``LanguageField.camera`` documents the errors."""
    if cameras is None or not len(cameras):
        raise InputError(
            "this field contains no cameras; pass a Camera (scoup.load_cameras reads those of a scene)"
        )
    try:
        return cameras[camera]
    except IndexError:
        raise InputError(f"there is no camera {camera}; this field has {len(cameras)}") from None


def named_encoder(info: FieldInfo, field: str) -> str:
    """Return the word table or model that a field names; ``LanguageField.encoder_source`` documents the errors."""
    words = info.words
    if words is not None:
        if not words.is_file():
            problem = "is missing, and the field names it as its word table"
            raise MissingFileError(words, problem, "pass its new path as `encoder`")
        return str(words)
    if not info.embedding_model:
        raise InputError(f"{field}: names no embedding model; pass a word table or model as `encoder`")
    if info.embedding_model == COLORS:
        raise InputError(f"{field}: {NO_WORDS_FOR_COLORS}")
    return info.embedding_model
