"""The forms of the exact coder, for tests that hold for each."""

from __future__ import annotations

from types import ModuleType

import pytest
from coders import Coder, native_coder, reference_coder


@pytest.fixture(scope="session")
def core() -> ModuleType:
    """The compiled core; tests that need it are skipped where it is not built."""
    module = pytest.importorskip("scoup.base.native").native_core()
    if module is None:
        pytest.skip("the compiled core is not built")
    return module


@pytest.fixture(params=["reference", "native"])
def coder(request: pytest.FixtureRequest) -> Coder:
    """Codes rows from similarities; see ``coders``."""
    return reference_coder if request.param == "reference" else native_coder(request.getfixturevalue("core"))


@pytest.fixture(params=["reference", "native"])
def backend(request: pytest.FixtureRequest) -> str:
    """Name of the backend that the exact solver computes with in this test."""
    if request.param == "native":
        request.getfixturevalue("core")
    return request.param
