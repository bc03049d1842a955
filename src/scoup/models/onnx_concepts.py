"""Detectors with words exported to ONNX as pairs of files, run by ONNX Runtime on the CPU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.digests import file_sha256
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.models.concepts import WITHOUT_MODEL, best_boxes, corners
from scoup.models.hub import ONNX, ModelRequest
from scoup.models.onnx_sam import open_session
from scoup.models.sam import scale_to_square
from scoup.scene.names import Detections

FILES = ("image.onnx", "text.onnx", "tokenizer.json")
_NEEDED = (
    "export image.onnx from pixels [1, 3, S, S] in 0..1 to boxes [1, P, 4] (centre and size, as shares of the square), "
    "embeddings [1, P, D], shift and scale [1, P, 1]; and text.onnx from ids [Q, L] to embeddings [Q, D]"
)


@dataclass(frozen=True, eq=False)
class OnnxConcepts:
    """A pair of ONNX models. The logit of a box and a text is (their cosine + shift) * scale, as of OWLv2."""

    image: Any  # a session of ONNX Runtime, as the next
    text: Any
    tokenizer: Any
    name: str
    sha256: tuple[str, ...]
    side: int  # of the model's square, in pixels
    known: dict[tuple[str, ...], Tensor] = field(default_factory=dict)  # texts that were encoded last

    def to_dict(self) -> dict[str, Any]:
        return {"concepts": self.name, "concepts_sha256": list(self.sha256)}

    def detect(self, image: NDArray[np.uint8], texts: Sequence[str]) -> Detections:
        height, width = image.shape[:2]
        scaled = scale_to_square(image, self.side, stretches=False)
        square = np.zeros((1, 3, self.side, self.side), np.float32)
        square[0, :, : scaled.shape[0], : scaled.shape[1]] = scaled.transpose(2, 0, 1) / np.float32(255)
        found = self.image.run(None, {self.image.get_inputs()[0].name: square})
        boxes, rows, shift, scale = (torch.from_numpy(each[0]).float() for each in found)
        cosines = torch.nn.functional.normalize(rows, dim=1) @ self._encoded(tuple(texts)).T
        scores = ((cosines + shift) * scale).sigmoid()
        return best_boxes(corners(boxes) * max(height, width), scores, (width, height))

    def _encoded(self, texts: tuple[str, ...]) -> Tensor:
        if texts not in self.known:
            self.known.clear()
            wanted = self.text.get_inputs()[0]
            length = wanted.shape[1] if isinstance(wanted.shape[1], int) else None
            self.tokenizer.enable_padding(length=length)
            if length is not None:
                self.tokenizer.enable_truncation(length)
            ids = np.array([each.ids for each in self.tokenizer.encode_batch(list(texts))], np.int64)
            (vectors,) = self.text.run(None, {wanted.name: ids})
            self.known[texts] = torch.nn.functional.normalize(torch.from_numpy(vectors).float(), dim=1)
        return self.known[texts]


def open_onnx_concepts(name: str) -> OnnxConcepts:
    """Open "onnx:FOLDER" with image.onnx, text.onnx and tokenizer.json. Images are padded below and on the right."""
    folder = Path(name.removeprefix(ONNX))
    request = ModelRequest("model with words", name, WITHOUT_MODEL)
    runtime, tokenizers = request.package("onnxruntime", "onnx"), request.package("tokenizers", "onnx")
    paths = [folder / file for file in FILES]
    for path in paths:
        if not path.is_file():
            raise MissingFileError(path, "there is no such file", f"the folder needs {', '.join(FILES)}")
    image, text = (open_session(runtime, path) for path in paths[:2])
    shape = image.get_inputs()[0].shape
    if len(shape) != 4 or not isinstance(shape[3], int) or len(image.get_outputs()) != 4:
        raise FileFormatError(paths[0], f"takes {shape} and has {len(image.get_outputs())} outputs", _NEEDED)
    if len(text.get_inputs()) != 1 or len(text.get_outputs()) != 1:
        raise FileFormatError(paths[1], "is not a model from ids to embeddings", _NEEDED)
    try:
        tokenizer = tokenizers.Tokenizer.from_file(str(paths[2]))
    except Exception as error:  # the package raises Exception itself
        raise FileFormatError(
            paths[2], f"is not a tokenizer ({error})", "export it with the model"
        ) from error
    return OnnxConcepts(
        image, text, tokenizer, f"{ONNX}{folder.name}", tuple(map(file_sha256, paths)), int(shape[3])
    )
