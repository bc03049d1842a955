"""The GPU backend measured on this machine's GPU, in one command.

    python -m benchmarks.gpu [--quick] [--budget-seconds 600] [--stages rendering uplift] [--out FILE.json]

Runs the parity suite, then times everything side by side and writes docs/benchmarks/gpu-DEVICE.json and .md: our
relevancy, coefficient maps, features and uplift beside gsplat (`pip install gsplat`, needs nvcc; where it is missing
the rows say so), the per-pixel scatter and the paper's whole procedure; kernels beside what the device can do;
precisions; growth. Files are written anew after each stage, so what is known stays when the run is interrupted.
`--smoke` runs everything tiny with interpreted kernels, without a GPU: its times mean nothing.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from benchmarks.gpu.conduct import conduct
from benchmarks.gpu.machine import slug
from benchmarks.gpu.sizes import FULL, QUICK, SMOKE
from benchmarks.gpu.worker import STAGES
from scoup.errors import InputError, ScoupError, UnknownNameError
from scoup.io import check_output

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
SMOKE_PARITY = "tensors_on_a_cpu_are_refused"  # one quick test: proves that the suite is found and run
QUICK_PARITY = (
    "on_a_gpu or a_gpu_finds or encode_does_not_care"  # without what is interpreted or only compiled
)


@dataclass(frozen=True)
class Arguments:
    quick: bool = False
    """Fewer repetitions, views and epochs (those left out are extrapolated, and the rows say so); of the parity suite
    only what runs on the GPU."""
    smoke: bool = False
    """Tiny, with interpreted kernels on the CPU."""
    budget_seconds: float | None = None
    """Time for everything; what does not fit is left out."""
    stages: tuple[str, ...] = tuple(STAGES)
    """Which to run, in this order."""
    parity: bool = True
    """Run the parity suite first."""
    out: Path | None = None
    """JSON file to write; a .md beside it. Default: docs/benchmarks/gpu-DEVICE.json."""
    overwrite: bool = False
    """Replace files of an earlier run."""


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
    conduct(
        out,
        sizes,
        arguments.stages,
        mode,
        interpreted=arguments.smoke,
        parity=arguments.parity,
        only=only,
        budget_s=arguments.budget_seconds,
    )
    return out


if __name__ == "__main__":
    try:
        written = main(tyro.cli(Arguments, description=__doc__))
    except KeyboardInterrupt:
        sys.exit("interrupted; the files hold what is known")
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    print(written.with_suffix(".md").read_text())
    print(f"written: {written} and {written.with_suffix('.md').name}", file=sys.stderr)
