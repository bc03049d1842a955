"""Animations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scoup.base.errors import InputError
from scoup.pictures.animation import save_animation


def test_pictures_of_different_sizes_are_refused(tmp_path: Path) -> None:
    frames = [np.zeros((8, width, 3), np.uint8) for width in (9, 10)]
    with pytest.raises(InputError, match=r"a\.gif: the pictures differ in size"):
        save_animation(frames, tmp_path / "a.gif", 12)
    assert not (tmp_path / "a.gif").exists()
