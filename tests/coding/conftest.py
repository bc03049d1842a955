"""The forms of the exact coder, for tests that hold for each."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import pytest
from coders import Coder, interpreted_coder, native_coder, reference_coder

from interpreting import interpreter
from scoup.coding import exact
from scoup.coding.arithmetic import Arithmetic, NativeArithmetic, TorchArithmetic


@pytest.fixture(scope="session")
def core() -> ModuleType:
    """The compiled core; tests that need it are skipped where it is not built."""
    module = pytest.importorskip("scoup.base.native").native_core()
    if module is None:
        pytest.skip("the compiled core is not built")
    return module


@pytest.fixture(scope="module")
def interpreted(needs_triton: None) -> Iterator[Coder]:
    """The coder for GPUs, interpreted on the CPU in a process of its own; slow, so give it few rows."""
    with interpreter() as worker:
        yield interpreted_coder(worker)


@pytest.fixture(params=["torch", "native"])
def coder(request: pytest.FixtureRequest) -> Coder:
    """Codes rows from similarities; see ``coders``."""
    return reference_coder if request.param == "torch" else native_coder(request.getfixturevalue("core"))


@pytest.fixture(params=["torch", "native"])
def arithmetic(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Arithmetic:
    """What the exact solver computes with in this test."""
    chosen: Arithmetic = (
        TorchArithmetic() if request.param == "torch" else NativeArithmetic(request.getfixturevalue("core"))
    )
    monkeypatch.setattr(exact, "arithmetic_at_hand", lambda device: chosen)
    return chosen
