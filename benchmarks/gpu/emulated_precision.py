"""In what the answers of each precision differ from plain float32, told without a GPU.

The kernels are interpreted, with products as tensor cores make them (``benchmarks.gpu.interpreting``). On a GPU the
stage ``precision`` tells it of large scenes, and the times.

python -m benchmarks.gpu.emulated_precision          # ten minutes
"""

from __future__ import annotations

import argparse
import sys
import warnings
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.gpu.sizes import FULL
from scoup.base.errors import InputError, ScoupError
from scoup.bench import write_json
from scoup.io import check_output


@dataclass(frozen=True)
class Arguments:
    """Sizes of the synthetic room and of its view, L of the codebooks, and where to write."""

    n_gaussians: int
    width: int
    height: int
    n_atoms: tuple[int, ...]
    out: Path | None
    overwrite: bool


def parse(words: list[str] | None = None) -> Arguments:
    parser = argparse.ArgumentParser("python -m benchmarks.gpu.emulated_precision", description=__doc__)
    parser.add_argument("--n-gaussians", type=int, default=5000, help="of the room")
    parser.add_argument("--width", type=int, default=80, help="of the view, in pixels")
    parser.add_argument("--height", type=int, default=56)
    parser.add_argument("--n-atoms", type=int, nargs="+", default=[64, 128], help="codebooks of three levels")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--overwrite", action="store_true")
    found = vars(parser.parse_args(words))
    return Arguments(**{**found, "n_atoms": tuple(found["n_atoms"])})


def main(arguments: Arguments) -> str:
    """Measure, write, and give the table."""
    if min(arguments.n_gaussians, arguments.width, arguments.height, *arguments.n_atoms) < 1:
        raise InputError("there must be at least one Gaussian, pixel and atom")
    if "triton" in sys.modules:
        raise InputError("triton is imported already: a process interprets all kernels or none")
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    from benchmarks.gpu.interpreting import interpret_kernels

    interpret_kernels()
    warnings.filterwarnings("ignore", category=RuntimeWarning)  # of numpy, in the interpreter
    rows = [row for n_atoms in arguments.n_atoms for row in compare(arguments, n_atoms)]
    record = {"arguments": {**asdict(arguments), "out": None}, "rows": rows}
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return table(arguments, rows)


def compare(arguments: Arguments, n_atoms: int) -> list[dict[str, Any]]:
    """A row for each precision."""
    import torch

    from benchmarks.gpu.context import PRESET, Context
    from benchmarks.gpu.precision import EXACT, PRECISIONS, answers, differences
    from scoup import raster
    from scoup.raster.triton import rendering as gpu

    sizes = replace(FULL, n_gaussians=arguments.n_gaussians, width=arguments.width, height=arguments.height)
    context = Context(torch.device("cpu"), sizes, float("inf"), lambda result: None)
    work = context.work(n_atoms)
    constants = raster.raster_preset(PRESET)
    exact = answers(work, gpu.project(work.gaussians, work.camera, constants, EXACT))
    rows = []
    for name in PRECISIONS[1:]:
        print(f"L = {n_atoms}: {name}", file=sys.stderr)
        theirs = answers(work, gpu.project(work.gaussians, work.camera, constants, name))
        rows.append({"n_atoms": n_atoms, "name": name, **differences(theirs, exact, sizes.k)})
    return rows


def table(arguments: Arguments, rows: list[dict[str, Any]]) -> str:
    lines = [
        f"Room of {arguments.n_gaussians:,} Gaussians, a view of {arguments.width} x {arguments.height}, three levels; "
        "against plain float32. Interpreted: nothing was run on a GPU.",
        "",
        "| L | precision | coefficients | cosines | sums of codes, relative | pixels of another order "
        "| votes of another order |",
        "|--:|---|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        lines.append(
            f"| {row['n_atoms']} | {row['name']} | {row['coefficients_max']:.1e} | {row['cosines_max']:.1e} | "
            f"{row['sums_max_relative']:.1e} | {row['pixels_of_another_order']:.1e} | "
            f"{row['votes_of_another_order']:.1e} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        print(main(parse()))
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
