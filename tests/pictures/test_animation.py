"""Animations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from scoup.pictures.animation import save_animation


def test_shorter_pictures_get_a_margin_above(tmp_path: Path) -> None:
    frames = [np.full((height, 9, 3), 200, np.uint8) for height in (8, 6)]
    save_animation(frames, tmp_path / "a.webp", 12)
    with Image.open(tmp_path / "a.webp") as picture:
        assert picture.size == (9, 8)
        picture.seek(1)
        shown = np.asarray(picture.convert("RGB"))
    assert (shown[0] < 60).all()
    assert (shown[-1] > 150).all()
