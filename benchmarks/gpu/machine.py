"""Which device, which driver, which versions."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
from typing import Any

import torch

from scoup.bench import describe_environment


def describe_machine() -> dict[str, Any]:
    """For JSON: what ``describe_environment`` tells, and of the GPU all that times depend on."""
    found = describe_environment()
    found["versions"] = {name: version_of(name) for name in ("torch", "triton", "gsplat", "numpy")}
    found["cuda"] = torch.version.cuda
    found["hip"] = torch.version.hip
    found["driver"] = driver_version()
    found["device"] = None
    if torch.cuda.is_available():
        of = torch.cuda.get_device_properties(0)
        found["device"] = {
            "name": of.name,
            "multiprocessors": of.multi_processor_count,
            "memory_bytes": of.total_memory,
            "compute_capability": f"{of.major}.{of.minor}",
        }
    return found


def version_of(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def driver_version() -> str | None:
    """Of the GPU's driver; None where its tool is not there."""
    for command in (["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"],):
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        except (OSError, subprocess.SubprocessError):
            continue
        if done.returncode == 0 and done.stdout.strip():
            return done.stdout.strip().splitlines()[0]
    return None


def slug(name: str) -> str:
    """A device's name as part of a file's."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
