"""A stream of frames: what an update and an answer take, by how many views the field keeps, and whether memory grows.

    python -m benchmarks.stream [--frames 300] [--windows 10 20 40] [--rounds 1 2] [--threads 1] [--out FILE.json]

On the random scene. For each window (views that are kept) and number of rounds a field is built from the first views;
then frames arrive one by one, each update adds the newest and removes the oldest, and the field is asked for a place.
With --in-file the region sums are in a file. Resident memory: the slope of a line through its second half, in bytes a
frame. "Buckets" is the share of buckets of 256 Gaussians in which the frame added or the one removed has an entry: only
these would have to vote again in a single round; from the second round on the sharpness, a median over the views,
changes what all Gaussians vote.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
import tyro

import scoup
from scoup.io import check_output
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_sums import RegionSums
from scoup_lab.bench import (
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    random_scene_regions,
    torch_threads,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measuring import resident_bytes
from scoup_lab.synthetic.random_scene import REGIONS

PLACES = 60  # different cameras, which come round again and again
TEXTS = ("thing", "object", "things", "stuff", "texture")


@dataclass(frozen=True)
class Arguments:
    frames: int = 300
    """That arrive after the field was built."""
    windows: tuple[int, ...] = (10, 20, 40)
    """Numbers of views that are kept."""
    rounds: tuple[int, ...] = (1, 2)
    """Rounds of the vote."""
    n_gaussians: int = 100_000
    """Of the scene."""
    width: int = 640
    """Of a frame, in pixels."""
    height: int = 480
    """Of a frame, in pixels."""
    regions: tuple[int, ...] = REGIONS
    """Regions in a frame, at levels s, m, l."""
    in_file: bool = False
    """Keep the region sums in a file."""
    threads: int = 1
    """Threads."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


@dataclass(frozen=True, eq=False)
class Source:
    """What frames are made of: a scene whose views come round again and again."""

    gaussians: Gaussians
    cameras: Cameras
    regions: Regions

    def frame(self, number: int) -> tuple[Camera, dict[str, RegionMap]]:
        """A camera of a name of its own, and its regions."""
        camera = self.cameras[number % len(self.cameras)]
        maps = {level: self.regions.load(camera.name, level) for level in self.regions.levels}
        return dataclasses.replace(camera, name=_name(number)), maps


class VoteClock:
    """A progress callback that keeps how long the vote took."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._started = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage == "vote" and done == 0:
            self._started = time.perf_counter()
        if stage == "vote" and done == total:
            self.seconds = time.perf_counter() - self._started


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    print(in_one_line(environment))
    settings = {name: value for name, value in vars(arguments).items() if name not in ("out", "overwrite")}
    record: dict[str, Any] = {
        "what": "benchmarks.stream", "machine": environment, "settings": settings, "rows": []
    }  # fmt: skip
    cameras = random_scene_cameras(PLACES, arguments.width, arguments.height)
    source = Source(
        random_scene_gaussians(arguments.n_gaussians),
        cameras,
        random_scene_regions(cameras, arguments.regions),
    )
    with torch_threads(arguments.threads):
        for rounds in arguments.rounds:
            for window in arguments.windows:
                record["rows"].append(_measured(source, window, rounds, arguments))
    print(table(record["rows"]))
    record = {**record, "settings": {name: _plain(value) for name, value in settings.items()}}
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def _measured(source: Source, window: int, rounds: int, arguments: Arguments) -> dict[str, Any]:
    """The figures of one stream."""
    found: dict[str, list[float]] = {
        name: [] for name in ("update_s", "vote_s", "answer_s", "buckets", "memory", "sums")
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream.sums" if arguments.in_file else None
        for of_frame in _streamed(source, window, rounds, arguments.frames, path):
            for name, value in of_frame.items():
                found[name].append(value)
    half = found["memory"][len(found["memory"]) // 2 :]
    row: dict[str, Any] = {"rounds": rounds, "window": window, "frames": arguments.frames}
    for name in ("update_s", "vote_s", "answer_s"):
        row |= {name: median(found[name]), f"worst_{name}": max(found[name])}
    return {
        **row,
        "buckets": float(np.mean(found["buckets"])),
        "memory_first": found["memory"][0],
        "memory_last": found["memory"][-1],
        "memory_slope": float(np.polyfit(np.arange(len(half)), half, 1)[0]) if len(half) > 1 else 0.0,
        "largest_sums": max(found["sums"]),
    }


def _streamed(
    source: Source, window: int, rounds: int, frames: int, path: Path | None
) -> Iterator[dict[str, float]]:
    """Frame by frame what it took."""
    first = dict(source.frame(number) for number in range(window))
    regions = Regions.from_maps({camera.name: maps for camera, maps in first.items()})
    sums = RegionSums.of(source.gaussians, regions.levels, path=path)
    field = build(
        source.gaussians, Cameras(first), regions, BuildSettings(rounds=rounds), sums=sums, check_fit=False
    )
    vectors = torch.randn(len(TEXTS), field.dim, generator=torch.Generator().manual_seed(0))
    field.text_encoder(dict(zip(TEXTS, vectors, strict=True)))
    for number in range(window, window + frames):
        camera, maps = source.frame(number)
        oldest, clock = _name(number - window), VoteClock()
        touched = _touched(sums, oldest)
        started = time.perf_counter()
        field = scoup.update(
            field, sums, [camera], Regions.from_maps({camera.name: maps}), [oldest],
            check_fit=False, progress=clock,
        )  # fmt: skip
        updated = time.perf_counter()
        field.locate(TEXTS[0], always=True)
        answered = time.perf_counter()
        yield {
            "update_s": updated - started,
            "vote_s": clock.seconds,
            "answer_s": answered - updated,
            "buckets": float((touched | _touched(sums, camera.name)).mean()),
            "memory": float(resident_bytes() or 0),
            "sums": float(sums.bytes),
        }


def _touched(sums: RegionSums, view_name: str) -> np.ndarray:
    """Boolean [B]: buckets with entries of a view."""
    found = np.zeros(sums.n_buckets, bool)
    for part in sums.views[view_name].parts:
        found[part.buckets] = True
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Latencies and memory, a line a stream."""
    lines = [
        [
            str(row["rounds"]),
            str(row["window"]),
            f"{_ms(row['update_s'])} / {_ms(row['worst_update_s'])}",
            f"{_ms(row['vote_s'])} / {_ms(row['worst_vote_s'])}",
            f"{_ms(row['answer_s'])} / {_ms(row['worst_answer_s'])}",
            f"{row['buckets']:.0%}",
            f"{row['memory_first'] / 1e6:.0f} to {row['memory_last'] / 1e6:.0f}",
            f"{row['memory_slope'] / 1e3:.1f}",
            f"{row['largest_sums'] / 1e6:.0f}",
        ]
        for row in rows
    ]
    heads = [
        "rounds", "views kept", "update, median / worst ms", "of it the vote", "answer", "buckets",
        "resident MB", "kB a frame", "sums at most, MB",
    ]  # fmt: skip
    return markdown(heads, lines)


def _name(number: int) -> str:
    return f"frame_{number:06d}"


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.0f}"


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


if __name__ == "__main__":
    torch.manual_seed(0)
    main(tyro.cli(Arguments, description=__doc__))
