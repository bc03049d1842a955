"""Damaged files that are chosen by the code they reach (atheris, that is libFuzzer), beside those of the seed.

    pip install atheris
    python -m benchmarks.hostile.guided [--runs 20000] [--readers splat "ascii ply"] [--corpus FOLDER] [--out FILE.json]

For readers whose code is Python: valid files are the first corpus, what reaches new code joins it, and is kept in
--corpus for the next run. An exception that is no ScoupError, or one whose message is not one line that names the file,
a hang of ten seconds, or resident memory beyond 2 GB ends the reader's run, and is a failure. The command ends with 1
where there are failures, and keeps their files (--failures).
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

READERS = "benchmarks.hostile.readers:READERS"
IN_PYTHON = (
    "ply", "ascii ply", "compressed ply", "splat", "spz", "glb", "gltf", "cameras.bin", "images.bin", "cameras.txt",
    "images.txt", "points3D.txt", "transforms.json", "cameras.json", "cfg_args", "config.yml", "cfg.yml",
    "region labels", "regions", "regions.json", "field", "region sums", "shards", "list of scenes", "words.json",
)  # fmt: skip
_LARGEST = 65_536
_CHILD = "--child"


@dataclass(frozen=True)
class Arguments:
    runs: int = 20_000
    """Files for each reader."""
    seed: int = 1
    """Of the damage; 0 is one of the clock's."""
    readers: tuple[str, ...] = IN_PYTHON
    """Which readers, by name."""
    table: str = READERS
    """"module:table" of the readers."""
    corpus: Path | None = None
    """Folder for files that reach new code, a folder a reader; by default they are not kept."""
    failures: Path | None = None
    """Folder for the files that made a reader fail."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Run all readers, print the table, give the record."""
    from scoup.io import check_output
    from scoup_lab.bench import describe_environment, write_json
    from scoup_lab.bench.environment import in_one_line

    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    found = []
    for reader in arguments.readers:
        found.append(guided(reader, arguments))
        print(f"{reader}: {found[-1]}", file=sys.stderr, flush=True)
    record = {
        "what": "benchmarks.hostile.guided: damaged files chosen by the code they reach",
        "environment": environment,
        "settings": {"runs": arguments.runs, "seed": arguments.seed},
        "readers": found,
        "failures": sum(of["failed"] for of in found),
    }
    print(in_one_line(environment))
    print(table(found))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def guided(reader: str, arguments: Arguments) -> dict[str, Any]:
    """The run of one reader, in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="guided-") as name:
        corpus = Path(name) if arguments.corpus is None else arguments.corpus / _file_name(reader)
        failures = Path(name) if arguments.failures is None else arguments.failures / _file_name(reader)
        for folder in (corpus, failures):
            folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "benchmarks.hostile.guided", _CHILD, arguments.table, reader, str(corpus),
                   str(failures), str(arguments.runs), str(arguments.seed)]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    return {"reader": reader, **figures(done.stderr), "failed": done.returncode != 0, "said": _said(done)}


def figures(log: str) -> dict[str, int]:
    """Runs, and edges of code that the valid files reach, and all in the end, from libFuzzer's log."""
    covered = [int(number) for number in re.findall(r"cov: (\d+)", log)]
    runs = re.findall(r"^#(\d+)", log, re.MULTILINE)
    return {
        "runs": int(runs[-1]) if runs else 0,
        "reached_at_first": covered[0] if covered else 0,
        "reached": covered[-1] if covered else 0,
    }


def table(readers: Sequence[Mapping[str, Any]]) -> str:
    """One line a reader."""
    from scoup_lab.bench import markdown

    numbers = ("runs", "reached_at_first", "reached")
    rows = [[of["reader"], *(f"{of[name]:,}" for name in numbers), str(int(of["failed"]))] for of in readers]
    return markdown(["reader", "files", "edges reached by valid files", "by all", "failures"], rows)


def _said(done: subprocess.CompletedProcess[str]) -> str:
    return "" if done.returncode == 0 else done.stderr[-2000:]


def _file_name(reader: str) -> str:
    return re.sub(r"\W+", "_", reader)


def child(table_name: str, name: str, corpus: str, failures: str, runs: str, seed: str) -> None:
    """Read files that libFuzzer makes, in this process, which it ends."""
    atheris: Any = importlib.import_module("atheris")  # the wheel has no types
    with atheris.instrument_imports(include=["scoup"]):
        module, attribute = table_name.split(":")
        reader = getattr(importlib.import_module(module), attribute)[name]
        from benchmarks.hostile.samples import write_samples
        from scoup.base.errors import ScoupError
    import warnings

    folder = Path(tempfile.mkdtemp(prefix="guided-files-"))
    write_samples(folder)
    valid = Path(tempfile.mkdtemp(prefix="guided-valid-"))
    for number, file in enumerate((reader.file, *reader.more)):
        sample = folder / file
        (valid / str(number)).write_bytes(sample.read_bytes() if sample.is_file() else b"")
    warnings.simplefilter("ignore")

    def read(content: bytes) -> None:
        (folder / reader.file).write_bytes(content)
        try:
            reader.read(folder)
        except ScoupError as error:
            if "\n" in str(error) or str(folder) not in str(error):
                raise RuntimeError(f"a message of several lines, or without the file: {error}") from error

    flags = [f"-runs={runs}", f"-seed={seed}", f"-max_len={_LARGEST}", f"-artifact_prefix={failures}/"]
    flags += ["-timeout=10", "-rss_limit_mb=2048", "-print_final_stats=0"]
    atheris.Setup(["guided", *flags, corpus, str(valid)], read)
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1:2] == [_CHILD]:
        child(*sys.argv[2:])
    else:
        sys.exit(1 if main(tyro.cli(Arguments, description=__doc__))["failures"] else 0)
