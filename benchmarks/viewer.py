"""What the viewer costs: bytes sent for a scene and for a query, start of the server, loading in a browser.

    python -m benchmarks.viewer [--n-gaussians 1000000] [--browser-gaussians 1000000 20000] [--out FILE.json]

The random scene with made-up codes and an everyday vocabulary with made-up vectors: bytes and times mean something,
answers do not. Seconds are those of this machine, of one run. With Chromium and playwright a page of each of the sizes
of --browser-gaussians is loaded: until it has unpacked its Gaussians and, of the smallest, until a query is drawn. The
renderer that the browser uses is recorded: SwiftShader draws on the processor, and says nothing about a GPU.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import IO, Any

import tyro
from tools.chromium import chromium

import scoup
from scoup.field.language_field import LanguageField
from scoup.io import check_output
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.scene.field_info import FieldInfo
from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField
from scoup.view.viewer import Viewer
from scoup_lab.bench import (
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measuring import timed
from scoup_lab.synthetic.random_scene import clip_like, random_scene_codes

ATOMS, KEEP, VIEWS = 128, 4, 24
RECOLOURING_BYTES = 32
"""A Gaussian, that viser 1.1.1 sends to every client for each new colouring of a splat (measured before this project's
viewer was made)."""
PROGRAM = (sys.executable, "-c", "from scoup.cli.app import entry; entry()")
START_REPEATS = 3
WINDOW = {"width": 640, "height": 480}


@dataclass(frozen=True)
class Arguments:
    n_gaussians: int = 1_000_000
    """Of the scene that is served and exported."""
    browser_gaussians: tuple[int, ...] = (1_000_000, 20_000)
    """Of the pages that a browser loads; none leaves the browser out."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the scenes, measure, print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    with tempfile.TemporaryDirectory() as folder:
        path = write_field(Path(folder), arguments.n_gaussians)
        start = start_seconds(path)
        sent = sent_bytes(path)
        pages = [
            page_seconds(write_field(Path(folder), count), drawn=count == min(arguments.browser_gaussians))
            for count in arguments.browser_gaussians
        ]
    record = {
        "what": "benchmarks.viewer: what the viewer costs",
        "environment": environment,
        "settings": {"gaussians": arguments.n_gaussians, "atoms": ATOMS, "keep": KEEP, "views": VIEWS},
        "start": start,
        "sent": sent,
        "pages": pages,
    }
    print(in_one_line(environment))
    print(report(record))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def report(record: dict[str, Any]) -> str:
    """The figures as tables."""
    return "\n\n".join([sent_table(record), pages_table(record)])


def sent_table(record: dict[str, Any]) -> str:
    """Bytes of a scene of so many Gaussians, and the start of the server."""
    facts = {**record["sent"], **record["start"]}
    return markdown(
        [f"{record['settings']['gaussians']:,} Gaussians", ""],
        [
            [what, f"{value:,.2f}" if isinstance(value, float) else f"{value:,}"]
            for what, value in facts.items()
        ],
    )


def pages_table(record: dict[str, Any]) -> str:
    """Seconds in a browser, beside the Gaussians of each page."""
    heads = ["", *(f"{page['gaussians']:,} Gaussians" for page in record["pages"])]
    return markdown(
        heads,
        [
            [stage, *("" if stage not in page else f"{page[stage]:.2f} s" for page in record["pages"])]
            for stage in PAGE_STAGES
        ],
    )


PAGE_STAGES = ("loaded and unpacked", "first picture", "query until drawn", "threshold until drawn")


def write_field(folder: Path, count: int) -> Path:
    """A field of the random scene, its Gaussians embedded, and its word table beside it."""
    path = folder / f"scene_{count}.scoup"
    if path.exists():
        return path
    gaussians = random_scene_gaussians(count)
    indices, weights = random_scene_codes(gaussians.means, 3, ATOMS, KEEP)
    codebook = clip_like(3 * ATOMS).view(3, ATOMS, -1)
    info = FieldInfo(("s", "m", "l"), "words.npz", gaussians.fingerprint(), len(gaussians))
    cameras = random_scene_cameras(VIEWS, 320, 240)
    words = list(dict.fromkeys([*CANONICAL_PHRASES, *EVERYDAY_WORDS]))
    save_table(folder / "words.npz", words, clip_like(len(words), seed=3), model="simulated", overwrite=True)
    LanguageField(indices, weights, codebook, info, gaussians, cameras=cameras).save(path)
    return path


def start_seconds(path: Path) -> dict[str, float]:
    """From the command to the first answer of its server, beside `scoup info` on the same field: medians of repetitions
    that take turns."""
    seconds: dict[str, list[float]] = {"info": [], "view": []}
    for _ in range(START_REPEATS):
        start = time.perf_counter()
        subprocess.run([*PROGRAM, "info", str(path)], check=True, stdout=subprocess.DEVNULL)
        seconds["info"].append(time.perf_counter() - start)
        seconds["view"].append(_answer_seconds(path))
    info, view = median(seconds["info"]), median(seconds["view"])
    return {
        "scoup info, s": info,
        "scoup view until it answers, s": view,
        "scoup view / scoup info": view / info,
    }


def _answer_seconds(path: Path) -> float:
    start = time.perf_counter()
    with served(path) as (address, _):
        with urllib.request.urlopen(address) as answer:
            answer.read()
        return time.perf_counter() - start


@contextmanager
def served(
    path: Path, program: Sequence[str] = PROGRAM, log: IO[str] | int = subprocess.DEVNULL
) -> Iterator[tuple[str, int]]:
    """`scoup view` on a field in a process of its own, once it answers: its address, and the number of the process.

    Args:
        path: of the field.
        program: that is `scoup`.
        log: gets its standard error.
    """
    command = [*program, "view", str(path), "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as process:
        assert process.stdout is not None
        printed = ""
        while not printed.endswith("}\n"):
            line = process.stdout.readline()
            if not line:
                raise SystemExit("scoup view ended")
            printed += line
        try:
            yield json.loads(printed)["address"], process.pid
        finally:
            process.terminate()


def sent_bytes(path: Path) -> dict[str, float]:
    """Bytes of what goes to a browser, and of the page without a server."""
    viewed = ViewedField(scoup.LanguageField.load(path))
    count = len(viewed.field)
    request = {"texts": ["kettle"], "always": False}
    with Viewer(viewed, port=0) as viewer:
        sizes = {name: _size(viewer.address + name) for name in ("scene.bin", "viewer.js")}
        answer = _size(viewer.address + "api/query", request)
    query = len(json.dumps(request)) + answer
    recolouring = RECOLOURING_BYTES * min(count, viewed.most)
    report = export_page(viewed, path.with_suffix(".html"))
    return {
        "program, bytes": sizes["viewer.js"],
        "scene, bytes": sizes["scene.bin"],
        "scene, bytes a Gaussian": sizes["scene.bin"] / count,
        "query, bytes both ways": query,
        "moving a slider, bytes": 0,
        "colours of all Gaussians instead, bytes": recolouring,
        "colours / query": recolouring / query,
        "exported page, bytes": report.n_bytes,
        "exported page, bytes a Gaussian": report.n_bytes / count,
        "exported words": report.words,
        "exported words, bytes": report.words_bytes,
    }


def _size(address: str, message: dict[str, Any] | None = None) -> int:
    body = None if message is None else json.dumps(message).encode()
    request = urllib.request.Request(address, body, {"accept-encoding": "gzip"})
    with urllib.request.urlopen(request) as answer:
        return len(answer.read())


def page_seconds(path: Path, drawn: bool) -> dict[str, Any]:
    """Seconds until a page is loaded and unpacked and, if that is wanted, until pictures are drawn."""
    viewed = ViewedField(scoup.LanguageField.load(path))
    viewed.scene()  # the first visitor waits for it; here the browser is measured
    seconds: dict[str, float] = {}
    with Viewer(viewed, port=0) as viewer, chromium() as browser:
        page = browser.new_page(viewport=WINDOW)  # pyright: ignore[reportArgumentType]
        page.set_default_timeout(600_000)
        with timed(seconds, PAGE_STAGES[0]):
            page.goto(viewer.address)
            page.evaluate("scoupViewer.ready")
        if drawn:
            with timed(seconds, PAGE_STAGES[1]):
                page.evaluate("scoupViewer.render()")
            with timed(seconds, PAGE_STAGES[2]):
                page.evaluate("scoupViewer.ask(['kettle']).then(() => scoupViewer.render())")
            with timed(seconds, PAGE_STAGES[3]):
                page.evaluate("scoupViewer.set({threshold: 0.3}); scoupViewer.render()")
        renderer = page.evaluate(_RENDERER)
    return {"gaussians": len(viewed.field), "window": WINDOW, "renderer": renderer, **seconds}


_RENDERER = """() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : gl.getParameter(gl.RENDERER);
}"""


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
