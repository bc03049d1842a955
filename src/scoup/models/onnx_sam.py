"""SAM and SAM 2 exported to ONNX as pairs of files, encoder and decoder, run by ONNX Runtime on the CPU.

Two layouts are read, told apart by the inputs' names. SAM: as exported by SAM's own code for the decoder
(image_embeddings, point_coords, point_labels, mask_input, has_mask_input, orig_im_size) and by samexporter and others
for the encoder, which takes an image [H, W, 3] in 0..255 or [1, 3, S, S] normalised. SAM 2: as exported by samexporter
(image -> image_embed, high_res_feats_0, high_res_feats_1; the decoder takes these, and points as above).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.digests import file_sha256
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.existing import refuse_pointer
from scoup.models.hub import ONNX, ModelRequest
from scoup.models.normalization import IMAGENET
from scoup.models.sam import (
    WITHOUT_MODEL,
    EncodedImage,
    Sam2Image,
    SamImage,
    normalize_and_pad,
    scale_to_square,
)

SIDE = 1024  # of the models' square, unless the encoder's input says another
_ENDINGS = (".onnx", ".ort")
_POINTS_AT_ONCE = 4  # more are slower on a CPU


@dataclass(frozen=True, eq=False)
class OnnxSam:
    """A pair of ONNX models, as sessions of ONNX Runtime."""

    encoder: Any
    decoder: Any
    name: str  # for the manifest
    sha256: tuple[str, str]  # of both files
    side: int  # of the models' square, in pixels

    @property
    def is_second(self) -> bool:
        """Return whether it is SAM 2, whose images are stretched over the whole square."""
        return _is_second(self.decoder)

    def to_dict(self) -> dict[str, Any]:
        return {"segmenter": self.name, "segmenter_sha256": list(self.sha256)}

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        scaled = scale_to_square(image, self.side, self.is_second)
        wanted = self.encoder.get_inputs()[0]
        if len(wanted.shape) == 4:
            values = normalize_and_pad(scaled, self.side, IMAGENET)[None].numpy()
        else:
            values = scaled
        kind = np.uint8 if "uint8" in wanted.type else np.float32
        found = self.encoder.run(None, {wanted.name: values.astype(kind)})
        outputs = dict(zip(_names(self.encoder.get_outputs()), found, strict=True))
        image_class = Sam2Image if self.is_second else SamImage
        size, within = image.shape[:2], scaled.shape[:2]
        return image_class(lambda points: self._predict(outputs, points), self.side, size, within)

    def _predict(self, outputs: dict[str, NDArray[Any]], points: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [P, 3, h, w] and predicted IoU [P, 3] for points [P, 2] in pixels of the square."""
        inputs = {item.name: item for item in self.decoder.get_inputs()}
        # A batch of another size than one is possible only where the export left it open.
        at_once = _POINTS_AT_ONCE if isinstance(inputs["point_coords"].shape[0], str) else 1
        parts = [self._decode(outputs, part.float().numpy(), inputs) for part in points.split(at_once)]
        return torch.cat([masks for masks, _ in parts]), torch.cat([iou for _, iou in parts])

    def _decode(
        self, outputs: dict[str, NDArray[Any]], points: NDArray[np.float32], inputs: dict[str, Any]
    ) -> tuple[Tensor, Tensor]:
        count = len(points)
        coordinates, labels = points[:, None], np.ones((count, 1), np.float32)
        if not self.is_second:  # in SAM's export the caller says that there is no box
            coordinates = np.concatenate([coordinates, np.zeros_like(coordinates)], axis=1)
            labels = np.concatenate([labels, -labels], axis=1)
        side = self.side // 4
        given = {
            "point_coords": coordinates,
            "point_labels": labels,
            "mask_input": np.zeros((count, 1, side, side), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            # The export enlarges masks to this size; those of low resolution are taken instead.
            "orig_im_size": np.array([side, side], np.float32),
        }
        given |= {name: value for name, value in outputs.items() if name in inputs}
        wanted = [_masks_name(self.decoder), "iou_predictions"]
        masks, iou = self.decoder.run(wanted, {name: given[name] for name in inputs})
        # The first of four is the mask for an unambiguous prompt; the three for a point follow it.
        return torch.from_numpy(masks[:, -3:]), torch.from_numpy(iou[:, -3:])


def open_onnx_sam(name: str) -> OnnxSam:
    """Open a pair of ONNX models: "onnx:FOLDER" with one encoder and one decoder (.onnx or .ort), by the files' names.

    Of a decoder for single and one for several masks, that for several is taken.
    """
    folder = Path(name.removeprefix(ONNX))
    runtime = ModelRequest("segmenter", name, WITHOUT_MODEL).package("onnxruntime", "onnx")
    if not folder.is_dir():
        raise MissingFileError(
            folder, "there is no such folder", "pass the folder of an encoder and a decoder"
        )
    paths = _model_file(folder, "encoder"), _model_file(folder, "decoder")
    encoder, decoder = (open_session(runtime, path) for path in paths)
    _check(paths, encoder, decoder)
    size = encoder.get_inputs()[0].shape[-1]
    side = size if isinstance(size, int) and size > 3 else SIDE
    first, second = map(file_sha256, paths)
    return OnnxSam(encoder, decoder, f"{ONNX}{folder.resolve().name}", (first, second), side)


def _model_file(folder: Path, role: str) -> Path:
    found = sorted(
        path
        for path in folder.iterdir()
        if path.is_file() and path.name.lower().endswith(_ENDINGS) and role in path.name.lower()
    )
    several = [path for path in found if "single" not in path.name.lower()] or found
    if len(several) != 1:
        problem = f"contains {len(several)} files named *{role}*.onnx or .ort, expected 1"
        raise MissingFileError(folder, problem, "keep only one encoder and its decoder in it")
    return several[0]


def open_session(runtime: Any, path: Path) -> Any:
    """Load an ONNX model, with as many threads as torch has."""
    refuse_pointer(path)
    options = runtime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 4  # errors are raised, not printed
    try:
        return runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime has kinds of its own
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
        raise FileFormatError(path, f"cannot be loaded ({reason})", "use an ONNX model") from error


def _check(paths: tuple[Path, Path], encoder: Any, decoder: Any) -> None:
    needed = set(_names(decoder.get_inputs())) - {"orig_im_size"} - set(_names(encoder.get_outputs()))
    if needed != {"point_coords", "point_labels", "mask_input", "has_mask_input"}:
        raise FileFormatError(
            paths[1],
            f"does not take its encoder's outputs (it takes {', '.join(_names(decoder.get_inputs()))})",
            "use a pair as SAM's own code or samexporter writes it",
        )
    outputs = {item.name: item for item in decoder.get_outputs()}
    masks = _masks_name(decoder)
    iou = outputs.get("iou_predictions")
    if masks not in outputs or iou is None:
        raise FileFormatError(paths[1], f"has no outputs {masks} and iou_predictions", "use another export")
    if isinstance(iou.shape[-1], int) and iou.shape[-1] < 3:
        raise FileFormatError(paths[1], "returns one mask per point", "use the export for several masks")


def _is_second(decoder: Any) -> bool:
    return "high_res_feats_0" in _names(decoder.get_inputs())


def _masks_name(decoder: Any) -> str:
    return "masks" if _is_second(decoder) else "low_res_masks"


def _names(items: Any) -> list[str]:
    return [item.name for item in items]
