"""SAM, MobileSAM, SAM 2 and SAM 3's tracker through transformers: three masks per point, levels s, m and l."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from scoup.base import MissingFileError, Registry, ScoupError, file_sha256, refuse_pointer
from scoup.models.entry import HubEntry, ModelEntry
from scoup.models.hub import ModelRequest, Pretrained, hub_file, load_pretrained
from scoup.models.image import multiplies_bfloat16
from scoup.models.mobile_sam import CHECKPOINT_URL, MOBILE_SAM_FILE, sam_of_checkpoint
from scoup.models.normalization import HALF, IMAGENET, Normalization
from scoup.models.sam_decoder import SharedDecoder

MOBILE_SAM = "mobile-sam"
WITHOUT_MODEL = "pass `segmenter='felzenszwalb'`, which needs no model"
_CLASSES = {"sam3": "Sam3TrackerModel", "sam2": "Sam2Model", "sam": "SamModel"}


class EncodedImage(Protocol):
    """An image after the image encoder of a model. Masks are logits: above 0 is inside."""

    def predict(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [P, 3, h, w] and predicted IoU [P, 3] for points [P, 2] in pixels x, y."""
        ...

    def without_padding(self, logits: Tensor) -> Tensor:
        """Return the part of low-resolution masks [N, h, w] that shows the image."""
        ...

    def upscale(self, logits: Tensor) -> Tensor:
        """Return low-resolution masks [N, h, w] at the size of the image, [N, H, W]."""
        ...


class PointModel(Protocol):
    """A model that predicts masks from points."""

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as plain values for the manifest."""
        ...

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        """Run the image encoder on an image [H, W, 3]."""
        ...


@dataclass(frozen=True, eq=False)
class SamImage:
    """An image scaled to the model's square by its longer side, and padded below or on the right."""

    decode: Callable[[Tensor], tuple[Tensor, Tensor]]  # of points [P, 2] in pixels of the model's square
    side: int  # of that square
    size: tuple[int, int]  # of the image
    scaled: tuple[int, int]  # within the model's square

    def predict(self, points: Tensor) -> tuple[Tensor, Tensor]:
        (height, width), (high, wide) = self.size, self.scaled
        return self.decode(points * torch.tensor([wide / width, high / height], dtype=torch.float64))

    def without_padding(self, logits: Tensor) -> Tensor:
        high, wide = (
            max(1, round(length * whole / self.side))
            for length, whole in zip(self.scaled, logits.shape[-2:], strict=True)
        )
        return logits[..., :high, :wide]

    def upscale(self, logits: Tensor) -> Tensor:
        factor = self.side // logits.shape[-1]
        # A pixel beyond the image too, from which its last pixels are interpolated.
        rows, columns = (min(-(-length // factor) + 1, logits.shape[-1]) for length in self.scaled)
        square = _resize(logits[..., :rows, :columns], (factor * rows, factor * columns))
        return _resize(square[..., : self.scaled[0], : self.scaled[1]], self.size)


@dataclass(frozen=True, eq=False)
class Sam2Image(SamImage):
    """An image stretched over the model's whole square."""

    def upscale(self, logits: Tensor) -> Tensor:
        return _resize(logits, self.size)


@dataclass(frozen=True, eq=False)
class Sam:
    """A SAM model of any generation."""

    model: Any  # of transformers, in evaluation mode
    name: str  # id for the manifest
    revision: str  # commit it was loaded from, "" if unknown
    side: int  # of its square images, in pixels
    stretches: bool  # images are stretched to the square (SAM 2 and 3), not padded (SAM)
    normalization: Normalization
    half: bool = False  # run in 16 bits on a GPU
    sha256: str = ""  # of a checkpoint that is a file; "" for a model of a commit

    @property
    def device(self) -> torch.device:
        return next(self.model.parameters()).device

    @property
    def _dtype(self) -> torch.dtype:
        return next(self.model.vision_encoder.parameters()).dtype

    def to_dict(self) -> dict[str, Any]:
        checked = {"segmenter_sha256": self.sha256} if self.sha256 else {}
        return {"segmenter": self.name, "segmenter_revision": self.revision, **checked}

    def encode(self, image: NDArray[np.uint8]) -> EncodedImage:
        scaled = scale_to_square(image, self.side, self.stretches)
        values = self.normalization(torch.from_numpy(scaled).permute(2, 0, 1) / 255)
        values = functional.pad(values, (0, self.side - scaled.shape[1], 0, self.side - scaled.shape[0]))
        with torch.inference_mode(), self._precision():
            embeddings = self.model.get_image_embeddings(values[None].to(self.device, self._dtype))
        size = (scaled.shape[0], scaled.shape[1])
        kind = Sam2Image if self.stretches else SamImage
        return kind(self._decoder(embeddings, size), self.side, (image.shape[0], image.shape[1]), size)

    def _decoder(self, embeddings: Any, scaled: tuple[int, int]) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
        if self.stretches or self.device.type != "cpu":
            return partial(self.predict, embeddings)
        # A token beyond the image too, from which its last pixels are interpolated.
        patch = self.side // embeddings.shape[-1]
        rows, columns = (
            min(-(-length // patch) + 1, whole)
            for length, whole in zip(scaled, embeddings.shape[-2:], strict=True)
        )
        return SharedDecoder(self.model, embeddings, (rows, columns)).predict

    def predict(self, embeddings: Any, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [P, 3, h, w] and predicted IoU [P, 3] for points [P, 2] in pixels of the model's square."""
        prompts = points.float().to(self.device)[None, :, None]  # [1, P, 1, 2]
        with torch.inference_mode(), self._precision():
            output = self.model(
                image_embeddings=embeddings,
                input_points=prompts,
                input_labels=torch.ones(prompts.shape[:3], dtype=torch.int32, device=self.device),
                multimask_output=True,
            )
        return output.pred_masks[0].float(), output.iou_scores[0].float()

    def _precision(self) -> AbstractContextManager[Any]:
        half = self.half and self.device.type == "cuda"
        return torch.autocast("cuda", torch.float16) if half else nullcontext()


def scale_to_square(image: NDArray[np.uint8], side: int, stretches: bool) -> NDArray[np.uint8]:
    """Stretch an image [H, W, 3] over a square, or scale it to the square by the longer side."""
    from PIL import Image

    height, width = image.shape[:2]
    high = wide = side
    if not stretches:
        factor = side / max(height, width)
        high, wide = max(1, int(height * factor + 0.5)), max(1, int(width * factor + 0.5))
    # Reduced with Pillow, as the models' own code does: its filter covers every pixel.
    return np.array(Image.fromarray(image).resize((wide, high), Image.Resampling.BILINEAR))


def open_sam(
    name: str,
    revision: str | None = None,
    device: torch.device | str = "cpu",
    half: bool = False,
    model_id: str = "",
) -> Sam:
    """Load a SAM model: MobileSAM by name or path of its checkpoint (.pt), or a folder or hub id, for which ``name``
    may be short."""
    if name == MOBILE_SAM or name.endswith((".pt", ".pth")):
        return _open_mobile_sam(name, revision, device, half)
    model_id = model_id or name

    def load(files: Pretrained) -> Sam:
        kind = files.config.model_type
        generation = kind.split("_", 1)[0]  # a video model's file contains the image model, too
        if generation not in _CLASSES:
            raise ScoupError(f"{kind!r} is not a SAM model; use SAM, SAM 2 or SAM 3")
        model = files.model(getattr(files.transformers, _CLASSES[generation]))
        # The config of a video model holds that of the image model; the loaded model has its own.
        side = model.config.prompt_encoder_config.image_size
        side = int(side if isinstance(side, int) else side[0])
        normalization = files.normalization() or (HALF if kind.startswith("sam3") else IMAGENET)
        if kind == "sam":
            reduce_precision(model, device, half)
        return Sam(model.to(device), model_id, files.commit, side, kind != "sam", normalization, half)

    return load_pretrained(ModelRequest("segmenter", name, WITHOUT_MODEL, model_id, revision), load)


def _open_mobile_sam(name: str, revision: str | None, device: torch.device | str, half: bool) -> Sam:
    by_hand = f"fetch {CHECKPOINT_URL} elsewhere and pass the path of the file instead of the name"
    if name != MOBILE_SAM and not Path(name).is_file():
        raise MissingFileError(name, "there is no such checkpoint", by_hand)
    request = ModelRequest("segmenter", name, WITHOUT_MODEL, MOBILE_SAM_FILE[0], revision, by_hand)
    transformers = request.package("transformers", "models")
    path = hub_file(request, MOBILE_SAM_FILE[1]) if name == MOBILE_SAM else Path(name)
    refuse_pointer(path)
    try:
        model = sam_of_checkpoint(transformers, path)
        sha256 = file_sha256(path)
    except ScoupError as error:
        raise request.unusable(str(error)) from error
    except Exception as error:  # torch raises nearly everything for damaged and foreign files
        raise request.unreadable(error) from error
    reduce_precision(model, device, half)
    side = int(model.config.prompt_encoder_config.image_size)
    return Sam(model.to(device), MOBILE_SAM, "", side, False, IMAGENET, half, sha256)


def reduce_precision(model: Any, device: torch.device | str, half: bool) -> None:
    """Turn a ``SamModel`` to bfloat16 on a CPU that multiplies it, except the predicted IoU, which decides masks.

    As 16 bits of a GPU, they are no setting: machines of both kinds may make the views of one folder.
    """
    if half and multiplies_bfloat16(device):
        model.vision_encoder.bfloat16()
        model.mask_decoder.bfloat16().iou_prediction_head.float()


def _resize(logits: Tensor, size: tuple[int, int]) -> Tensor:
    return functional.interpolate(logits[:, None], size, mode="bilinear", align_corners=False)[:, 0]


def segmenter_table(open: Callable[..., Any], *others: ModelEntry) -> Registry[ModelEntry]:
    """Return the table of segmenters: SAM models, which ``open`` opens, and others."""

    def sam(name: str, hub_id: str, help: str, size: str, licence: str = "Apache-2.0") -> ModelEntry:
        file = (f"facebook/{hub_id}", "model.safetensors")
        return ModelEntry(name, open, size=size, file=file, help=help, licence=licence, extra="models")

    return Registry("segmenter", "scoup.segmenters", ModelEntry, (
        ModelEntry(
            MOBILE_SAM, open, size="41 MB", seconds=5.1, file=MOBILE_SAM_FILE, licence="Apache-2.0", extra="models",
            help="MobileSAM: the default without a GPU (8.5 s without AVX-512 BF16)",
        ),
        sam("sam-vit-b", "sam-vit-base", "SAM ViT-B", "375 MB"),
        sam("sam-vit-l", "sam-vit-large", "SAM ViT-L", "1.2 GB"),
        sam("sam-vit-h", "sam-vit-huge", "SAM ViT-H, as LangSplat: the default on a GPU", "2.6 GB"),
        sam("sam2.1-tiny", "sam2.1-hiera-tiny", "SAM 2.1 Hiera-T", "156 MB"),
        sam("sam2.1-small", "sam2.1-hiera-small", "SAM 2.1 Hiera-S", "184 MB"),
        sam("sam2.1-base-plus", "sam2.1-hiera-base-plus", "SAM 2.1 Hiera-B+", "323 MB"),
        sam("sam2.1-large", "sam2.1-hiera-large", "SAM 2.1 Hiera-L", "898 MB"),
        sam("sam3", "sam3", "the tracker of SAM 3, which takes points", "1.8 GB", "SAM License"),
        HubEntry("FOLDER or hub id", open, help="any SAM, SAM 2 or SAM 3 of transformers", extra="models"),
        *others,
    ))  # fmt: skip
