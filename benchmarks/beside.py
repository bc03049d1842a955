"""A benchmark in this checkout and in another one, by turns in one run: ratios that a slow minute does not decide.

    python -m benchmarks.beside OTHER benchmarks.lerf_sized [--repeats 2] [--figures total_s ...] [--out FILE.json]
        [-- --threads 2 ...]

OTHER is a checkout with its own .venv (python3 tools/install.py there), such as a commit of before. What follows "--"
is handed to the benchmark, which must write JSON with --out. Figures are numbers at the top of that JSON; of each the
smallest is taken.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from scoup.base.errors import InputError
from scoup.io import check_output
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.bench.environment import in_one_line

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Arguments:
    other: tyro.conf.Positional[Path]
    """The other checkout."""
    benchmark: tyro.conf.Positional[str]
    """Module of the benchmark, in both."""
    repeats: int = 2
    """Runs of each."""
    figures: tuple[str, ...] = ("total_s", "peak_memory_bytes")
    """Numbers of the benchmark's JSON to compare."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments, passed_on: list[str]) -> dict[str, Any]:
    """Run, print the table, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    runs: dict[str, list[dict[str, Any]]] = {"before": [], "now": []}
    for number in range(arguments.repeats):
        for name, root in (("before", arguments.other.resolve()), ("now", ROOT)):
            print(f"run {number + 1} of {arguments.repeats}, {name}", file=sys.stderr, flush=True)
            runs[name].append(run(root, arguments.benchmark, passed_on))
    figures = {}
    for figure in arguments.figures:
        least = {name: min(record[figure] for record in records) for name, records in runs.items()}
        figures[figure] = {**least, "ratio": least["now"] / least["before"]}
    print(in_one_line(describe_environment()))
    body = [
        [name, f"{row['before']:.4g}", f"{row['now']:.4g}", f"{row['ratio']:.2f}"]
        for name, row in figures.items()
    ]
    print(markdown(["figure", "before", "now", "now / before"], body))
    record = {
        "what": f"benchmarks.beside: {arguments.benchmark} {' '.join(passed_on)}".rstrip(),
        "machine": describe_environment(),
        "figures": figures,
        "runs": runs,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def run(root: Path, benchmark: str, passed_on: list[str]) -> dict[str, Any]:
    """The JSON of one run in a checkout."""
    python = root / ".venv" / "bin" / "python"
    if not python.exists():
        raise InputError(f"{root}: has no .venv; run python3 tools/install.py there")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run.json"
        command = [str(python), "-m", benchmark, *passed_on, "--out", str(out)]
        done = subprocess.run(command, cwd=root, capture_output=True, text=True)
        if done.returncode:
            raise InputError(f"{root}: {benchmark} failed: {done.stderr.strip()[-500:]}")
        return json.loads(out.read_text())


if __name__ == "__main__":
    own, _, rest = " ".join(sys.argv[1:]).partition(" -- ")
    main(tyro.cli(Arguments, description=__doc__, args=own.split()), rest.split())
