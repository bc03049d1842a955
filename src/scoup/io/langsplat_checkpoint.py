"""Checkpoints of LangSplat and its relatives (chkpnt<step>.pth), one file a level.

LangSplatV2's have Gaussians with a codebook and logits of sparse codes: ZhaoYujie2002/LangSplatV2,
``scene/gaussian_model.py`` (``capture`` with features, 14 entries) and ``utils/vq_utils.py``
(``get_weights_and_indices``). LangSplat's have three numbers per Gaussian, codes of its autoencoder:
minghanqin/LangSplat, ``scene/gaussian_model.py`` (13 entries); those of Occam's LGS and Feature 3DGS embeddings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from scoup.base import FileFormatError
from scoup.io.splats.activation import trained_gaussians
from scoup.io.torch_file import float_tensor, float_tensors, load_torch
from scoup.scene import Gaussians

_WHAT = "a checkpoint of LangSplat or LangSplatV2 (chkpnt<step>.pth, trained with features)"
_WITHOUT_OBJECTS = "use the chkpnt<step>.pth that the training wrote"
# Entries of what is captured without features, and of LangSplatV2; between them one of features.
_PLAIN, _V2 = 12, 14
_SHAPES = {  # of a Gaussian; they come first, after the degree
    "xyz": (3,), "features_dc": (1, 3), "features_rest": (-1, 3), "scaling": (3,), "rotation": (4,), "opacity": (1,),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class LangSplatLevel:
    gaussians: Gaussians
    values: np.ndarray  # [N, V, L] float32 logits of the codes by each of V codebooks; or [N, D] features
    codebooks: np.ndarray | None  # [V, L, D] float32; None for features


def read_langsplat(path: str | Path) -> LangSplatLevel:
    """Read a checkpoint with torch's restricted loader: nothing in it is run."""
    path = Path(path)
    content = load_torch(path, _WHAT, _WITHOUT_OBJECTS, numpy_numbers=True)
    captured = content[0] if isinstance(content, (tuple, list)) and len(content) == 2 else None
    if not isinstance(captured, (tuple, list)) or len(captured) < _PLAIN:
        raise FileFormatError(path, "contains no captured Gaussians", f"it should be {_WHAT}")
    if len(captured) == _PLAIN:
        problem = "was saved without language features (12 entries)"
        raise FileFormatError(path, problem, "use a checkpoint of the training with --include_feature")
    raw = float_tensors(path, dict(zip(_SHAPES, captured[1:], strict=False)), _SHAPES, _WHAT)
    sh = np.concatenate([raw["features_dc"], raw["features_rest"]], axis=1)
    columns = (raw["xyz"], raw["rotation"], raw["scaling"], raw["opacity"][:, 0])
    gaussians, finite = trained_gaussians(path, *columns, sh, _WHAT)
    if len(captured) < _V2:
        # Feature 3DGS has them last, [N, 1, D].
        index = 7 if isinstance(captured[7], Tensor) and captured[7].dim() > 1 else _PLAIN
        value = captured[index]
        features = value.flatten(1) if isinstance(value, Tensor) and value.dim() == 3 else value
        rows = float_tensor(path, features, (len(finite), -1), "language_feature", _WHAT)[finite]
        return LangSplatLevel(gaussians, rows, None)
    count = len(finite)
    logits = float_tensor(path, captured[7], (count, -1), "language_feature_logits", _WHAT)
    codebooks = float_tensor(path, captured[8], (-1, -1, -1), "language_feature_codebooks", _WHAT)
    layers, size = codebooks.shape[:2]
    if not size or logits.shape[1] != layers * size:
        problem = f"has {logits.shape[1]} logits a Gaussian for {layers} codebooks of {size}"
        raise FileFormatError(path, problem, "the file is damaged; copy it again")
    if not (np.isfinite(logits).all() and np.isfinite(codebooks).all()):
        problem = "has logits or codebooks that are not finite"
        raise FileFormatError(path, problem, "the training diverged, or the file is damaged")
    return LangSplatLevel(gaussians, logits.reshape(count, layers, size)[finite], codebooks)
