"""Vectors of the labels of a scene, and of the phrases that queries are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.evaluate.data_sets import LabelledScene
from scoup.models.text import TextEncoder


@dataclass(frozen=True, eq=False)
class LabelVectors:
    """Labels or other words by name, and the vectors that they are compared with; all of unit norm.

    Attributes:
        source: the table or model they are from.
        queries: [Q, D], of the texts.
        canonical: [P, D] of the canonical phrases.
        everyday: [B, D] of everyday words.
        texts: Q of them.
    """

    source: str
    queries: Tensor  # [Q, D]
    canonical: Tensor  # [P, D]
    everyday: Tensor  # [B, D]
    texts: tuple[str, ...]

    def of(self, texts: Sequence[str]) -> Tensor:
        """[len(texts), D] vectors of some of the texts."""
        return torch.stack([self.queries[self.texts.index(text)] for text in texts])


def text_source(root: Path, scene: LabelledScene, wanted: str | None, default: str) -> str:
    """The table or model that turns labels into vectors: the one wanted, or ``text.npz`` of the scene or of the data
    set, or ``default``."""
    if wanted is not None:
        return wanted.replace("{scene}", scene.name)
    for table in (scene.folder / "text.npz", root / "text.npz"):
        if table.is_file():
            return str(table)
    return default


def encode_labels(scene: LabelledScene, source: str, device: str = "cpu") -> LabelVectors:
    """Vectors of every label of a scene.

    Raises:
        InputError: a table lacks a label or a canonical phrase.
    """
    return encode_words(scene.labels, source, f"a label of {scene.name}", device)


def encode_words(words: Sequence[str], source: str, why: str, device: str = "cpu") -> LabelVectors:
    """Vectors of words; ``why`` they are needed, for the error.

    Raises:
        InputError: a table lacks a word or a canonical phrase.
    """
    with TextEncoder.open(source, device=device) as encoder:
        try:
            vectors = encoder.encode(list(words))
            canonical, everyday = encoder.canonical(), encoder.everyday()
        except UnknownNameError as error:
            raise InputError(f"{source}: has no vector for {error.name!r}, {why}") from error
    return LabelVectors(source, vectors, canonical, everyday, tuple(words))
