"""What a query costs: with a new camera, a further one with the same camera, and `scoup query` as a whole.

    python -m benchmarks.query [--n-gaussians 1000000] [--n-atoms 128] [--k 4] [--threads 1] [--repeats 7]
        [--command-repeats 3] [--backend NAME] [--out FILE.json]

The random scene with made-up codes: times mean something, answers do not. All figures are processor seconds, so
that other programs on the machine disturb them less; the least of the repetitions is printed. `scoup query` reads the
room from a PLY file and its codes from a .scoup file, asks for one text of a table in one camera, and writes no
pictures: user and system time of the whole process, the start of Python and torch included.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from torch import Tensor

import scoup
from scoup.field.language_field import LanguageField
from scoup.io import check_output
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.query.segment import localize_and_segment
from scoup.scene.cameras import Camera
from scoup.scene.field_info import FieldInfo
from scoup_lab.bench import (
    describe_environment,
    markdown,
    random_scene_cameras,
    random_scene_gaussians,
    usable_backends,
    write_json,
)
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measure import Stopwatch, torch_threads
from scoup_lab.synthetic.random_scene import HEIGHT, WIDTH, clip_like, random_scene_codes

MANY = 20  # texts of one question
STAGES = {
    "project": "project, bin and sort",
    "first relevancy": "relevancy with a new projection",
    "further relevancy": "relevancy to another query with the same projection",
    "place and mask": "localize and segment",
    "query, new camera": "project, first relevancy, place and mask",
    "query, same camera": "further relevancy, place and mask",
    "quarter size": "project, first relevancy, place and mask at a quarter of the width and height",
    "location, first text": "where the first text is in the world; the field is loaded, nothing is kept yet",
    "location, further text": "another text",
    "location, same text": "the same text again",
    "location, text of many": f"one text of a question of {MANY}",
    "scoup query": "the command: read the splat and the field, one text, one camera, no pictures",
}
WORD = "kettle"


@dataclass(frozen=True)
class Arguments:
    n_gaussians: int = 1_000_000
    """Of the room."""
    n_atoms: int = 128
    """L."""
    k: int = 4
    """K."""
    width: int = WIDTH
    """Of the view, in pixels."""
    height: int = HEIGHT
    """Of the view, in pixels."""
    threads: int = 1
    """Threads, of the command too."""
    repeats: int = 7
    """Repetitions of each stage."""
    command_repeats: int = 3
    """Repetitions of the command; 0 leaves it out."""
    backend: str | None = None
    """Rasteriser of the stages; the fastest by default. The command takes the fastest."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the scene, measure, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    if arguments.backend is not None:
        usable_backends([arguments.backend])
    environment = describe_environment()
    cameras = random_scene_cameras(4, arguments.width, arguments.height)
    field = room_field(arguments)
    with torch_threads(arguments.threads):
        seconds = stage_seconds(field, cameras[2], arguments) | location_seconds(field, arguments)
    with tempfile.TemporaryDirectory() as folder:
        commands = command_seconds(field, Path(folder), arguments) if arguments.command_repeats else []
    if commands:
        seconds["scoup query"] = commands

    print(in_one_line(environment))
    print(
        f"{arguments.n_gaussians:,} Gaussians, one view of {arguments.width} x {arguments.height}, three levels, "
        f"L = {arguments.n_atoms}, K = {arguments.k},\n{arguments.threads} threads; processor time, the least of "
        f"{arguments.repeats} (the command: {arguments.command_repeats})\n"
    )
    body = [
        [stage, f"{1e3 * min(times):,.0f}", f"{1e3 * sorted(times)[len(times) // 2]:,.0f}"]
        for stage, times in seconds.items()
    ]
    print(markdown(["stage", "ms", "median"], body))
    print()
    for stage in seconds:
        print(f"{stage}: {STAGES[stage]}")
    record = {
        "what": "benchmarks.query: what a query costs",
        "machine": environment,
        "settings": {
            "gaussians": arguments.n_gaussians,
            "atoms": arguments.n_atoms,
            "k": arguments.k,
            "width": arguments.width,
            "height": arguments.height,
            "threads": arguments.threads,
            "backend": field.project(cameras[2], arguments.backend).backend,
        },
        "stages": STAGES,
        "processor_seconds": seconds,
        "least": {stage: min(times) for stage, times in seconds.items()},
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def room_field(arguments: Arguments) -> LanguageField:
    """A field over the room whose codes are made up."""
    gaussians = random_scene_gaussians(arguments.n_gaussians)
    indices, weights = random_scene_codes(gaussians.means, 3, arguments.n_atoms, arguments.k)
    codebook = clip_like(3 * arguments.n_atoms).view(3, arguments.n_atoms, -1)
    info = FieldInfo(("s", "m", "l"), "words.npz", gaussians.fingerprint(), len(gaussians))
    return LanguageField(indices, weights, codebook, info, gaussians)


def stage_seconds(field: LanguageField, camera: Camera, arguments: Arguments) -> dict[str, list[float]]:
    """Processor seconds of every stage within a process, repetition by repetition; the first, untimed, is left out."""
    queries, canonical = (
        clip_like(arguments.repeats + 1, seed=1),
        clip_like(len(CANONICAL_PHRASES) + 1, seed=2),
    )
    timed = Stopwatch(time.process_time)
    for number in range(arguments.repeats + 1):
        query, other = queries[number][None], queries[number - 1][None]
        projection = timed("project", field.project, camera, arguments.backend)
        timed("first relevancy", field.relevancy, camera, other, canonical, projection)
        maps = timed("further relevancy", field.relevancy, camera, query, canonical, projection)
        timed("place and mask", localize_and_segment, maps[:, 0])
        timed("quarter size", quick_look, field, camera, other, canonical, arguments.backend)
    kept = {stage: times[1:] for stage, times in timed.seconds.items()}

    def sums(*stages: str) -> list[float]:
        return [sum(parts) for parts in zip(*(kept[stage] for stage in stages), strict=True)]

    new = sums("project", "first relevancy", "place and mask")
    return kept | {
        "query, new camera": new,
        "query, same camera": sums("further relevancy", "place and mask"),
    }


def quick_look(
    field: LanguageField, camera: Camera, query: Tensor, canonical: Tensor, backend: str | None
) -> None:
    """Point and mask in a view of a quarter of the size."""
    small = camera.resized(camera.width // 4, camera.height // 4)
    maps = field.relevancy(small, query, canonical, field.project(small, backend))
    localize_and_segment(maps[:, 0])


def location_seconds(field: LanguageField, arguments: Arguments) -> dict[str, list[float]]:
    """Processor seconds of questions to the scene as a whole; the first repetition is left out."""
    words = list(dict.fromkeys([*CANONICAL_PHRASES, *EVERYDAY_WORDS]))
    table = dict(zip(words, clip_like(len(words), seed=3), strict=True))
    asked = words[len(CANONICAL_PHRASES) :]
    timed = Stopwatch(time.process_time)
    for number in range(arguments.repeats + 1):
        fresh = field.with_gaussians(field.gaussians)
        fresh.text_encoder(table)
        fresh.text_encoder().everyday()
        first, other = asked[2 * number], asked[2 * number + 1]
        timed("location, first text", fresh.location, first)
        timed("location, further text", fresh.location, other)
        timed("location, same text", fresh.location, other)
        timed("location, text of many", fresh.location, fresh.question(asked[-MANY:]))
    kept = {stage: times[1:] for stage, times in timed.seconds.items()}
    return kept | {"location, text of many": [each / MANY for each in kept["location, text of many"]]}


def command_seconds(field: LanguageField, folder: Path, arguments: Arguments) -> list[float]:
    """User and system seconds of `scoup query` on files, after one run that is not counted."""
    cameras = random_scene_cameras(4, arguments.width, arguments.height)
    scoup.save_gaussians(field.gaussians, folder / "room.ply")
    gaussians = scoup.load_gaussians(folder / "room.ply")
    words = list(dict.fromkeys([*CANONICAL_PHRASES, WORD, *EVERYDAY_WORDS]))
    save_table(folder / "words.npz", words, clip_like(len(words), seed=3), model="simulated")
    info = FieldInfo(field.levels, "words.npz", gaussians.fingerprint(), len(gaussians))
    stored = LanguageField(
        field.code_indices, field.code_weights, field.codebook, info, gaussians, folder / "room.ply",
        cameras=cameras,
    )  # fmt: skip
    stored.save(folder / "room.scoup")
    options = ["--camera", cameras[2].name, "--pictures", "none", "--out", str(folder / "out"), "--overwrite"]
    start = "from scoup.cli.app import entry; entry()"
    command = [sys.executable, "-c", start, "query", str(folder / "room.scoup"), WORD, *options]
    environment = os.environ | {"OMP_NUM_THREADS": str(arguments.threads)}
    # Whoever installs a program has its byte code written once.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    seconds = []
    for _ in range(arguments.command_repeats + 1):
        before = os.times()
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        seconds.append(
            after.children_user - before.children_user + after.children_system - before.children_system
        )
    return seconds[1:]


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
