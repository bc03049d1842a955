"""Which backend serves: one guard and one loader for the rasteriser and the vote."""

from __future__ import annotations

import builtins
import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace

import pytest
import torch

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
    monkeypatch.setattr(sys.modules["triton"], "__version__", "3.6.0", raising=False)
    monkeypatch.setattr(torch.version, "hip", None)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (8, 6))
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)


def without_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = builtins.__import__

    def refuse(name: str, *rest: object, **more: object) -> ModuleType:
        if name.split(".")[0] == "triton":
            raise ImportError("no triton")
        return plain(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.delitem(sys.modules, "triton")
    monkeypatch.setattr(builtins, "__import__", refuse)


def with_old_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["triton"], "__version__", "3.2.0")


def with_old_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (7, 5))


PROBLEMS = {
    "triton is not installed": without_triton,
    r"triton 3\.2\.0 is too old": with_old_triton,
    r"cuda:1 has compute capability 7\.5": with_old_gpu,
}


@of_every_room
@pytest.mark.parametrize("message", PROBLEMS)
def test_what_cannot_run_the_kernels(
    a_gpu: None, monkeypatch: pytest.MonkeyPatch, table: dict[str, str], message: str
) -> None:
    """Every room takes the reference with a warning by default, and refuses Triton by name."""
    PROBLEMS[message](monkeypatch)
    with pytest.warns(ScoupWarning, match=f"slow reference path: {message}"):
        name, module = load_backend(table, GPU)
    assert (name, module.__name__) == ("reference", table["reference"])
    with pytest.raises(InputError, match=f"'triton' cannot be used: {message}"):
        load_backend(table, GPU, "triton")


def test_gpus_that_run_the_kernels(a_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_backend(GPU) == "triton"
    monkeypatch.setattr(sys.modules["triton"], "__version__", "3.10.0+git1")
    assert default_backend(GPU) == "triton"
    monkeypatch.setattr(torch.version, "hip", "6.4")  # AMD's capabilities count otherwise
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (0, 0))
    assert default_backend(GPU) == "triton"


@of_every_room
def test_names_and_devices(table: dict[str, str]) -> None:
    assert set(table) == {"native", "reference", "triton"}
    with pytest.raises(UnknownNameError, match="no coder backend named 'cuda'"):
        load_backend(table, CPU, "cuda", "coder")
    with pytest.raises(InputError, match="'triton' serves tensors on a GPU, these are on cpu"):
        load_backend(table, CPU, "triton")
    with pytest.raises(InputError, match="'native' serves tensors on a CPU, these are on cuda:1"):
        load_backend(table, GPU, "native")
    assert load_backend(table, torch.device("meta"))[0] == "reference"


@of_every_room
def test_without_the_core(monkeypatch: pytest.MonkeyPatch, table: dict[str, str]) -> None:
    given: list[str] = []
    monkeypatch.setattr(backends, "native_core", lambda: None)
    monkeypatch.setattr(backends, "missing_reason", lambda: "it was not built; install a compiler")
    monkeypatch.setattr(backends, "warn_if_missing", lambda: given.append("warned"))
    assert load_backend(table, CPU)[0] == "reference"
    assert given == ["warned"]
    with pytest.raises(InputError, match=r"'native' cannot be used: .*install a compiler"):
        load_backend(table, CPU, "native")


def test_with_the_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "native_core", SimpleNamespace)
    assert default_backend(CPU) == "native"


def test_interpreted_kernels_take_tensors_on_a_cpu(a_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRITON_INTERPRET", "1")
    require_backend("triton", CPU)
    with_old_triton(monkeypatch)
    with pytest.raises(InputError, match="too old"):
        require_backend("triton", CPU)
