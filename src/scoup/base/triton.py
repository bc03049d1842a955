"""Whether the Triton kernels can serve on this machine. Imports triton, but only when asked."""

from __future__ import annotations

import re

import torch

OLDEST_TRITON = (3, 3)  # 3.0 to 3.2 end the process while they compile the kernels
LEAST_CAPABILITY = (8, 0)  # older GPUs have too little shared memory for a program


def why_not(device: torch.device) -> str | None:
    """One sentence: why the kernels cannot serve tensors on this device. None if they can."""
    try:
        import triton
    except ImportError:
        return "triton is not installed (pip install triton)"
    if _numbers(triton.__version__) < OLDEST_TRITON:
        return f"triton {triton.__version__} is too old, 3.3 is needed: update torch to 2.7 or newer"
    if device.type == "cuda" and torch.version.hip is None:
        capability = torch.cuda.get_device_capability(device)
        if capability < LEAST_CAPABILITY:
            found, needed = (".".join(map(str, numbers)) for numbers in (capability, LEAST_CAPABILITY))
            return f"{device} has compute capability {found}, the kernels need {needed} (Ampere) or newer"
    return None


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, re.findall(r"\d+", version)[:2]))
