"""Vectors of labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scoup.base import InputError, UnknownNameError
from scoup.models import TextEncoder
from scoup.query import TextVectors
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.scenes import SceneFiles


def text_source(root: Path, scene: SceneFiles, wanted: str | None, default: str) -> str:
    """Return the table or model that turns labels into vectors: the one wanted, or ``text.npz`` of the scene or
    of the data set, or ``default``."""
    if wanted is not None:
        return wanted.replace("{scene}", scene.name)
    for table in (scene.folder / "text.npz", root / "text.npz"):
        if table.is_file():
            return str(table)
    return default


def encode_labels(scene: LabelledScene, source: str, device: str = "cpu") -> TextVectors:
    """Return vectors of every label of a scene."""
    return encode_words(scene.labels, source, f"a label of {scene.name}", device)


def encode_words(words: Sequence[str], source: str, why: str, device: str = "cpu") -> TextVectors:
    """Return vectors of words; ``why`` they are needed, for the error."""
    with TextEncoder.open(source, device=device) as encoder:
        try:
            vectors = encoder.encode(list(words))
            canonical, everyday = encoder.canonical(), encoder.everyday()
        except UnknownNameError as error:
            raise InputError(f"{source}: has no vector for {error.name!r}, {why}") from error
    return TextVectors(tuple(words), vectors, canonical, everyday, source)
