"""Demo scenes small enough for tests."""

from __future__ import annotations

from typing import Any

import pytest

from scoup_lab.synthetic import DemoScene, make_demo_scene
from scoup_lab.synthetic.splat import make_splat

SMALL: dict[str, Any] = {"n_gaussians": 30_000, "width": 240, "height": 180, "n_building": 6, "n_held_out": 2}
"""The size of the scene that tests share."""


def well_lit_scene(*size: Any, **sizes: Any) -> DemoScene:
    """As in the demo; other tests have one direction of light (conftest.py)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scoup_lab.synthetic.scene.make_splat", make_splat)
        return make_demo_scene(*size, **sizes)
