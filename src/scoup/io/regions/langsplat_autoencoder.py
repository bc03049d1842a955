"""LangSplat's autoencoder (best_ckpt.pth): from the three numbers of ``language_features_dim3`` back to embeddings.

Read from minghanqin/LangSplat, ``autoencoder/model.py``: the decoder is linear layers with ReLU between them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, InputError
from scoup.io.torch_file import float_tensor, load_torch

_WHAT = "LangSplat's autoencoder (best_ckpt.pth, a state_dict)"
_WEIGHT = re.compile(r"decoder\.(\d{1,3})\.weight")
_AT_A_TIME = 4096

Decoder = Callable[[np.ndarray], np.ndarray]
"""[R, C] numbers of regions to [R, D] float32 unit embeddings; zero rows stay."""


def read_autoencoder(path: str | Path) -> Decoder:
    """Return the decoder in a checkpoint, read with torch's restricted loader."""
    path = Path(path)
    content = load_torch(path, _WHAT, "use the best_ckpt.pth that LangSplat's train.py wrote")
    names = content if isinstance(content, dict) else {}
    numbers = sorted(int(matched[1]) for name in names if (matched := _WEIGHT.fullmatch(str(name))))
    if not numbers:
        raise FileFormatError(path, "contains no layers of a decoder", f"it should be {_WHAT}")
    layers: list[tuple[np.ndarray, np.ndarray]] = []
    for number in numbers:
        weight = float_tensor(
            path, names[f"decoder.{number}.weight"], (-1, -1), f"decoder.{number}.weight", _WHAT
        )
        bias_name = f"decoder.{number}.bias"
        bias = float_tensor(path, names.get(bias_name), (len(weight),), bias_name, _WHAT)
        if layers and weight.shape[1] != len(layers[-1][0]):
            problem = f"decoder.{number} takes {weight.shape[1]} numbers, the layer before gives {len(layers[-1][0])}"
            raise FileFormatError(path, problem, f"it should be {_WHAT}")
        layers.append((weight, bias))

    def decode(rows: np.ndarray) -> np.ndarray:
        if rows.shape[1] != layers[0][0].shape[1]:
            raise InputError(
                f"{path}: decodes rows of {layers[0][0].shape[1]} numbers, but the regions have {rows.shape[1]}; use "
                "the autoencoder of this scene, and its language_features_dim3"
            )
        blocks = [
            _decoded(rows[start : start + _AT_A_TIME], layers) for start in range(0, len(rows), _AT_A_TIME)
        ]
        return np.concatenate(blocks) if blocks else np.zeros((0, len(layers[-1][0])), np.float32)

    return decode


def _decoded(rows: np.ndarray, layers: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    values = np.asarray(rows, np.float64)
    for index, (weight, bias) in enumerate(layers):
        values = (np.maximum(values, 0) if index else values) @ weight.T + bias
    norms = np.linalg.norm(values, axis=1, keepdims=True)
    # LangSplat encodes unit rows only; one of zeros is a region without an embedding.
    known = (norms > 0) & np.asarray(rows).any(1, keepdims=True)
    return np.where(known, values / np.where(norms > 0, norms, 1), 0.0).astype(np.float32)
