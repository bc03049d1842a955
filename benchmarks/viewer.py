"""The cost of the viewer: bytes sent, the start of server and page."""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import scoup
from benchmarks.chromium import chromium, program
from benchmarks.processes import SCOUP, memory_of
from benchmarks.random_field import random_field, write_words
from benchmarks.study import Record, Study
from scoup.scene import Cameras, Gaussians
from scoup.view import ViewedField, Viewer, export_page
from scoup_lab.bench import markdown, random_scene_cameras, random_scene_gaussians

VIEWS = 24
START_REPEATS = 3


@dataclass(frozen=True, kw_only=True)
class ViewerCost(Study):
    """Count the bytes that go to a browser, and time the start of `scoup view`.

    The random scene with made-up codes and an everyday vocabulary with made-up vectors: bytes and times mean something,
    answers do not. Seconds are those of this machine: medians of three starts or openings.
    """

    n_gaussians: int = 1_000_000
    """Of the scene that is served and exported."""
    n_large: int = 10_000_000
    """Of a scene that is only served, beside the other one."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        with tempfile.TemporaryDirectory() as folder:
            cameras = random_scene_cameras(VIEWS, 320, 240)
            path = write_field(Path(folder), random_scene_gaussians(self.n_gaussians), cameras)
            yield "sent", sent_bytes(path)
            yield "start", {"scoup view until it answers, s": start_seconds(path)}
            if program() is not None:
                yield "page", page_seconds(path)
            yield f"served/{self.n_gaussians}", serving_costs(path)
        if f"served/{self.n_large}" not in known:
            with tempfile.TemporaryDirectory() as folder:
                path = write_field(Path(folder), random_scene_gaussians(self.n_large), cameras)
                yield f"served/{self.n_large}", serving_costs(path)

    def record(self, rows: dict[str, Any]) -> Record:
        served = [row for name, row in rows.items() if name.startswith("served/")]
        named = {name: row for name, row in rows.items() if "/" not in name}
        return {**named, "served": served}

    @staticmethod
    def table(record: Record) -> str:
        found = {**record["sent"], **record["start"], **record.get("page", {})}
        body = [
            [what, f"{value:,.2f}" if isinstance(value, float) else f"{value:,}"]
            for what, value in found.items()
        ]
        sent = markdown([f"{record['settings']['n_gaussians']:,} Gaussians", ""], body)
        return "\n\n".join([sent, served_table(record)])


def served_table(record: Record) -> str:
    """Return what the server of a scene needs and sends, scene by scene."""
    body = [
        [
            f"{row['gaussians']:,}",
            f"{row['first file, bytes'] / 1e6:.1f}",
            f"{row['first file, CPU s']:.1f}",
            f"{row['parts']}",
            f"{row['parts, bytes'] / 1e6:.0f}",
            f"{row['parts, CPU s']:.1f}",
            f"{row['most memory, bytes'] / 1e9:.1f}",
        ]
        for row in record["served"]
    ]
    return markdown(
        [
            "Gaussians",
            "first file, MB",
            "first file, CPU s",
            "parts",
            "all parts, MB",
            "all parts, CPU s",
            "server, GB",
        ],
        body,
    )


def page_seconds(path: Path) -> dict[str, float]:
    """Return seconds from opening the address until something can be drawn, and until all Gaussians can be."""
    first, whole = [], []
    for _ in range(START_REPEATS):
        with served(path) as (address, _), chromium() as browser:
            page = browser.new_page(viewport={"width": 640, "height": 480})
            page.set_default_timeout(0)
            started = time.perf_counter()
            page.goto(address)
            page.evaluate("scoupViewer.ready")
            first.append(time.perf_counter() - started)
            page.evaluate("scoupViewer.whole")
            whole.append(time.perf_counter() - started)
    return {"first Gaussians loaded, s": median(first), "all Gaussians loaded, s": median(whole)}


def write_field(folder: Path, gaussians: Gaussians, cameras: Cameras) -> Path:
    """Write a field with made-up codes, its Gaussians embedded, and its word table beside it."""
    path = folder / "scene.scoup"
    random_field(gaussians, cameras=cameras, words=write_words(folder / "words.npz")).save(path)
    return path


def serving_costs(path: Path) -> dict[str, float]:
    """Return what a server needs to send all Gaussians of a scene: processor seconds from its start until the first
    file is sent, and for the parts; the bytes of these; and its most memory, with the file of the field.
    """
    count = scoup.LanguageField.load(path).info.n_gaussians
    with served(path, options=("--most", str(count))) as (address, process):
        with urllib.request.urlopen(address + "scene.bin") as answer:
            first = answer.read()
        seconds = _processor_seconds(process)
        header = gzip.decompress(first)
        metadata = json.loads(header[8 : 8 + int.from_bytes(header[:8], "little")])["__metadata__"]["scoup"]
        parts = len(json.loads(metadata)["parts"])
        sizes = [_size(f"{address}part/{number}-of-{parts}") for number in range(parts)]
        return {
            "gaussians": count,
            "first file, bytes": len(first),
            "first file, CPU s": seconds,
            "parts": parts,
            "parts, bytes": sum(sizes),
            "parts, CPU s": _processor_seconds(process) - seconds,
            "most memory, bytes": memory_of(process)["VmHWM"],
        }


def _processor_seconds(process: int) -> float:
    """Return the processor seconds that a process has had."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def start_seconds(path: Path) -> float:
    """Return seconds from the command to the first answer of its server."""
    seconds = []
    for _ in range(START_REPEATS):
        started = time.perf_counter()
        with served(path) as (address, _), urllib.request.urlopen(address) as answer:
            answer.read()
            seconds.append(time.perf_counter() - started)
    return median(seconds)


@contextmanager
def served(path: Path, options: Sequence[str] = ()) -> Iterator[tuple[str, int]]:
    """Run `scoup view` on a field in a process of its own; yields its address and its number once it answers."""
    command = [sys.executable, "-c", SCOUP, "view", str(path), "--port", "0", "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
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
    """Return the bytes of what goes to a browser, and of the page without a server."""
    viewed = ViewedField(scoup.LanguageField.load(path))
    count = len(viewed.field)
    request = {"texts": ["kettle"], "always": False}
    with Viewer(viewed, port=0) as viewer:
        parts = [f"part/{number}-of-{viewed.n_parts}" for number in range(viewed.n_parts)]
        scene = sum(_size(viewer.address + name) for name in ("scene.bin", *parts))
        answer = _size(viewer.address + "api/query", request)
    report = export_page(viewed, path.with_suffix(".html"))
    return {
        "scene, bytes a Gaussian": scene / count,
        "query, bytes both ways": len(json.dumps(request)) + answer,
        "exported page, bytes a Gaussian": report.bytes / count,
    }


def _size(address: str, message: dict[str, Any] | None = None) -> int:
    body = None if message is None else json.dumps(message).encode()
    request = urllib.request.Request(address, body, {"accept-encoding": "gzip"})
    with urllib.request.urlopen(request) as answer:
        return len(answer.read())
