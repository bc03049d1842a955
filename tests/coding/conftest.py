"""The forms of the exact coder, for tests that hold for each."""

from __future__ import annotations

from types import ModuleType

import pytest
from coders import Coder, native_coder

from scoup.base import native_core
from scoup.coding.reference import code


@pytest.fixture(scope="session")
def core() -> ModuleType:
    """The compiled core; tests that need it are skipped where it is not built."""
    module = native_core()
    if module is None:
        pytest.skip("the compiled core is not built")
    return module


@pytest.fixture(params=["reference", "native"])
def backend(request: pytest.FixtureRequest) -> str:
    """Name of the backend that the exact solver computes with in this test."""
    if request.param == "native":
        request.getfixturevalue("core")
    return request.param


@pytest.fixture
def coder(backend: str, request: pytest.FixtureRequest) -> Coder:
    return code if backend == "reference" else native_coder(request.getfixturevalue("core"))
