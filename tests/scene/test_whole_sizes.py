"""Sizes of cameras are whole numbers of pixels, of whatever type."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

from children import finished
from scoup.base.errors import InputError
from scoup.scene.cameras import Camera


def camera(width: object, height: object = 480) -> Camera:
    K = torch.tensor([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    return Camera("a.png", torch.eye(4), K, width, height)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("width", [640, 640.0, np.int32(640), np.float32(640), torch.tensor(640)])
def test_whole_numbers_of_any_type(width: object) -> None:
    made = camera(width, width)
    assert (made.width, type(made.width), type(made.height)) == (640, int, int)
    assert made.fingerprint() == camera(640, 640).fingerprint()


@pytest.mark.parametrize("bad", [480.5, float("nan"), float("inf"), "480", None, [480]])
def test_other_sizes_are_refused(bad: object) -> None:
    with pytest.raises(InputError, match=r"a\.png': height .* is not a whole number of pixels"):
        camera(640, bad)


def test_the_command_line_is_a_module_too() -> None:
    done = finished([sys.executable, "-m", "scoup", "--help"])
    assert done.returncode == 0
    assert done.stdout.startswith("usage: scoup")
