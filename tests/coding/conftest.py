"""The forms of the exact coder, for tests that hold for each."""

from __future__ import annotations

import importlib.util
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from types import ModuleType

import pytest
from coders import Coder, interpret_kernels, interpreted_coder, native_coder, reference_coder

from scoup.coding import exact
from scoup.coding.arithmetic import Arithmetic, NativeArithmetic, TorchArithmetic


@pytest.fixture(scope="session")
def core() -> ModuleType:
    """The compiled core; tests that need it are skipped where it is not built."""
    module = pytest.importorskip("scoup.native").native_core()
    if module is None:
        pytest.skip("the compiled core is not built")
    return module


@pytest.fixture(scope="session")
def needs_triton() -> None:
    """Tests that compile or interpret kernels are skipped where triton is not installed."""
    if importlib.util.find_spec("triton") is None:
        pytest.skip("triton is not installed")


@pytest.fixture(scope="module")
def interpreted(needs_triton: None) -> Iterator[Coder]:
    """The coder for GPUs, interpreted on the CPU in a process of its own; slow, so give it few rows."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=interpret_kernels) as worker:
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
