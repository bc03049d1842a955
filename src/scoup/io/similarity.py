"""A file with a similarity transform from one frame to another."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base import FileFormatError, JsonNode, existing_file
from scoup.io.reading import is_orthogonal, read_text

REMEDY = "the file should contain 4 rows of 4 numbers: a rotation times a scale, with a translation"


def read_similarity(path: str | Path) -> NDArray[np.float64]:
    """Return the similarity [4, 4] of a text or JSON file; a FileFormatError if it contains something else."""
    path = existing_file(path, "a transform")
    text = read_text(path)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = [[_number(word) for word in line.replace(",", " ").split()] for line in text.splitlines()]
        value = [row for row in value if row]
    matrix = JsonNode(path, value, REMEDY).numbers(4, 4)
    if similarity_scale(matrix) is None:
        raise FileFormatError(path, "is not a rotation, scale and translation", REMEDY)
    return matrix


def similarity_scale(matrix: NDArray[np.float64]) -> float | None:
    """Return the scale of a similarity [4, 4]; None for another matrix."""
    with np.errstate(all="ignore"):
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        straight = is_orthogonal(matrix[:3, :3] / scale)
    return scale if straight and scale > 0 and np.array_equal(matrix[3], [0, 0, 0, 1]) else None


def _number(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word
