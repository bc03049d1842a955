"""Dense image encoders exported to ONNX, such as RADIO or dino.txt: features of places in a text space."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from scoup.base.digests import file_sha256
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.models.hub import ONNX, ModelRequest
from scoup.models.image import WITHOUT_MODEL
from scoup.models.onnx_sam import open_session
from scoup.models.windows import mean_of_windows

_NEEDED = "export an encoder of square windows: pixels [1, 3, S, S] in 0..1 to features [1, D, h, h] or [1, h * h, D]"


@dataclass(frozen=True, eq=False)
class OnnxDenseModel:
    """An encoder with the methods of ``DenseModel``. A region is the mean of the unit vectors of its places."""

    name: str  # for the manifest, and of the table of texts
    sha256: str
    session: Any  # of ONNX Runtime
    side: int  # of a window, in pixels
    patch: int  # side of the square that one vector describes
    dim: int
    device: str = "cpu"

    def to_dict(self) -> dict[str, Any]:
        return {"embedder": self.name, "embedder_sha256": self.sha256, "embedder_pooling": "dense"}

    def tokens(self, image: Tensor) -> Tensor:
        """Return [h / patch, w / patch, D] float32 unit vectors; see ``DenseModel.tokens``."""

        def encode(windows: Tensor) -> Tensor:
            name = self.session.get_inputs()[0].name
            found = [self.session.run(None, {name: part[None].numpy()})[0] for part in windows]
            features = _tokens_of(torch.from_numpy(np.concatenate(found)).float())
            return functional.normalize(features.unflatten(1, (self.side // self.patch, -1)), dim=3)

        return functional.normalize(mean_of_windows(image, self.side, self.patch, encode), dim=2)

    def pool(self, tokens: Tensor, shares: Tensor) -> Tensor:
        """Return [N, D] float32 unit vectors of regions that have ``shares`` [N, h, w] of each place's area."""
        return functional.normalize(shares.flatten(1) @ tokens.flatten(0, 1), dim=1)


def open_onnx_dense(name: str) -> OnnxDenseModel:
    """Open "onnx:FILE", the export of a dense encoder. Scaling of pixels beyond 0..1 is part of the export.

    The first output is taken. The vectors of texts come from a table of words.
    """
    path = Path(name.removeprefix(ONNX))
    runtime = ModelRequest("embedder", name, WITHOUT_MODEL).package("onnxruntime", "onnx")
    if not path.is_file():
        raise MissingFileError(path, "there is no such file", "pass the ONNX file of a dense encoder")
    session = open_session(runtime, path)
    shape = session.get_inputs()[0].shape
    if len(session.get_inputs()) != 1 or len(shape) != 4 or shape[1] != 3 or not _is_square(shape):
        raise FileFormatError(path, f"takes {[item.shape for item in session.get_inputs()]}", _NEEDED)
    side = shape[3]
    zeros = np.zeros((1, 3, side, side), np.float32)
    try:
        found = session.run(None, {session.get_inputs()[0].name: zeros})[0]
    except Exception as error:  # the runtime has kinds of its own
        raise FileFormatError(path, f"cannot be run on {list(zeros.shape)}", _NEEDED) from error
    places = 0 if found.ndim not in (3, 4) else _tokens_of(torch.from_numpy(found)).shape[1]
    window = round(places**0.5)
    if places == 0 or window**2 != places or side % window:
        raise FileFormatError(path, f"returns {list(found.shape)}", _NEEDED)
    dim = found.shape[1] if found.ndim == 4 else found.shape[2]
    return OnnxDenseModel(
        f"{ONNX}{path.resolve().stem}", file_sha256(path), session, side, side // window, dim
    )


def _is_square(shape: list[Any]) -> bool:
    return isinstance(shape[3], int) and shape[2] == shape[3]


def _tokens_of(features: Tensor) -> Tensor:
    """Return [B, h * w, D] of features [B, D, h, w] or [B, h * w, D]."""
    return features.flatten(2).transpose(1, 2) if features.ndim == 4 else features
