"""What archives of many things cost: time and memory of adding, removing and asking."""

from __future__ import annotations

import json
import os
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.archive_scans import World
from benchmarks.data import data_folder
from benchmarks.embedding_kinds import KINDS
from benchmarks.processes import SCOUP, run_python
from benchmarks.study import Record, Study
from scoup.archive import Archive
from scoup.archive.archive import ABOUT, FORMAT, VERSION
from scoup.archive.kept_scans import MATRIX, vector_bytes
from scoup.archive.scan_files import Scan, arrays_of, write_scan
from scoup.archive.search import words_digest
from scoup.base import WorldFrame
from scoup.models import CANONICAL_PHRASES, TextEncoder, WordTable
from scoup_lab.bench import markdown

TEXT, SCANS = "teapot", 48


@dataclass(frozen=True, kw_only=True)
class ArchiveTimes(Study):
    """Time archives in which some simulated scans are repeated."""

    data: Path = field(default_factory=data_folder)
    """Folder of the scenes with real models, whose words are asked."""
    things: tuple[int, ...] = (150_000, 1_000_000)
    """Things of each archive."""

    rows_depend_on = ()

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        world = World.open(self.data)
        for count in self.things:
            if str(count) not in known:
                with tempfile.TemporaryDirectory() as folder:
                    yield str(count), _times(world, count, Path(folder))

    def line(self, figures: Any) -> str:
        return json.dumps(figures)

    @staticmethod
    def table(record: Record) -> str:
        columns = record["rows"].values()
        heads = [f"{of['things']:,} things in {of['scans']:,} scans" for of in columns]
        first, *_ = columns
        body = [
            *([what, *(f"{of['seconds'][what][0]:.2f} s" for of in columns)] for what in first["seconds"]),
            *(
                [f"memory: {what}", *(f"{of['memory in MB'][what]:,.0f} MB" for of in columns)]
                for what in first["memory in MB"]
            ),
            ["files", *(f"{of['files in MB']:,.0f} MB" for of in columns)],
        ]
        return markdown(["wall time", *heads], body)


def _times(world: World, count: int, folder: Path) -> Record:
    """Return wall and processor seconds, and memory, with an archive of so many things: some scans many times."""
    words = [*world.everyday, *CANONICAL_PHRASES]
    table = folder / "words.npz"
    WordTable.save(table, words, world.of(words).numpy(), model="simulated")
    about = {
        "format": FORMAT,
        "version": VERSION,
        "embedding_model": "simulated",
        "dim": 512,
        "words": "words.npz",
    }
    (folder / ABOUT).write_text(json.dumps(about))
    some = world.simulate(KINDS["clip"], SCANS, seed=7)
    encoder, seconds, total, scans = TextEncoder.open(table), list[list[float]](), 0, 0
    digest = words_digest(encoder.everyday())
    with (folder / MATRIX).open("wb") as matrix:
        while total < count or scans < SCANS:
            each = some[scans % SCANS]
            vectors = vector_bytes(each.table.embeddings)
            matrix.write(vectors)
            scan = Scan(
                file=folder / f"{each.name}-{scans:05}.parquet", field=f"{each.name}.scoup",
                levels=("s", "m", "l"), columns={}, world=WorldFrame(), row=total,
                vectors_checksum=zlib.crc32(vectors), words=digest, texts=(),
                arrays=arrays_of(each.index, None, torch.ones(len(each.table), dtype=torch.bool)),
            )  # fmt: skip
            seconds.append(_seconds(write_scan, scan, each.table, each.things))
            total, scans = total + len(each.table), scans + 1
    clock: Record = {"write one scan": np.median(seconds, 0).tolist()}
    memory: Record = {}
    for name, command in {
        "import of torch alone": ["import torch"],
        "shell, help": [SCOUP, "archive", "--help"],
        "shell": [SCOUP, "archive", str(folder), TEXT],
    }.items():
        done = run_python(*command)
        clock[name] = [round(done.wall_s, 3), round(done.cpu_s, 3)]
        memory[name] = round(done.peak_bytes / 1024e3)
    archive = Archive(folder, encoder)
    clock["first text"] = _seconds(archive.find, TEXT)
    for name in ("further texts", "same texts again"):
        clock[name] = np.median([_seconds(archive.find, text) for text in world.asked[:5]], 0).tolist()
    first = sorted(folder.glob("*.parquet"))[0]
    os.utime(first)
    clock["a text after one scan was added"] = _seconds(archive.find, TEXT)
    clock["remove one scan"] = _seconds(archive.remove, first.stem)
    size = sum(file.stat().st_size for file in (folder / MATRIX, *folder.glob("*.parquet")))
    return {
        "things": total,
        "scans": scans,
        "files in MB": size / 1e6,
        "memory in MB": memory,
        "seconds": clock,
    }


def _seconds(work: Callable[..., Any], *arguments: Any) -> list[float]:
    """Return wall and processor seconds."""
    start, used = time.perf_counter(), time.process_time()
    work(*arguments)
    return [round(time.perf_counter() - start, 3), round(time.process_time() - used, 3)]
