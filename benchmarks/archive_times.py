"""What archives of many things cost: time and memory of adding, removing and asking."""

from __future__ import annotations

import json
import os
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.processes import SCOUP, run_python
from benchmarks.random_field import write_words
from benchmarks.scenes import LAYOUTS, field_of, scene_of
from benchmarks.study import Record, Study
from scoup.archive import Archive
from scoup.archive.archive import ABOUT, FORMAT, VERSION
from scoup.archive.kept_scans import MATRIX, vector_bytes
from scoup.archive.scan_files import Scan, arrays_of, write_scan
from scoup.archive.search import words_digest
from scoup.base import WorldFrame
from scoup.field import ThingTable
from scoup.models import EVERYDAY_WORDS, TextEncoder
from scoup.query import LanguageField, Thing, ThingIndex
from scoup_lab.bench import markdown

TEXT = "teapot"


@dataclass(frozen=True, kw_only=True)
class ArchiveTimes(Study):
    """Time archives in which simulated scans of the layouts are repeated; words have made-up vectors, so that times
    mean something, answers do not."""

    things: tuple[int, ...] = (150_000, 1_000_000)
    """Things of each archive."""
    scans: tuple[str, ...] = tuple(f"{layout}-{seed}" for seed in range(3) for layout in LAYOUTS)
    """Layouts of benchmarks.scenes with a seed."""
    size: tuple[int, ...] = (40_000, 360, 270, 18, 0)
    """Of a scan: Gaussians, width and height of the views in pixels, and views with and without regions."""

    rows_depend_on = ("scans", "size")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        fields = [field_of(scene_of(name, *self.size)) for name in self.scans]
        for count in self.things:
            if str(count) not in known:
                with tempfile.TemporaryDirectory() as folder:
                    yield str(count), _times(fields, count, Path(folder))

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


def _times(fields: Sequence[LanguageField], count: int, folder: Path) -> Record:
    """Return wall and processor seconds, and memory, with an archive of so many things: each field many times."""
    table = write_words(folder / "words.npz")
    encoder = TextEncoder.open(table)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "embedding_model": encoder.name,
        "dim": 512,
        "words": table.name,
    }
    (folder / ABOUT).write_text(json.dumps(about))
    some: list[tuple[ThingTable, ThingIndex, list[Thing]]] = []
    for each in fields:
        index = ThingIndex.of_field(each, encoder)
        assert each.thing_table is not None
        assert index is not None
        some.append((each.thing_table, index, Thing.of_table(each, range(len(each.thing_table)))))
    total, scans, digest = 0, 0, words_digest(encoder.everyday())
    with (folder / MATRIX).open("wb") as matrix:
        while total < count or scans < len(some):
            of_scan, index, things = some[scans % len(some)]
            vectors = vector_bytes(of_scan.embeddings)
            matrix.write(vectors)
            scan = Scan(
                file=folder / f"scan-{scans:05}.parquet", field=f"scan-{scans:05}.scoup",
                levels=("s", "m", "l"), columns={}, world=WorldFrame(), row=total,
                vectors_checksum=zlib.crc32(vectors), words=digest, texts=(),
                arrays=arrays_of(index, None, torch.ones(len(of_scan), dtype=torch.bool)),
            )  # fmt: skip
            write_scan(scan, of_scan, things)
            total, scans = total + len(of_scan), scans + 1
    clock: Record = {}
    memory: Record = {}
    for name, command in {
        "import of torch alone": ["import torch"],
        "shell": [SCOUP, "archive", str(folder), TEXT],
    }.items():
        done = run_python(*command)
        clock[name] = [round(done.wall_s, 3), round(done.cpu_s, 3)]
        memory[name] = round(done.peak_bytes / 1024e3)
    archive = Archive(folder, encoder)
    clock["first text"] = _seconds(archive.find, TEXT)
    clock["further texts"] = np.median(
        [_seconds(archive.find, text) for text in EVERYDAY_WORDS[:5]], 0
    ).tolist()
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
