"""The GPU backend measured on this machine's GPU, in one command.

    python -m benchmarks.gpu [--quick] [--budget-seconds 560] [--stages rendering sums] [--out FILE.json]

Runs the parity suite, then times everything side by side and writes docs/benchmarks/gpu-DEVICE.json and .md: our
relevancy, coefficient maps, features and region sums beside gsplat (`pip install gsplat`, needs nvcc; where it is
missing the rows say so), the per-pixel scatter and the paper's whole procedure; kernels beside what the device can do;
precisions; growth. Files are written anew whenever more is known, so that stays when the run is ended. What breaks the
device or hangs costs its own row. Runs from a checkout in which nothing is installed, with torch, triton and scipy.
`--smoke` runs everything tiny with interpreted kernels, without a GPU: its times mean nothing.
"""

from __future__ import annotations

import argparse
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import torch

from benchmarks.gpu.conduct import conduct
from benchmarks.gpu.machine import slug
from benchmarks.gpu.sizes import FULL, QUICK, SMOKE
from benchmarks.gpu.worker import STAGES
from scoup.base.errors import InputError, ScoupError, UnknownNameError
from scoup.io import check_output

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
SMOKE_PARITY = "tensors_on_a_cpu_are_refused"  # one quick test: proves that the suite is found and run
# Without what is interpreted or only compiled, and of three draws of every scene the first.
QUICK_PARITY = "(on_a_gpu and not seed1 and not seed2) or a_gpu_finds or encode_does_not_care"


@dataclass(frozen=True)
class Arguments:
    """As ``parse`` describes them."""

    quick: bool = False
    smoke: bool = False
    budget_seconds: float | None = None
    stages: tuple[str, ...] = tuple(STAGES)
    parity: bool = True
    peer: bool = True
    out: Path | None = None
    overwrite: bool = False


def parse(words: list[str] | None = None) -> Arguments:
    """The command line. By argparse: on a borrowed machine there may be nothing else."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add, switch = parser.add_argument, argparse.BooleanOptionalAction
    add("--quick", action="store_true", help="fewer repetitions and epochs (those left out are extrapolated, and the "
        "rows say so); of the parity suite only what runs on the GPU, with one draw of each scene")  # fmt: skip
    add("--smoke", action="store_true", help="tiny, with interpreted kernels on the CPU")
    add("--budget-seconds", type=float, help="time for everything; what does not fit is left out")
    add("--stages", nargs="*", default=list(STAGES), metavar="STAGE",
        help=f"which to run, in this order; none: parity alone. Stages: {', '.join(STAGES)}")  # fmt: skip
    add("--parity", action=switch, default=True, help="run the parity suite first")
    add("--peer", action=switch, default=True, help="compare with gsplat, which is compiled meanwhile")
    add(
        "--out",
        type=Path,
        help="JSON file to write; a .md beside it. Default: docs/benchmarks/gpu-DEVICE.json",
    )
    add("--overwrite", action="store_true", help="replace files of an earlier run")
    found = vars(parser.parse_args(words))
    return Arguments(**{**found, "stages": tuple(found["stages"])})


def main(arguments: Arguments) -> Path:
    """Run, and give the path of the JSON file."""
    for name in arguments.stages:
        if name not in STAGES:
            raise UnknownNameError("stage", name, STAGES)
    if arguments.quick and arguments.smoke:
        raise InputError("give --quick or --smoke, not both")
    if not arguments.smoke and not torch.cuda.is_available():
        raise InputError("torch finds no GPU here; --smoke runs everything tiny without one")
    if arguments.out is not None:
        out = arguments.out
    elif arguments.smoke:
        raise InputError("--smoke needs --out: its figures mean nothing and do not belong into docs/")
    else:
        out = FOLDER / f"gpu-{slug(torch.cuda.get_device_name(0))}.json"
    if out.suffix != ".json":
        raise InputError(f"{out}: give a name that ends with .json")
    check_output(out, arguments.overwrite)
    check_output(out.with_suffix(".md"), arguments.overwrite)
    sizes, mode, only = FULL, "full", ""
    if arguments.quick:
        sizes, mode, only = QUICK, "quick", QUICK_PARITY
    if arguments.smoke:
        sizes, mode, only = SMOKE, "smoke", SMOKE_PARITY
    stages = list(arguments.stages)
    if "roofline" in stages and "ceilings" not in stages[: stages.index("roofline")]:
        stages.insert(stages.index("roofline"), "ceilings")  # without them there are no bounds
    conduct(
        out,
        sizes,
        list(dict.fromkeys(stages)),
        mode,
        interpreted=arguments.smoke,
        parity=arguments.parity,
        only=only,
        budget_s=arguments.budget_seconds,
        peer=arguments.peer,
    )
    return out


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, interrupt)  # of whoever limits the time
    try:
        written = main(parse())
    except KeyboardInterrupt:
        sys.exit("interrupted; the files hold what is known")
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    print(written.with_suffix(".md").read_text())
    print(f"written: {written} and {written.with_suffix('.md').name}", file=sys.stderr)
