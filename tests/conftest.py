"""Fixtures and settings shared by all tests."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from subprocess import DEVNULL

import pytest
from hypothesis import HealthCheck, settings

import messages
from children import child
from scoup.base import locked, native
from support import examples

# Times vary with the load of the machine: a slow example is no failure.
settings.register_profile(
    "scoup", max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("scoup")

if native.missing_reason() is not None:
    # Tests turn warnings into errors; that the core is missing is said by the tests that skip for it.
    os.environ["SCOUP_NATIVE"] = "off"
    native.load_core.cache_clear()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-messages", action="store_true", help="write tests/messages.json again; without -n"
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.option.write_messages:
        os.environ["SCOUP_WRITE_MESSAGES"] = "1"


def pytest_sessionfinish(session: pytest.Session) -> None:
    options = session.config.option
    if options.write_messages and not session.testsfailed:
        whole_files = not options.keyword and not any("::" in argument for argument in session.config.args)
        messages.write({item.nodeid for item in session.items}, whole_files)


@pytest.fixture(scope="session", autouse=True)
def _no_wait_for_the_disk() -> Iterator[None]:
    """Files are not flushed: half of the time of tests that write many. Processes that tests start do flush."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Vectors of everyday words are kept in a folder of the tests, also by processes that they start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SCOUP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_light() -> Iterator[None]:
    """Demo scenes are lit from one direction of the sun and one of the sky: on small scenes, light takes most of the
    time."""
    from scoup_lab.synthetic.splat import make_splat

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scoup_lab.synthetic.scene.make_splat", functools.partial(make_splat, n_directions=1))
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real data: $SCOUP_TEST_DATA, or ``shared/data`` beside the repository. Mark such tests ``data``."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SCOUP_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder} (set SCOUP_TEST_DATA)")
    return folder


@pytest.fixture(scope="session")
def mobile_sam() -> Path:
    """MobileSAM's real checkpoint in $SCOUP_TEST_WEIGHTS, or in ``shared/weights`` beside the repository."""
    default = Path(__file__).resolve().parents[2] / "shared" / "weights"
    folder = Path(os.environ.get("SCOUP_TEST_WEIGHTS", default))
    path = folder / "mobile_sam.pt"
    if not path.is_file():
        pytest.skip(f"no real weights at {path} (set SCOUP_TEST_WEIGHTS)")
    return path


@pytest.fixture(params=["baseline", "v3", "v4"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[str]:
    """The compiled core uses it, wherever the CPU and SCOUP_NATIVE let it."""
    core, asked = native.native_core(), os.environ.get("SCOUP_NATIVE", "")
    assert core is not None
    if asked not in ("", request.param):
        pytest.skip(f"SCOUP_NATIVE asks for {asked}")
    if not core.use_isa(request.param):
        pytest.skip(f"this CPU does not run {request.param}")
    yield request.param
    core.use_isa(asked or "best")


@pytest.fixture(scope="session")
def needs_triton() -> None:
    """Tests that compile or interpret kernels are skipped where triton is not installed."""
    if importlib.util.find_spec("triton") is None:
        pytest.skip("triton is not installed")


@pytest.fixture(scope="session")
def triton_interpreter(needs_triton: None) -> Iterator[ProcessPoolExecutor]:
    """A process that interprets all Triton kernels on the CPU."""
    from interpreting import interpreter

    with interpreter() as worker:
        yield worker


@pytest.fixture(scope="session")
def interpreted(triton_interpreter: ProcessPoolExecutor) -> Callable[..., None]:
    """Runs a check of kernels, which takes a device last, with interpreted ones."""
    return lambda check, *arguments: triton_interpreter.submit(check, *arguments, "cpu").result()


@pytest.fixture
def few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras of a splat alone are chosen among few."""
    fewer = {"AZIMUTHS": 4, "PLACES": 2, "PARTS": 2, "DISTANCES": (0.65, 1.0), "PARENTS": 4}
    for name, few in fewer.items():
        monkeypatch.setattr(f"scoup.extract.constants.{name}", few)


@pytest.fixture(scope="session")
def preloaded_python() -> Iterator[str]:
    """A program like ``sys.executable`` that has imported torch already (tests/preloaded.py); elsewhere than on Linux,
    ``sys.executable``."""
    if not sys.platform.startswith("linux"):
        yield sys.executable
        return
    tests = Path(__file__).parent
    with tempfile.TemporaryDirectory(prefix="scoup-") as folder:
        program, address = Path(folder) / "python", Path(folder) / "socket"
        client = [sys.executable, "-S", "-E", tests / "preloaded_client.py", address, sys.executable]
        program.write_text(f'#!/bin/sh\nexec {shlex.join(map(str, client))} "$@"\n')
        program.chmod(0o755)
        server = [sys.executable, tests / "preloaded.py", address, program]
        with child(server, stdin=DEVNULL, stderr=None) as process:
            assert process.stdout.readline() == "ready\n"
            yield str(program)


@pytest.fixture(scope="module")
def quick_python(preloaded_python: str) -> Iterator[None]:
    """Processes that this one starts by ``sys.executable`` begin at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "executable", preloaded_python)
        yield


@pytest.fixture(scope="session")
def synthetic_data_sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small synthetic version of each data set, named after it; read-only."""
    from benchmarks.scenes import LAYOUTS

    from scoup_lab.synthetic import make_demo_scene
    from scoup_lab.synthetic.data_sets import DataSetSize, write_data_set

    layouts = [LAYOUTS["table"], LAYOUTS["shelves"]]
    size = DataSetSize(n_gaussians=4000, width=96, height=72, n_views=6, n_labelled=2)
    place = tmp_path_factory.getbasetemp()
    folder = (place.parent if "PYTEST_XDIST_WORKER" in os.environ else place) / "data_sets"
    with locked(folder, wait=True), pytest.MonkeyPatch.context() as patch:
        if not folder.exists():  # the first process that needs them makes them for all
            # The same scenes are written for each of them.
            patch.setattr("scoup_lab.synthetic.data_sets.make_demo_scene", functools.cache(make_demo_scene))
            half = dataclasses.replace(size, label_scale=0.5)
            made = folder.with_name("unfinished")
            for name in ("lerf-ovs", "3d-ovs", "scannet", "mipnerf360"):
                write_data_set(name, made / name, layouts, half if name == "mipnerf360" else size)
            made.rename(folder)
    return folder
