"""The machine and the software of a measurement. Nothing here names a person, a folder or a host."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import torch

from scoup.base import VERSION, native_core

_CODE = (":/src", ":/native", ":/benchmarks")  # what can change a time; figures written into docs/ cannot


def describe_environment() -> dict[str, Any]:
    """Return machine, software and commit, for JSON."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": _cpu_model(),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": platform.system(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "cuda": torch.version.cuda or torch.version.hip,
        "triton": _version("triton"),
        "load": None if load is None else round(load, 2),
        "python": platform.python_version(),
        "torch": str(torch.__version__),
        "numpy": np.__version__,
        "scoup": VERSION,
        "native_instruction_set": _instruction_set(),
        "commit": _commit(),
    }


def in_one_line(environment: dict[str, Any]) -> str:
    """Return one line for the head of a table."""
    parts = [
        f"{environment['cpu']}, {environment['cores']} cores",
        environment["gpu"],
        f"torch {environment['torch']}",
        environment["gpu"] and f"Triton {environment['triton']}, CUDA {environment['cuda']}",
        environment["native_instruction_set"] and f"native core: {environment['native_instruction_set']}",
        environment["commit"] and f"commit {environment['commit']}",
    ]
    return "; ".join(text for text in parts if text)


def _cpu_model() -> str:
    try:
        named = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        named = None
    return named.group(1).strip() if named else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Return the commit of the checkout this file is run from, marked where the code has changed since."""
    here = Path(__file__).resolve().parent.parent
    # A package installed below somebody else's checkout is not of that checkout.
    if _git(here, "ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    commit = _git(here, "rev-parse", "--short=12", "HEAD")
    if commit is None:
        return None
    return commit + (" with changes" if _git(here, "status", "--porcelain", "--", *_CODE) else "")


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", *arguments],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _instruction_set() -> str | None:
    """Return the instruction set the compiled core uses; None where there is no core."""
    core = native_core()
    return None if core is None else str(core.current_isa())
