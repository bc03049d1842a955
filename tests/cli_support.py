"""A small scene on disk for tests of the command line."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import torch

from children import child
from io_samples import save_langsplat
from scoup.cli import main
from scoup.io import save_gaussians, save_png
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.raster import render_colors
from scoup_lab.data.colmap_model import write_colmap
from support import small_scene, unit

WORDS = ("kettle", "mug", "wooden table")
QUICK = ("--n-atoms", "8")
"""Options that make a build quick."""
FREE = ("--segmenter", "felzenszwalb", "--embedder", "colors")
"""Options of an extraction without models."""
BUILD = ("build", "scene", *QUICK, "--out", "a.scoup")
RUN = "from scoup.cli.app import entry; entry()"
"""The command line as a program."""


def write_scene(folder: Path, count: int = 150, seed: int = 0, views: int = 4) -> Path:
    """point_cloud.ply, renders of it as images, sparse/0, language_features and words.npz of a random scene."""
    gaussians, cameras, regions = small_scene(count, views, seed=seed)
    save_gaussians(gaussians, folder / "point_cloud.ply")
    write_colmap(cameras, folder / "sparse" / "0")
    for camera in cameras:
        image = render_colors(gaussians, camera)
        save_png((image * 255).byte(), folder / "images" / camera.name, overwrite=True)
    save_langsplat(regions, folder / "language_features")
    names = [*WORDS, *CANONICAL_PHRASES]
    vectors = unit(torch.randn(len(names), 16, generator=torch.Generator().manual_seed(seed)))
    WordTable.save(folder / "words.npz", names, vectors.numpy())
    return folder


def plain_photographs(folder: Path | str = "scene/images", count: int = 4) -> None:
    """So many photographs of the views, of few regions, in place of those that are there."""
    for number in range(4):
        path = Path(folder) / f"view_0{number}.png"
        path.unlink(missing_ok=True)
        if number < count:
            pixels = torch.zeros(30, 40, 3, dtype=torch.uint8)
            pixels[:15, : 10 + 5 * number] = torch.tensor([200, 30, 30], dtype=torch.uint8)
            pixels[15:, 20:] = torch.tensor([30, 200, 60], dtype=torch.uint8)
            save_png(pixels, path)


def add_words(table: Path | str = "scene/words.npz", path: Path | str = "many.npz", seed: int = 5) -> str:
    """Write a word table with 30 more words, random as the others, so that presence is judged; its path."""
    known = WordTable.load(Path(table))
    more = unit(torch.randn(30, known.vectors.shape[1], generator=torch.Generator().manual_seed(seed)))
    names = [*known.names, *(f"word {number}" for number in range(len(more)))]
    WordTable.save(Path(path), names, np.concatenate([known.vectors, more.numpy()]))
    return str(path)


def run(*arguments: object) -> tuple[int, str, str]:
    """Run the command line in this process: exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(item) for item in arguments])
        except SystemExit as stop:  # the parser's own refusals
            code = stop.code if isinstance(stop.code, int) else 1
    return code, out.getvalue(), err.getvalue()


def printed(*arguments: object) -> str:
    """Run, expect success without a warning; standard output."""
    code, out, err = run(*arguments)
    assert (code, err) == (0, "")
    return out


def warned(*arguments: object) -> str:
    """Run, expect success; standard error."""
    code, _, err = run(*arguments)
    assert code == 0, err
    return err


def together(*commands: Sequence[object]) -> list[CompletedProcess[str]]:
    """Verbs in processes that run at the same time, and how each ended."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with ExitStack() as stack:
        started = [
            stack.enter_context(child([sys.executable, "-c", RUN, *command], env=environment))
            for command in commands
        ]
        ended = [(process, process.communicate()) for process in started]
    return [CompletedProcess([], one.returncode, *streams) for one, streams in ended]


def run_json(*arguments: object) -> dict[str, Any]:
    """Run with --json, expect success, and parse what was printed."""
    code, out, err = run(*arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def snapshot(folder: Path) -> dict[str, bytes]:
    """Contents of every file below a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def written(folder: Path) -> dict[str, tuple[int, int]]:
    """When every file below a folder was written, and its size."""
    found = {}
    for parent, _, names in os.walk(folder):
        for name in names:
            about = os.lstat(path := os.path.join(parent, name))
            found[path] = about.st_mtime_ns, about.st_size
    return found


def refused(*arguments: object, folder: Path | None = None) -> str:
    """Run with --json what must be refused; the one sentence said.

    Checks that it is one line on standard error, the same in the JSON object, exit code 2, and that no file below
    ``folder`` (the current one) changed, appeared or went. For people, the line is the same (test_console.py).
    """
    folder = folder or Path.cwd()
    before = written(folder)
    code, out, err = run(*arguments, "--json")
    assert code == 2, (code, out, err)
    message = json.loads(out)["error"]
    assert json.loads(out) == {"error": message}
    assert err == f"error: {message}\n"
    assert "\n" not in message
    assert written(folder) == before
    return message
