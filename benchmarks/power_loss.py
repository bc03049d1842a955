"""Power cuts at every change of a file, simulated: what was not flushed to the disk is lost."""

from __future__ import annotations

import json
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.endurance import Plain, run_undisturbed
from benchmarks.endurance_runs import environment, snapshot
from benchmarks.endurance_verbs import VERBS, Scene, Verb, make_scene
from benchmarks.study import Record, Study
from scoup.base.errors import looked_up
from scoup_lab.bench import markdown

Contents = dict[str, bytes]  # of every file of a folder, as ``endurance_runs.snapshot`` returns them


@dataclass(frozen=True, kw_only=True)
class PowerLoss(Study):
    """Cut the power at every change of a file, in a simulation, and run the verb again.

    Each verb runs once, in a process that records what is on the disk at each change of a file
    (`benchmarks/power_loss_child.py`). For each moment four folders are made from that: with the names of this moment,
    or only with those that were flushed; files whose contents were not flushed are empty, or zeros of their size. In
    each of them, all outputs must be whole; after the end, all outputs must be there. In some of them, chosen at
    random, the same command then runs to its end, and must leave the bytes of an undisturbed run. The control is the
    same verb without flushing: there outputs that are not whole must be found.
    """

    verbs: tuple[str, ...] = tuple(VERBS)
    """Which verbs."""
    views: int = 12
    """Of the scene."""
    width: int = 240
    """Of its photographs, in pixels."""
    runs: int = 5
    """Folders of each verb in which it runs again; and, with and without flushing, runs that are timed."""
    seed: int = 0
    """Of the choice of these folders."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("views", "width", "runs", "seed")

    def check(self) -> None:
        for name in self.verbs:
            looked_up("verb", name, VERBS)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        with tempfile.TemporaryDirectory(prefix="scoup-power-loss-") as folder:
            scene = make_scene(Path(folder) / "scene", self.views, self.width)
            for name in self.verbs:
                if name not in known:
                    yield name, figures(VERBS[name], scene, self.runs, self.seed)

    def record(self, rows: dict[str, Any]) -> Record:
        return {"verbs": rows}

    @staticmethod
    def failed(record: Record) -> bool:
        return any(of["torn"] or of["failed"] or not of["all_at_end"] for of in record["verbs"].values())

    @staticmethod
    def table(record: Record) -> str:
        """Return one line per verb."""
        heads = ["verb", "changes of files", "folders", "not whole", "not whole without flushing",
                 "same bytes when run again", "flushes", "ms per flush", "time with flushing / without"]  # fmt: skip
        rows = [
            [name, str(of["moments"]), str(of["folders"]), str(of["torn"]), str(of["torn_without_flushing"]),
             f"{of['runs'] - len(of['failed'])} of {of['runs']}", str(of["flushes"]), f"{of['ms_per_flush']:.1f}",
             f"{of['time_ratio']:.2f}"]
            for name, of in record["verbs"].items()
        ]  # fmt: skip
        return markdown(heads, rows)


@dataclass(frozen=True)
class Recorded:
    """What a verb did to the disk."""

    moments: int  # before changes of files, and the end
    folders: list[Contents]  # that a power cut may leave, each once
    at_end: list[Contents]  # those that it may leave after the end
    flushes: list[float]  # seconds of each


def recorded(verb: Verb, scene: Scene, flush: bool = True) -> Recorded:
    """Run a verb and return what power cuts would have left."""
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder)
        run_child(verb, scene, folder, flush)
        lines = (store / "states.jsonl").read_text().splitlines()
        by_line = {line: _folders(store, line) for line in lines}
        flushes = store / "flushes"
        taken = [float(text) for text in flushes.read_text().split()] if flushes.exists() else []
    each = {tuple(sorted(found.items())): found for folders in by_line.values() for found in folders}
    return Recorded(len(lines), list(each.values()), by_line[lines[-1]], taken)


def run_child(verb: Verb, scene: Scene, store: str, flush: bool) -> float:
    """Run a verb by `benchmarks/power_loss_child.py`; return its seconds."""
    verb.prepare(scene)
    child = [sys.executable, "-m", "benchmarks.power_loss_child", store, str(scene.work), str(int(flush))]
    quiet = subprocess.DEVNULL
    start = time.perf_counter()
    subprocess.run([*child, *verb.command(scene)], cwd=scene.work, env=environment(), check=True, stdout=quiet,
                   stderr=quiet)  # fmt: skip
    return time.perf_counter() - start


def _folders(store: Path, line: str) -> list[Contents]:
    """Return what a power cut at a moment may leave."""
    return [
        {
            path: (store / str(number)).read_bytes() if number is not None else filling * size
            for path, (number, size) in names.items()
        }
        for names in json.loads(line)
        for filling in (b"", b"\0")
    ]


def is_whole(verb: Verb, plain: Plain, contents: Contents) -> bool:
    """Return whether each file under the name of an output is old or new, and those that belong together are so
    together."""
    for path, content in contents.items():
        if path in {**plain.before, **plain.files} and content not in (
            plain.before.get(path), plain.files.get(path)
        ):  # fmt: skip
            return False
    if not verb.new:
        return True
    return (
        verb.is_new(contents, plain.files)
        or verb.is_as_before(contents, plain.before)
        or verb.says_how_to_go_on(contents)
    )


def failure_of_next_run(verb: Verb, scene: Scene, plain: Plain, contents: Contents) -> str:
    """Run the verb in a folder that a power cut has left; return what was wrong, "" for nothing."""
    shutil.rmtree(scene.work, ignore_errors=True)
    scene.work.mkdir(parents=True)
    for path, content in contents.items():
        file = scene.work / path
        if path.endswith("/"):
            file.mkdir(parents=True, exist_ok=True)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    run = verb.run(scene)
    if run.code and not verb.is_finished(run):
        return run.said
    files = snapshot(scene.work)
    others = [path for path in {**files, **plain.files} if files.get(path) != plain.files.get(path)]
    return f"other files or bytes: {', '.join(sorted(others))}" if others else ""


def figures(verb: Verb, scene: Scene, runs: int, seed: int) -> dict[str, Any]:
    """Return the figures of a verb, for JSON."""
    plain = run_undisturbed(verb, scene)
    flushed, control = recorded(verb, scene), recorded(verb, scene, flush=False)
    chosen = random.Random(f"{verb.name} {seed}").sample(flushed.folders, min(runs, len(flushed.folders)))
    failed = [failure for each in chosen if (failure := failure_of_next_run(verb, scene, plain, each))]
    times: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(runs):
        for flush, taken in times.items():
            taken.append(run_child(verb, scene, "", flush))
    return {
        "moments": flushed.moments,
        "folders": len(flushed.folders),
        "torn": sum(not is_whole(verb, plain, each) for each in flushed.folders),
        "all_at_end": all(plain.files.items() <= each.items() for each in flushed.at_end),
        "torn_without_flushing": sum(not is_whole(verb, plain, each) for each in control.folders),
        "runs": len(chosen),
        "failed": failed,
        "flushes": len(flushed.flushes),
        "ms_per_flush": 1000 * statistics.median(flushed.flushes or [0.0]),
        "seconds": {"flushing": times[True], "without": times[False]},
        "time_ratio": statistics.median(times[True]) / statistics.median(times[False]),
    }
