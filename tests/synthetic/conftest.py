"""One small demo scene for all tests of this folder."""

from __future__ import annotations

import pytest

from scoup_lab.synthetic import DemoScene
from synthetic.small_scenes import SMALL, well_lit_scene


@pytest.fixture(scope="session")
def scene() -> DemoScene:
    return well_lit_scene(**SMALL)
