"""Which backend serves: one guard and one loader for the rasteriser and the vote."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from types import ModuleType
from unittest.mock import Mock

import pytest
import torch

from messages import refuses, warns
from scoup import raster
from scoup.base import backends
from scoup.base.backends import default_backend, load_backend, require_backend
from scoup.base.errors import InputError, ScoupWarning, UnknownNameError, warn_once
from scoup.uplift import voting as vote

CPU, GPU = torch.device("cpu"), torch.device("cuda:1")
TABLES = {"raster": raster.BACKENDS, "vote": vote.BACKENDS}
of_every_room = pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)


@pytest.fixture(autouse=True)
def warnings_again() -> Iterator[None]:
    warn_once.cache_clear()
    yield
    warn_once.cache_clear()


@pytest.fixture
def a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if there were a GPU of Nvidia's that serves, and a Triton for it."""
    monkeypatch.setitem(sys.modules, "triton", ModuleType("triton"))
    monkeypatch.setattr(torch.version, "hip", None)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (8, 6))
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)


def without_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "triton", None)


def with_old_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (7, 5))


@of_every_room
@pytest.mark.parametrize("spoil", [without_triton, with_old_gpu])
def test_what_cannot_run_the_kernels(
    a_gpu: None, monkeypatch, table: dict[str, str], spoil: Callable
) -> None:
    """Every room takes the reference with a warning by default, and refuses Triton by name."""
    spoil(monkeypatch)
    with warns(ScoupWarning):
        name, module = load_backend(table, GPU)
    assert (name, module.__name__) == ("reference", table["reference"])
    with refuses():
        load_backend(table, GPU, "triton")


def test_gpus_that_run_the_kernels(a_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_backend(GPU) == "triton"
    monkeypatch.setattr(torch.version, "hip", "6.4")  # AMD's capabilities count otherwise
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (0, 0))
    assert default_backend(GPU) == "triton"


@of_every_room
def test_names_and_devices(table: dict[str, str]) -> None:
    assert set(table) == {"native", "reference", "triton"}
    for device, name, kind in (
        (CPU, "cuda", UnknownNameError), (CPU, "triton", InputError), (GPU, "native", InputError),
    ):  # fmt: skip
        with refuses(kind):
            load_backend(table, device, name, "coder")
    assert load_backend(table, torch.device("meta"))[0] == "reference"


@of_every_room
def test_without_the_core(monkeypatch: pytest.MonkeyPatch, table: dict[str, str]) -> None:
    monkeypatch.setattr(backends, "native_core", object)
    assert default_backend(CPU) == "native"
    warn = Mock()
    monkeypatch.setattr(backends, "native_core", lambda: None)
    monkeypatch.setattr(backends, "missing_reason", lambda: "it was not built; install a compiler")
    monkeypatch.setattr(backends, "warn_if_missing", warn)
    assert load_backend(table, CPU)[0] == "reference"
    warn.assert_called_once_with()
    with refuses():
        load_backend(table, CPU, "native")


def test_interpreted_kernels_take_tensors_on_a_cpu(a_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRITON_INTERPRET", "1")
    require_backend("triton", CPU)
    without_triton(monkeypatch)
    with refuses():
        require_backend("triton", CPU)
