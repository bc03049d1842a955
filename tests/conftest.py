"""Fixtures and settings shared by all tests."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from scoup import native

# Times vary with the load of the machine: a slow example is no failure.
settings.register_profile("scoup", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("scoup")

if native.missing_reason() is not None:
    # Tests turn warnings into errors; that the core is missing is said by the tests that skip for it.
    os.environ["SCOUP_NATIVE"] = "off"
    native._loaded.cache_clear()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real data: $SCOUP_TEST_DATA, or ``shared/data`` beside the repository. Mark such tests ``data``."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SCOUP_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder} (set SCOUP_TEST_DATA)")
    return folder


@pytest.fixture(scope="session")
def needs_triton() -> None:
    """Tests that compile or interpret kernels are skipped where triton is not installed."""
    if importlib.util.find_spec("triton") is None:
        pytest.skip("triton is not installed")
