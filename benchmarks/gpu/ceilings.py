"""What the device can do at most, measured: bytes copied, float32 instructions, powers, tensor-core products.

An "instruction" is what one lane of the float32 pipeline does in one turn: a multiply-add, an addition, a comparison or
a selection each take one.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from functools import partial

import torch
import triton
import triton.language as tl
from torch import Tensor

from benchmarks.gpu.context import Context
from benchmarks.gpu.timing import Work
from scoup.raster.triton.projection import FUSED

COPY = "copied bytes (read and written)"
FLOAT32, FLOAT64, POWERS = "float32 instructions", "float64 instructions", "powers of two (float32)"
FP16, TF32 = "float16 tensor-core operations", "tf32 tensor-core operations"
UNITS = {COPY: "B/s", FLOAT32: "1/s", FLOAT64: "1/s", POWERS: "1/s", FP16: "1/s", TF32: "1/s"}

_BLOCK, _WARPS, _UNROLLED = 2048, 8, 16


@triton.jit(do_not_specialize=["rounds"])
def chain_kernel(
    values,  # [programs * BLOCK] float32 or float64: read and written
    factor,
    term,
    rounds,
    POWER: tl.constexpr,
    UNROLLED: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Multiply-adds, or powers of two, one after the other in every number; the numbers of a thread do not wait for
    each other.
    """
    place = values + tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    number = tl.load(place)
    for _ in range(rounds):
        for _step in tl.static_range(UNROLLED):
            if POWER:
                number = tl.exp2(-number)
            else:
                number = number * factor + term
    tl.store(place, number)


def ceilings(context: Context) -> None:
    """Rows in seconds, and the rates they amount to."""
    sizes, device = context.sizes, context.device
    source = torch.rand(sizes.ceiling_bytes // 4, device=device)
    target = torch.empty_like(source)
    edge, programs = sizes.ceiling_edge, chain_programs(device)
    numbers = torch.rand(programs * _BLOCK, device=device)
    rounds = max(1, sizes.ceiling_rounds // _UNROLLED)
    done = programs * _BLOCK * rounds * _UNROLLED
    short = max(1, rounds // 8)  # both are slower by far on most devices
    amounts = {
        COPY: 2 * 4 * source.numel(),
        FLOAT32: done,
        FLOAT64: done // rounds * short,
        POWERS: done // rounds * short,
        FP16: 2 * edge**3,
        TF32: 2 * edge**3,
    }
    works = [
        Work(COPY, partial(target.copy_, source)),
        Work(FLOAT32, partial(chain, numbers, rounds, False)),
        Work(FLOAT64, partial(chain, numbers.double(), short, False)),
        Work(POWERS, partial(chain, numbers.clone(), short, True)),
        Work(FP16, partial(multiply, *square_matrices(edge, torch.float16, device))),
        Work(TF32, partial(multiply, *square_matrices(edge, torch.float32, device))),
    ]
    rows = context.rows(works)
    for row in rows:
        if "median_s" in row:  # the best run: a ceiling is what can be reached
            row["rate"] = context.ceilings[row["name"]] = amounts[row["name"]] / row["min_s"]
    context.result["ceilings"] = context.ceilings
    context.save(context.result)


def chain_programs(device: torch.device) -> int:
    """Enough to fill every multiprocessor many times over."""
    if device.type != "cuda":
        return 2
    return 32 * torch.cuda.get_device_properties(device).multi_processor_count


def chain(numbers: Tensor, rounds: int, power: bool) -> None:
    """Launch ``chain_kernel``; 0.5 x + 0.25 stays near 0.5, and so does 2^-x near 0.64."""
    grid = (len(numbers) // _BLOCK,)
    chain_kernel[grid](
        numbers, 0.5, 0.25, rounds, POWER=power, UNROLLED=_UNROLLED, BLOCK=_BLOCK, num_warps=_WARPS, **FUSED
    )  # fmt: skip


def square_matrices(edge: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    one = torch.randn(edge, edge, device=device).to(dtype)
    return one, one.T.contiguous(), torch.empty_like(one)


def multiply(one: Tensor, other: Tensor, out: Tensor) -> None:
    """On the tensor cores, float32 as tf32."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    try:
        torch.mm(one, other, out=out)
    finally:
        torch.set_float32_matmul_precision(before)
