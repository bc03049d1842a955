"""The process that measures: one stage after the other, each told of as it goes.

It is a process of its own because a kernel that goes wrong can leave a device that answers nothing more: the stages
left then go on in another.
"""

from __future__ import annotations

import importlib
import os
import signal
import traceback
import warnings
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

from benchmarks.gpu.sizes import Sizes

STAGES: dict[str, tuple[str, str]] = {
    "agreement": ("agreement:agreement", "Agreement with the reference on a small view"),
    "rendering": ("rendering:main_view", "Rendering a view"),
    "sums": ("region_sums:region_sums", "Region sums and vote"),
    "building": ("building:building", "The whole build"),
    "precision": ("precision:precision", "Precision of the products"),
    "ceilings": ("ceilings:ceilings", "What the device can do"),
    "roofline": ("roofline:roofline", "Kernels against the ceilings"),
    "large": ("rendering:large_view", "Rendering a large view"),
    "scaling": ("scaling:scaling", "Growth"),
    "tuning": ("tuning:tuning", "Other numbers for the kernels"),
}
"""By name: module and function, and the heading of its table; in the order they run, what matters most first."""
UNTIMED = ("agreement",)  # may run while something else keeps the processors busy
LOST = 3  # exit code: the device is lost


def work_through(
    names: Sequence[str],
    sizes: Sizes,
    interpreted: bool,
    deadline: float,
    ceilings: dict[str, float],
    to: Connection,
    left_out: dict[str, dict[str, str]] | None = None,
    no_peer: str = "",
) -> None:
    """Run stages; the entry of the process.

    Sends ("begin", name), then ("doing", name, what) before everything that may break the device or hang,
    ("save", name, result) as often as there is more, and ("end", name, result). A process that has lost the device ends
    without the last.

    Args:
        names: of the stages.
        sizes: of everything.
        interpreted: with interpreted kernels, on the CPU.
        deadline: seconds since the epoch.
        ceilings: measured before, where an earlier process did.
        to: where to send.
        left_out: by stage, what must not run, and why.
        no_peer: why gsplat is not used.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    if interpreted:
        from benchmarks.gpu.interpreting import interpret_kernels

        interpret_kernels()  # before triton is imported
    import torch

    from benchmarks.gpu.context import Context
    from benchmarks.gpu.timing import DeviceLost, reason

    if interpreted:
        warnings.filterwarnings("ignore", category=RuntimeWarning)  # of numpy, in the interpreter
    device = torch.device("cpu" if interpreted else "cuda")
    name = ""

    def save(result: dict[str, Any]) -> None:
        to.send(("save", name, result))

    def tell(what: str) -> None:
        to.send(("doing", name, what))

    context = Context(device, sizes, deadline, save, tell, no_peer=no_peer, ceilings=dict(ceilings))
    for name in names:
        context.left_out = (left_out or {}).get(name, {})
        try:
            context.begin()
        except DeviceLost:  # by what the last stage left running: the next is not to blame
            to.close()
            os._exit(LOST)
        to.send(("begin", name))
        if context.time_is_up():
            to.send(("end", name, {"rows": [], "reason": "no time was left"}))
            continue
        module, function = STAGES[name][0].split(":")
        try:
            getattr(importlib.import_module(f"benchmarks.gpu.{module}"), function)(context)
            to.send(("end", name, context.result))
        except Exception as error:
            failed = {
                **context.result,
                "reason": reason(error),
                "traceback": traceback.format_exc()[-3000:],
            }
            try:
                lost = isinstance(error, DeviceLost)
                context.clock.recover()
            except DeviceLost:
                lost = True
            to.send(("save" if lost else "end", name, failed))
            if lost:
                to.close()
                os._exit(LOST)  # an orderly end would wait for the device
    to.close()
