"""Similarity transforms in files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scene_damages import TURNED

from scoup.io.similarity import read_similarity


@pytest.mark.parametrize(
    "text", [json.dumps(TURNED.tolist()), "\n\n".join(" ".join(map(str, row)) for row in TURNED), "\n".join(
        ", ".join(map(str, row)) for row in TURNED)]
)  # fmt: skip
def test_text_and_json(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    assert np.array_equal(read_similarity(path), TURNED)
