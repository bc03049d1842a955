"""The GPU backend compared and timed on this machine's GPU, in one command.

    python -m benchmarks.gpu [--quick] [--budget-seconds 560] [--stages parity timing] [--out FILE.json]

Stages: parity (every answer against the reference), timing (one view, beside gsplat, dense uplift and the paper's per-
pixel scatter) and build (whole builds, kept sums and queries, beside the paper's procedure). Writes
docs/benchmarks/gpu-DEVICE.json and .md, again whenever more is known. Each stage is a process: what breaks the device
or hangs costs the rest of its stage. Runs from a checkout in which nothing is installed, with torch, triton and scipy;
parity needs pytest and hypothesis, the comparison gsplat (pip install gsplat) and nvcc, which compiles it. On a machine
without a GPU --quick runs everything tiny, with interpreted kernels: its times mean nothing.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from benchmarks.gpu import ROOT
from benchmarks.gpu.report import report
from benchmarks.gpu.runner import STAGES, Launch, Runner, launch
from benchmarks.gpu.stage import FULL, QUICK, TINY
from scoup.base.errors import InputError, ScoupError, UnknownNameError
from scoup.io import check_output, write_text
from scoup_lab.bench import describe_environment, write_json

SHARE_OF_PARITY = 0.5  # of the time, where other stages follow


def parse(words: list[str] | None = None) -> argparse.Namespace:
    """Return the command line. By argparse: on a borrowed machine there may be nothing else."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.gpu", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="fewer repetitions, epochs (the others are extrapolated, and the row says "
        "so) and draws of the scenes of parity; without a GPU tiny, with interpreted kernels")  # fmt: skip
    add("--budget-seconds", type=float, help="time for everything; what does not fit is left out")
    add("--stages", nargs="+", default=list(STAGES), help=f"which to run, among {', '.join(STAGES)}")
    add("--out", type=Path, help="JSON file, a .md beside it; default: docs/benchmarks/gpu-DEVICE.json")
    add("--overwrite", action="store_true", help="replace files of an earlier run")
    return parser.parse_args(words)


def output(arguments: argparse.Namespace, interpreted: bool) -> Path:
    """Return the JSON file to write, where everything can run and be written."""
    for name in arguments.stages:
        if name not in STAGES:
            raise UnknownNameError("stage", name, STAGES)
    if interpreted and not arguments.quick:
        raise InputError("torch finds no GPU here; --quick runs everything tiny without one")
    if interpreted and arguments.out is None:
        raise InputError(
            "without a GPU --out is needed: the figures mean nothing and do not belong into docs/"
        )
    device = "" if arguments.out else re.sub(r"[^a-z0-9]+", "-", torch.cuda.get_device_name(0).lower())
    out: Path = arguments.out or ROOT / "docs" / "benchmarks" / f"gpu-{device}.json"
    if out.suffix != ".json":
        raise InputError(f"{out}: expected a name that ends with .json")
    for path in (out, out.with_suffix(".md")):
        check_output(path, arguments.overwrite)
    return out


def main(arguments: argparse.Namespace, start: Launch = launch) -> Path:
    """Run the stages; the path of the JSON file, beside which lies the same with .md."""
    interpreted = not torch.cuda.is_available()
    out = output(arguments, interpreted)
    began, budget = time.time(), arguments.budget_seconds or float("inf")
    sizes = TINY if interpreted else QUICK if arguments.quick else FULL
    settings = {"quick": arguments.quick, "budget_s": budget, "interpreted": interpreted, **asdict(sizes)}
    record: dict[str, Any] = {
        "what": "benchmarks.gpu",
        "started": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(began)),
        "machine": describe_environment(),
        "settings": settings,
        "stages": {},
        "finished": False,
    }

    def write() -> None:
        record["seconds"] = time.time() - began
        # JSON knows no numbers that are not finite: they become text.
        write_json(out, json.loads(json.dumps(record), parse_constant=str), overwrite=True)
        try:
            page = report(record)
        except Exception as error:  # figures of hours are not to be lost for a table
            page = f"This page could not be made ({error!r}); {out.name} contains everything.\n"
        write_text(out.with_suffix(".md"), page, overwrite=True)

    runner = Runner(record["stages"], sizes, interpreted, write, start)
    try:
        for name in dict.fromkeys(arguments.stages):
            share = SHARE_OF_PARITY if name == "parity" and len(arguments.stages) > 1 else 1.0
            runner.run(name, began + share * budget)
        record["finished"] = True
    except KeyboardInterrupt:
        record["reason"] = "interrupted"
        raise
    finally:
        write()
    return out


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # of whoever limits the time
    try:
        written = main(parse())
    except KeyboardInterrupt:
        sys.exit("interrupted; the files contain what is known")
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    print(written.with_suffix(".md").read_text())
    print(f"written: {written} and {written.with_suffix('.md').name}", file=sys.stderr)
