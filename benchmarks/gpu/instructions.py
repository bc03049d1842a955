"""Instructions that blending takes, counted in the compiled kernels: no GPU is needed, and no time is told.

    python -m benchmarks.gpu.instructions [--capability 90] [--json FILE] [--gsplat FOLDER --nvcc PATH] [--lanes FILE]

Each kernel that blends is compiled for the GPU asked for and disassembled, and the loop over Gaussians is found: the
innermost that takes powers of 2 (MUFU.EX2). Counted is one turn of it, as a warp issues it: instructions that a
predicate switches off count, loops inside (over blocks of columns in region sums) count once, and what serves threads
of a warp that have come apart where they should be together does not count. Of several ways through the loop the
longest is counted; the shortest that takes a power is given, too. What comes before and after the loop is not counted.

A lane is one pixel and one Gaussian, seen by one thread. A turn of our loops is TILE x TILE x CHUNK / (32 x warps) of
them, and takes the same way whether they paint or not. What comes of the weights,
which is matrix products with 16 channels, or with 3 x 64 atoms, is in the loop and counted. A turn of gsplat's loop is
one Gaussian at each thread's own pixel, or several where the compiler unrolls it: as many lanes as powers. A warp goes
the longest way there if any of its 32 pixels is painted, and the shortest if none is. A pixel that has stopped leaves
gsplat's loop; a warp leaves when all have.

Columns, in instructions a lane:

  fp32         additions, products and multiply-adds of float32
  fp16         the same of two float16; the compiler also sets registers to constants with them
  fp64         float64
  ALU          comparisons, minima, selections, sums of integers, logic: units beside those of fp32
  IMAD         integer products, and what the compiler makes of them: sums, shifts, addresses; on the units of fp32
  special      powers, reciprocals, roots
  tensor       matrix products on the tensor cores
  shared       shared memory, matrices of it too
  global       global memory: loads, stores, additions, copies to shared memory
  spills       local memory: what did not fit into registers, out and back
  shuffles     between the threads of a warp
  waits        barriers of a block, fences, waiting for copies and tensor cores
  branches     branches, and where the threads of a warp part and meet
  conversions  between types
  moves        copies of registers, those by IMAD too
  uniform      what runs once for a warp, and loads of constants
  other        what this program does not know; a line below the tables names it

With --lanes, the file that python -m benchmarks.gpu.lanes --json writes, a third table multiplies: instructions a lane
times the lanes a pixel of a view. For gsplat's forward kernels it is the longest way for steps of warps that paint, the
shortest for those that skip, each step for all 32 pixels of the warp. Still not counted is what comes before and after
the loop; and region sums, which go over a tile's list once more for every 16 columns, count once.

Instructions are not time: they differ in how many are begun in a cycle, they wait for memory and for one another, and
one on the tensor cores does thousands of operations. What fits on a multiprocessor is by registers, shared memory,
warps and blocks, as CUDA's occupancy calculator has it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.gpu.a_pixel import a_pixel, read_lanes, table
from benchmarks.gpu.compiled import DEVICES, THREADS, Usage, compile_kernel, disassemble, resources
from benchmarks.gpu.disassembly import GROUPS, OTHER, Function, parse, powers, tally
from benchmarks.gpu.gsplat_kernels import PEERS, SOURCES, WARPS, Peer, channels_of, compile_peer, versions
from benchmarks.gpu.launches import launches
from benchmarks.gpu.machine import version_of
from benchmarks.gpu.timing import Row, Unavailable, reason
from scoup.base.errors import InputError, ScoupError
from scoup.bench import markdown, write_json
from scoup.io import check_output

NOT_ASKED = (
    "not asked for: --gsplat FOLDER (which holds gsplat/cuda/csrc), and --nvcc PATH where nvcc is not found"
)


def parse_words(words: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu.instructions",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    # fmt: off
    add = parser.add_argument
    add("--capability", type=int, default=90, choices=sorted(DEVICES), metavar="N",
        help=f"compute capability, of {', '.join(map(str, sorted(DEVICES)))}: 80 is an A100, 90 an H100 or H200")
    add("--json", type=Path, metavar="FILE", help="write everything counted to this file, too")
    add("--overwrite", action="store_true", help="replace a file of an earlier run")
    add("--gsplat", type=Path, metavar="FOLDER", help="count gsplat's rasterisers too: the folder it is installed or "
        "unpacked in, which holds gsplat/cuda/csrc")
    add("--nvcc", type=Path, metavar="PATH", help="CUDA's compiler, for gsplat; default: the nvcc on the PATH")
    add("--lanes", type=Path, metavar="FILE", help="print instructions a pixel too, on the views of this file, which "
        "python -m benchmarks.gpu.lanes --json FILE writes")
    # fmt: on
    return parser.parse_args(words)


def count(
    name: str, function: Function, usage: Usage, warps: int, capability: int, lanes: float | None
) -> Row:
    """A row: the blending loop of a kernel, and what fits on a multiprocessor.

    Args:
        name: of the row.
        function: the kernel, disassembled.
        usage: of a thread and a block.
        warps: of a block.
        capability: of the GPU it was compiled for.
        lanes: of a turn; None: as many as powers of 2 on the way.
    """
    blocks = usage.blocks(warps, DEVICES[capability])
    row: Row = {
        "name": name,
        "registers": usage.registers,
        "spilled": usage.spilled,
        "shared": usage.shared,
        "warps_a_block": warps,
        "blocks": blocks,
        "warps": blocks * warps,
    }
    loop = function.blending_loop()
    longest = function.way_round(loop) if loop else ()
    if loop is None or not longest:
        row["reason"] = "no loop that takes powers of 2 was found"
        return row
    shortest = function.way_round(loop, shortest=True)
    taken = powers(longest)
    row.update(
        lanes=taken if lanes is None else lanes,
        powers=taken,
        instructions=len(longest),
        groups=tally(longest),
        shortest=len(shortest),
        shortest_lanes=powers(shortest) if lanes is None else lanes,
        loops_inside=function.loops_inside(loop),
        calls=sum(own.opcode.startswith("CALL") and not own.operands.startswith("`(.L") for own in longest),
        unknown=sorted({own.opcode for own in longest if own.group == OTHER}),
    )
    return row


def lanes_of(constants: dict[str, Any], warps: int) -> float:
    """Pixels and Gaussians of a turn of our loops, for one thread."""
    return constants["TILE"] ** 2 * constants["CHUNK"] / (THREADS * warps)


def count_ours(capability: int, progress: Callable[[str], None]) -> list[Row]:
    """A row for each kernel that takes Gaussians in chunks, as ``launches`` has them."""
    rows: list[Row] = []
    for name, (kernel, types, constants, warps) in launches().items():
        if "CHUNK" not in constants:
            continue
        progress(name)
        try:
            with tempfile.TemporaryDirectory() as folder:
                binary = Path(folder) / "kernel.cubin"
                content, shared = compile_kernel(kernel, types, constants, warps, capability)
                binary.write_bytes(content)
                functions, needs = parse(disassemble(binary)), resources(binary)
            function = functions[kernel.__name__]
            usage = Usage(*needs[function.name], shared)
            row = count(name, function, usage, warps, capability, lanes_of(constants, warps))
            rows.append({**row, "tile": constants["TILE"], "chunk": constants["CHUNK"]})
        except Exception as error:
            rows.append({"name": name, "reason": reason(error)})
    return rows


def count_peer(
    peer: Peer, gsplat: Path | None, nvcc: Path | None, capability: int, progress: Callable[[str], None]
) -> list[Row]:
    """A row for each number of channels, or one that says why there is none."""
    if gsplat is None or nvcc is None:
        return [{"name": peer.name, "reason": NOT_ASKED}]
    progress(peer.name)
    try:
        with tempfile.TemporaryDirectory() as folder:
            binary = compile_peer(peer, gsplat, nvcc, capability, Path(folder))
            functions, needs = parse(disassemble(binary)), resources(binary)
    except Exception as error:
        return [{"name": peer.name, "reason": reason(error)}]
    rows: list[Row] = []
    for function in sorted(functions.values(), key=lambda one: channels_of(one.name) or 0):
        channels = channels_of(function.name) or 0
        usage = Usage(*needs[function.name], peer.shared(channels))
        rows.append(count(f"{peer.name}, {channels} channels", function, usage, WARPS, capability, None))
    return rows


def report(record: dict[str, Any]) -> str:
    """Tables: instructions a lane, what fits on a multiprocessor, and, where lanes are given, instructions a pixel;
    and what could not be counted.
    """
    rows: list[Row] = record["rows"]
    counted = [row for row in rows if "instructions" in row]
    built = [row for row in rows if "registers" in row]
    groups = [group for group in (*GROUPS, OTHER) if any(group in row["groups"] for row in counted)]
    a_lane = [
        [
            row["name"],
            f"{row['lanes']:g}",
            str(row["instructions"]),
            f"{row['instructions'] / row['lanes']:.1f}",
            f"{row['shortest'] / row['shortest_lanes']:.1f}",
            *(f"{row['groups'].get(group, 0) / row['lanes']:.2f}" for group in groups),
        ]
        for row in counted
    ]
    fits = [
        [
            row["name"],
            *(
                f"{row[key]:,}"
                for key in ("registers", "spilled", "shared", "warps_a_block", "blocks", "warps")
            ),
        ]
        for row in built
    ]
    parts = [f"Compiled for sm_{record['capability']} by {', '.join(record['by'])}; nothing was run."]
    if counted:
        head = ["instructions a lane", "lanes", "of a turn", "longest", "shortest", *groups]
        parts.append(markdown(head, a_lane))
    if built:
        head = [
            "on a multiprocessor",
            "registers",
            "spilled bytes",
            "shared bytes",
            "warps a block",
            "blocks",
            "warps",
        ]
        parts.append(markdown(head, fits))
    if record.get("views"):
        parts.append(table(rows, record["views"]))
    parts += [note for row in rows if (note := note_of(row))]
    return "\n\n".join(parts)


def note_of(row: Row) -> str:
    """What a reader of the row must know."""
    if "reason" in row:
        return f"{row['name']}: {row['reason']}"
    notes = []
    if row["loops_inside"]:
        notes.append(f"loops inside the loop: {row['loops_inside']}, gone through once")
    if row["calls"]:
        notes.append(f"calls of functions, whose instructions are not counted: {row['calls']}")
    if row["powers"] != row["lanes"]:
        notes.append(f"{row['powers']} powers of 2 for {row['lanes']:g} lanes: the loop is not as assumed")
    if row["unknown"]:
        notes.append(f"of no known group: {', '.join(row['unknown'])}")
    if not row["blocks"]:
        notes.append("not one block fits on a multiprocessor: it cannot be launched")
    return f"{row['name']}: {'; '.join(notes)}" if notes else ""


def main(words: list[str] | None = None) -> str:
    """The tables; with ``--json``, written to a file as a record, too."""
    arguments = parse_words(words)
    if os.environ.get("TRITON_INTERPRET", "0") != "0":
        raise InputError("TRITON_INTERPRET is set: interpreted kernels are not compiled; unset it")
    if version_of("triton") is None:
        raise InputError("triton is not installed, so that nothing can be compiled: pip install triton")
    found = arguments.nvcc or shutil.which("nvcc")
    nvcc = Path(found) if found else None
    if arguments.gsplat is not None and not (arguments.gsplat / SOURCES / "csrc").is_dir():
        raise InputError(
            f"{arguments.gsplat}: give the folder that holds {SOURCES / 'csrc'}, gsplat's unpacked wheel"
        )
    if arguments.gsplat is not None and nvcc is None:
        raise InputError("there is no nvcc on the PATH to compile gsplat with: give --nvcc PATH")
    if arguments.json is not None:
        check_output(arguments.json, arguments.overwrite)
    views = [] if arguments.lanes is None else read_lanes(arguments.lanes)

    def progress(name: str) -> None:
        if sys.stderr.isatty():
            print(f"compiling: {name}", file=sys.stderr)

    rows = count_ours(arguments.capability, progress)
    for peer in PEERS:
        rows += count_peer(peer, arguments.gsplat, nvcc, arguments.capability, progress)
    by = [f"triton {version_of('triton')}"]
    if arguments.gsplat is not None and nvcc is not None:
        by.append(versions(arguments.gsplat, nvcc))
    record = {"capability": arguments.capability, "by": by, "rows": rows, "views": a_pixel(rows, views)}
    if arguments.json is not None:
        write_json(arguments.json, record, arguments.overwrite)
    return report(record)


if __name__ == "__main__":
    try:
        print(main())
    except Unavailable as error:
        sys.exit(str(error))
    except ScoupError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
