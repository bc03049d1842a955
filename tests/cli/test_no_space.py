"""A full disk: every verb that writes says so in one sentence with the path, and leaves nothing half-written.

The disk is full where a file may grow no further (RLIMIT_FSIZE): the system then refuses the write, as on a full disk.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import scoup.io as scoup_io
import scoup.raster
from children import finished
from cli_support import QUICK, RUN, plain_photographs, run, run_json, snapshot
from scoup.base import WriteError, atomic_file, staged
from scoup.io import load_gaussians, save_gaussians
from scoup.models import WordTable
from scoup.scene import Cameras, Gaussians, Regions
from scoup.uplift import BuildSettings, build
from scoup_lab.data.colmap_model import write_colmap
from support import small_scene

resource = pytest.importorskip("resource")

SIZE = "--n-gaussians 2000 --width 48 --height 36 --views 2"
VERBS = {name: tuple(command.split()) for name, command in {
    "build": "build scene --n-atoms 8 --out new/a.scoup",
    "build from sums": "build scene --n-atoms 8 --out a.scoup --sums kept.sums",
    "build, part": "build scene --keep-sums a.sums --part 1/2",
    "build, more views": "build scene --n-atoms 8 --out a.scoup --keep-sums few.sums --codebook f.scoup",
    "transfer": "transfer f.scoup edited.ply --out a.scoup",
    "views": "views scene/point_cloud.ply --views 2 --width 24 --height 18 --out own",
    "extract": "extract scene --segmenter felzenszwalb --embedder colors --out regions",
    "convert": "convert scene compact",
    "query": "query f.scoup kettle --out answers --camera all",
    "select": "select f.scoup kettle --always --out a.ply",
    "render": "render f.scoup --out pictures --camera all",
    "animation": "render f.scoup --out a.gif --camera all",
    "regions": "extract scene --show view_00",
    "archive": "archive scans --add f.scoup",
    "demo": f"demo {SIZE} --out demo",
    "synthetic": f"eval synthetic lerf-ovs data {SIZE} --scenes 1 --labelled 1",
}.items()}  # fmt: skip
# Of these, what is complete stays for the same command to continue.
RESUMED = (".safetensors", ".regions", "_s.npy", "_f.npy", "regions.json", "archive.json", ".f16")


@pytest.fixture(scope="session")
def original(original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, with a field whose region sums are kept, and what else the verbs begin with."""
    original = Path(shutil.copytree(original, tmp_path_factory.mktemp("no_space") / "cli"))
    scene = original / "scene"
    build = ("build", scene, *QUICK, "--model", scene / "words.npz")
    run_json(*build, "--out", original / "kept.scoup", "--keep-sums", original / "kept.sums")
    shutil.copytree(original / "kept.sums", original / "few.sums")
    for number in (1, 2, 3):
        next((original / "few.sums").glob(f"view.view_0{number}*")).unlink()
    save_gaussians(load_gaussians(scene / "point_cloud.ply").select(slice(5, None)), original / "edited.ply")
    return original


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file grows beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def entries(folder: Path) -> set[str]:
    """Everything below a folder, folders too."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def check_refused(arguments: tuple[str, ...], size: int, outputs: set[str]) -> None:
    """The verb ends with 2, says one sentence that names an output, and changes and leaves nothing."""
    here = Path.cwd()
    before, contents = entries(here), snapshot(here)
    with largest_file(size):
        code, _, err = run(*arguments)
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert (code, len(lines)) == (2, 1), (size, err)
    path, _, rest = lines[0].removeprefix("error: ").partition(": cannot be written (")
    assert rest.startswith("File too large)"), lines[0]
    places = outputs | {str(parent) for name in outputs for parent in Path(name).parents} - {"."}
    assert path in places or ".partial" in path, lines[0]
    new = {name for name in entries(here) - before if Path(name).is_file() or not Path(name).exists()}
    assert all(name.endswith(RESUMED) for name in new), new
    assert not any(".lock" in name or "/." in f"/{name}" for name in entries(here) - before)
    assert {name: content for name, content in snapshot(here).items() if name in contents} == contents


@pytest.fixture
def scene(here: Path) -> Path:
    """The current folder, whose scene has two photographs that show something."""
    plain_photographs(count=2)
    return here


def remove(names: set[str]) -> None:
    """Remove files, and the folders that are empty without them."""
    for name in names:
        Path(name).unlink()
    for folder in sorted({parent for name in names for parent in Path(name).parents}, reverse=True):
        if folder.name and not any(folder.iterdir()):
            folder.rmdir()


ALL = [pytest.param(verb, marks=pytest.mark.slow if verb in ("demo", "synthetic") else ()) for verb in VERBS]


@pytest.mark.parametrize("verb", ALL)
def test_every_verb_that_writes(scene: Path, verb: str) -> None:
    before = set(snapshot(scene))
    run_json(*VERBS[verb])
    contents = {name: content for name, content in snapshot(scene).items() if name not in before}
    made = {name: len(content) for name, content in contents.items()}
    # First with everything there already, then with nothing.
    if verb != "build, part":  # which leaves views that are there
        check_refused((*VERBS[verb], "--overwrite"), 0, set(made))
    remove(set(made))
    largest = max(made.values())
    # No byte; all but the last of the largest file, where it is always of one size.
    for size in (0, largest - 1):
        check_refused(VERBS[verb], size, set(made))
    if set(snapshot(scene)) != before:  # what was kept is good, whatever the disk had room for
        run_json(*VERBS[verb])
        assert {name: Path(name).read_bytes() for name in made} == contents


@pytest.mark.parametrize("verb", VERBS)
def test_folders_that_may_not_be_written_to(here: Path, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    access = os.access  # the tests may run as root, who may write everywhere
    monkeypatch.setattr(
        os, "access", lambda path, mode, **more: Path(path) != here and access(path, mode, **more)
    )
    before = snapshot(here)
    code, _, err = run(*VERBS[verb])
    assert (code, len(err.splitlines())) == (2, 1), err
    assert f"cannot be written, {here} is read-only for you; choose another folder" in err
    assert snapshot(here) == before


@pytest.mark.usefixtures("here")
def test_an_input_that_vanishes_during_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    file, project = Path("scene/language_features/view_03_s.npy"), scoup.raster.project

    def projected(*scene: Any, **options: Any) -> Any:
        file.unlink(missing_ok=True)
        return project(*scene, **options)

    monkeypatch.setattr("scoup.raster.project", projected)
    code, _, err = run(*VERBS["build from sums"][:-2])
    assert (code, err[: len(f"error: {file}: ")], len(err.splitlines())) == (2, f"error: {file}: ", 1)
    assert not Path("a.scoup").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.usefixtures("here")
def test_standard_output_that_is_full() -> None:
    with open("/dev/full", "w") as full:
        done = finished([sys.executable, "-c", RUN, "info", "f.scoup"], stdout=full)
    assert done.returncode == 2
    assert done.stderr.startswith("error: standard output: cannot be written (No space left on device)")
    assert len(done.stderr.splitlines()) == 1


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (16, 16))
from scoup.cli.app import entry
entry()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.usefixtures("here")
def test_sixteen_open_files_are_enough(preloaded_python: str) -> None:
    done = finished([preloaded_python, "-c", LIMITED, "build", "scene", *QUICK, "--model", "scene/words.npz"])
    assert (done.returncode, done.stderr) == (0, "")


# ---- the library


Scene = tuple[Gaussians, Cameras, Regions]
WRITERS: dict[str, Callable[[Scene], object]] = {
    "colmap/cameras.bin": lambda scene: write_colmap(scene[1], "colmap"),
    "transforms.json": lambda scene: scoup_io.write_transforms(scene[1], "transforms.json"),
    "features/regions.json": lambda scene: scoup_io.save_regions(scene[2], "features"),
    "words.npz": lambda _: WordTable.save("words.npz", ["a", "b"], torch.eye(2)),
    f"temporary file in {tempfile.gettempdir()}": lambda scene: build(*scene, BuildSettings(check_fit=False)),
}
"""What writes files without a verb, by the first file it writes."""


@pytest.mark.parametrize("path", WRITERS)
def test_every_writer_of_the_library(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with largest_file(100), pytest.raises(WriteError) as caught:
        WRITERS[path](small_scene(count=40, views=2))
    assert str(caught.value).startswith(f"{path}: cannot be written (File too large); ")
    assert not list(tmp_path.iterdir())


def test_an_input_that_cannot_be_read_is_not_mistaken_for_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing") as caught, atomic_file(tmp_path / "out") as stream:
        stream.write((tmp_path / "missing").read_bytes())
    assert not isinstance(caught.value, WriteError)
    with pytest.raises(OSError, match="input") as caught, staged(tmp_path / "folder"):
        raise OSError(errno.EIO, "Input/output error", str(tmp_path / "input"))
    assert not isinstance(caught.value, WriteError)
    assert not list(tmp_path.iterdir())
