"""One small demo scene for all tests of this folder."""

from __future__ import annotations

import pytest

from scoup_lab.synthetic import DemoScene, make_demo_scene
from synthetic.small_scenes import SMALL


@pytest.fixture(scope="session")
def scene() -> DemoScene:
    return make_demo_scene(**SMALL)
