"""The choice of a backend: one guard and one loader for everything that has several.

A room with backends has a table of names and modules, all with the same functions:

* ``reference``: plain torch, any device; the specification that the others are tested against;
* ``native``: the compiled core, for tensors on a CPU;
* ``triton``: kernels for tensors on a GPU.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING

from scoup.base.errors import InputError, UnknownNameError, warn_once
from scoup.base.native import missing_reason, native_core, warn_if_missing

if TYPE_CHECKING:
    import torch

LEAST_CAPABILITY = (8, 0)  # older GPUs have too little shared memory for a program

_DEVICES = {"native": "cpu", "triton": "cuda"}  # torch calls AMD's GPUs "cuda", too


def load_backend(
    table: Mapping[str, str], device: torch.device, name: str | None = None, room: str = ""
) -> tuple[str, ModuleType]:
    """Return name and module of a backend of a table of modules for tensors on a device, by default the fastest
    (``default_backend``). ``room`` is what has these backends, for the error."""
    name = name or default_backend(device)
    if name not in table:
        raise UnknownNameError(f"{room} backend".strip(), name, table)
    require_backend(name, device)
    return name, importlib.import_module(table[name])


def default_backend(device: torch.device) -> str:
    """Return the fastest backend for tensors on a device. Warns once where the fast one cannot be used."""
    if device.type == "cuda":
        reason = triton_problem(device)
        if reason is None:
            return "triton"
        warn_once(f"tensors on a GPU take the slow reference path: {reason}")
    elif device.type == "cpu":
        if native_core() is not None:
            return "native"
        warn_if_missing()
    return "reference"


def serves(name: str, device: torch.device) -> bool:
    """Return whether a backend is for tensors on this device; whether this machine can run it is another matter."""
    interpreted = name == "triton" and os.environ.get("TRITON_INTERPRET") == "1"
    return interpreted or _DEVICES.get(name, device.type) == device.type


def require_backend(name: str, device: torch.device) -> None:
    """Refuse a backend that cannot be used for tensors on a device."""
    if not serves(name, device):
        hardware = "a GPU" if name == "triton" else "a CPU"
        raise InputError(f"the backend {name!r} serves tensors on {hardware}, these are on {device}")
    reason = None
    if name == "native" and native_core() is None:
        reason = missing_reason()
    elif name == "triton":
        reason = triton_problem(device)
    if reason is not None:
        raise InputError(f"the backend {name!r} cannot be used: {reason}")


def triton_problem(device: torch.device) -> str | None:
    """Return a sentence: why Triton kernels cannot serve tensors on this device. None if they can."""
    import torch

    try:
        import triton  # noqa: F401
    except ImportError:
        return "triton is not installed (pip install triton)"
    if device.type == "cuda" and torch.version.hip is None:
        capability = torch.cuda.get_device_capability(device)
        if capability < LEAST_CAPABILITY:
            actual, needed = (".".join(map(str, numbers)) for numbers in (capability, LEAST_CAPABILITY))
            return f"{device} has compute capability {actual}, the kernels need {needed} (Ampere) or newer"
    return None
