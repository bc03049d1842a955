"""Demo scenes small enough for tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import pytest

from scoup_lab.synthetic.splat import make_splat

SMALL: dict[str, Any] = {"n_gaussians": 30_000, "width": 240, "height": 180, "n_building": 6, "n_held_out": 2}
"""The size of the scene that tests share."""


@contextmanager
def one_light() -> Iterator[None]:
    """Scenes made meanwhile are lit from one direction of the sun and one of the sky: on small scenes, light takes most
    of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scoup_lab.synthetic.scene.make_splat", partial(make_splat, n_directions=1))
        yield
