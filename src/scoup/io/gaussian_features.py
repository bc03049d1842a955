"""Features of Gaussians in an array of numpy or a tensor of torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError
from scoup.io.npy import open_npy
from scoup.io.torch_file import load_torch


def read_features(path: str | Path) -> np.ndarray:
    """Read features, one row per Gaussian: [N, D], or [N, S, D] of S levels, of an .npy (mapped into memory), or a .pt
    or .pth with one tensor."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        features = open_npy(path, "features of Gaussians")
    elif suffix in (".pt", ".pth"):
        save = "save the tensor alone: torch.save(features, path)"
        content = load_torch(path, "a tensor of features", save)
        if not isinstance(content, Tensor) or content.layout != torch.strided:
            raise FileFormatError(path, "does not contain a tensor", save)
        if content.numel() * content.element_size() > path.stat().st_size:
            raise FileFormatError(path, "claims more numbers than it contains", "save the tensor again")
        features = content.detach().float().numpy()
    else:
        remedy = "use .npy or .pt with [Gaussians, dimensions]"
        raise FileFormatError(path, "is not an array of features", remedy)
    if features.dtype.kind != "f" or features.ndim not in (2, 3) or 0 in features.shape:
        problem = f"is {features.dtype} {list(features.shape)}, expected floats [N, D] or [N, levels, D]"
        raise FileFormatError(path, problem, "save one row per Gaussian")
    return features
