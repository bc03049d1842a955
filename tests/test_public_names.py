"""The public names of the package."""

from __future__ import annotations

import subprocess
import sys

import pytest

import scoup
from scoup import raster


def test_importing_scoup_is_light():
    """`import scoup` loads neither torch nor model code."""

    heavy = ("torch", "numpy", "transformers", "PIL", "scipy")
    code = f"import sys, scoup; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_every_public_name_loads():
    for name in scoup.__all__:
        assert getattr(scoup, name) is not None
    assert callable(scoup.build)
    assert raster.BACKENDS
    with pytest.raises(AttributeError, match="no attribute"):
        _ = scoup.nonsense
