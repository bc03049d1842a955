"""Similarity transforms in files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scoup.base import FileFormatError
from scoup.io.similarity import read_similarity

TURNED = np.array([[0, -2.0, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]])
MIRRORED, SHEARED = (
    TURNED @ np.array(part) for part in (np.diag([-1, 1, 1, 1]), np.eye(4) + 0.1 * np.eye(4, k=1))
)
PROJECTIVE = TURNED + 0.5 * np.eye(4)[[0, 1, 2, 2]] * [[0], [0], [0], [1]]


@pytest.mark.parametrize(
    "text", [json.dumps(TURNED.tolist()), "\n\n".join(" ".join(map(str, row)) for row in TURNED), "\n".join(
        ", ".join(map(str, row)) for row in TURNED)]
)  # fmt: skip
def test_text_and_json(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    assert np.array_equal(read_similarity(path), TURNED)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (json.dumps(TURNED[:3].tolist()), "its content is a list of 3, expected 4 x 4 numbers"),
        ("1 0 0 0\n0 1 0 0\n0 0 1\n0 0 0 1", r"\[2\] is a list of 3, expected 4 numbers"),
        ("1 0 0 0\n0 1 0 x\n0 0 1 0\n0 0 0 1", r"\[1\]\[3\] is 'x', expected a finite number"),
        ("", "its content is a list of 0"),
        *((json.dumps(matrix.tolist()), "is not a rotation, scale and translation")
          for matrix in (MIRRORED, SHEARED, PROJECTIVE, 0 * TURNED)),
    ],
)  # fmt: skip
def test_anything_else_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=problem):
        read_similarity(path)
