"""The public names of the package."""

from __future__ import annotations

import sys

import pytest

import scoup
from children import finished
from scoup import raster


def test_importing_scoup_is_light():
    """`import scoup` loads neither torch nor model code nor the compiled core."""
    heavy = ("torch", "numpy", "transformers", "PIL", "scipy", "scoup._native")
    code = f"import sys, scoup, scoup.base.native; print([name for name in {heavy} if name in sys.modules])"
    assert finished([sys.executable, "-c", code]).stdout.strip() == "[]"


def test_every_public_name_loads():
    for name in scoup.__all__:
        assert getattr(scoup, name) is not None
    assert callable(scoup.build)
    assert raster.BACKENDS
    with pytest.raises(AttributeError, match="no attribute"):
        _ = scoup.nonsense
