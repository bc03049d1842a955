"""SAM, SAM 2 and SAM 3's tracker through transformers, asked with points; three masks an answer, s, m and l."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from scoup.base.errors import ScoupError
from scoup.models.hub import first_line, load_local_first

SHORT_NAMES = {
    "sam-vit-b": "facebook/sam-vit-base",
    "sam-vit-l": "facebook/sam-vit-large",
    "sam-vit-h": "facebook/sam-vit-huge",
    "sam2.1-tiny": "facebook/sam2.1-hiera-tiny",
    "sam2.1-small": "facebook/sam2.1-hiera-small",
    "sam2.1-base-plus": "facebook/sam2.1-hiera-base-plus",
    "sam2.1-large": "facebook/sam2.1-hiera-large",
    "sam3": "facebook/sam3",
}
_CLASSES = {"sam3": "Sam3TrackerModel", "sam2": "Sam2Model", "sam": "SamModel"}
_IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


class Looked(Protocol):
    """An image that a model has looked at. Masks are logits: above 0 is inside."""

    def ask(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Masks for points [P, 2] in pixels x, y: logits [P, 3, h, w] and predicted IoU [P, 3]."""
        ...

    def trim(self, logits: Tensor) -> Tensor:
        """The part of small masks [N, h, w] that shows the image: without the model's padding."""
        ...

    def enlarge(self, logits: Tensor) -> Tensor:
        """Small masks [N, h, w] at the size of the image, [N, H, W]."""
        ...


class PointModel(Protocol):
    """A model that answers points with masks."""

    def record(self) -> dict[str, Any]:
        """What decides the result, as plain values for the manifest."""
        ...

    def look(self, image: NDArray[np.uint8]) -> Looked:
        """Encode an image [H, W, 3]."""
        ...


@dataclass(frozen=True, eq=False)
class _LookedWithSam:
    """The image is scaled to the model's square by its longer side, and padded below or on the right."""

    model: SamPoints
    embeddings: Any
    size: tuple[int, int]  # of the image
    scaled: tuple[int, int]  # within the model's square

    def ask(self, points: Tensor) -> tuple[Tensor, Tensor]:
        (height, width), (high, wide) = self.size, self.scaled
        factor = torch.tensor([wide / width, high / height], dtype=torch.float64)
        return self.model.ask(self.embeddings, points * factor)

    def trim(self, logits: Tensor) -> Tensor:
        side = self.model.side
        high, wide = (
            max(1, round(length * whole / side))
            for length, whole in zip(self.scaled, logits.shape[-2:], strict=True)
        )
        return logits[..., :high, :wide]

    def enlarge(self, logits: Tensor) -> Tensor:
        side = self.model.side
        whole = _resized(logits, (side, side))
        return _resized(whole[..., : self.scaled[0], : self.scaled[1]], self.size)


@dataclass(frozen=True, eq=False)
class _LookedWithSam2(_LookedWithSam):
    """The image is stretched over the model's whole square."""

    def enlarge(self, logits: Tensor) -> Tensor:
        return _resized(logits, self.size)


class SamPoints:
    """A SAM model of any generation.

    Args:
        model: of transformers, in evaluation mode.
        name: id for the manifest.
        revision: commit it was loaded from, "" if there is none.
        side: of the square it takes, in pixels.
        stretches: whether images are stretched to the square (SAM 2 and 3), not padded (SAM).
        normalization: mean and standard deviation of its images, of RGB 0..1.
        half: encode images in 16 bits on a GPU.
    """

    def __init__(
        self,
        model: Any,
        name: str,
        revision: str,
        side: int,
        stretches: bool,
        normalization: tuple[tuple[float, ...], tuple[float, ...]],
        half: bool = False,
    ) -> None:
        self.model = model
        self.side = side
        self._stretches = stretches
        self._mean, self._std = (torch.tensor(values).view(3, 1, 1) for values in normalization)
        self._device = next(model.parameters()).device
        self._half = half and self._device.type == "cuda"
        self._record = {"segmenter": name, "segmenter_revision": revision}

    def record(self) -> dict[str, Any]:
        return dict(self._record)

    def look(self, image: NDArray[np.uint8]) -> Looked:
        from PIL import Image

        height, width = image.shape[:2]
        high = wide = self.side
        if not self._stretches:
            factor = self.side / max(height, width)
            high, wide = max(1, int(height * factor + 0.5)), max(1, int(width * factor + 0.5))
        # Reduced with Pillow, as the models' own code does: its filter looks at every pixel.
        scaled = Image.fromarray(image).resize((wide, high), Image.Resampling.BILINEAR)
        values = torch.from_numpy(np.array(scaled)).permute(2, 0, 1) / 255
        values = (values - self._mean) / self._std
        values = functional.pad(values, (0, self.side - wide, 0, self.side - high))
        with torch.inference_mode(), self._precision():
            embeddings = self.model.get_image_embeddings(values[None].to(self._device))
        looked = _LookedWithSam2 if self._stretches else _LookedWithSam
        return looked(self, embeddings, (height, width), (high, wide))

    def ask(self, embeddings: Any, points: Tensor) -> tuple[Tensor, Tensor]:
        """Logits [P, 3, h, w] and predicted IoU [P, 3] for points [P, 2] in pixels of the model's square."""
        prompts = points.float().to(self._device)[None, :, None]  # [1, P, 1, 2]
        with torch.inference_mode(), self._precision():
            answer = self.model(
                image_embeddings=embeddings,
                input_points=prompts,
                input_labels=torch.ones(prompts.shape[:3], dtype=torch.int32, device=self._device),
                multimask_output=True,
            )
        return answer.pred_masks[0].float(), answer.iou_scores[0].float()

    def _precision(self) -> AbstractContextManager[Any]:
        return torch.autocast("cuda", torch.float16) if self._half else nullcontext()


def open_point_model(
    name: str, revision: str | None = None, device: torch.device | str = "cpu", half: bool = False
) -> SamPoints:
    """Load a SAM model.

    Args:
        name: of ``SHORT_NAMES``, or a folder or hub id.
        revision: branch, tag or commit of a hub model; the commit found is recorded.
        half: encode images in 16 bits on a GPU.

    Raises:
        ScoupError: transformers, the weights (safetensors) or a part of them are not there.
    """
    model_id = SHORT_NAMES.get(name, name)
    try:
        import transformers
    except ImportError as error:
        raise ScoupError(
            f"segmenter {name!r} needs the package transformers: pip install 'scoup[models]', or use "
            "--segmenter felzenszwalb, which needs no model"
        ) from error

    def load(options: dict[str, Any]) -> Any:
        config = transformers.AutoConfig.from_pretrained(model_id, **options)
        kind = _class_of(transformers, config.model_type)
        model, loading = kind.from_pretrained(
            model_id, use_safetensors=True, output_loading_info=True, **options
        )
        return config, model, loading, _normalization(model_id, config.model_type, options)

    failed = f"segmenter {name!r} cannot be loaded"
    try:
        config, model, loading, normalization = load_local_first(load, model_id, revision)
    except ScoupError as error:
        raise ScoupError(f"{failed}: {error}") from error
    except Exception as error:  # hub, network, JSON and safetensors each raise kinds of their own
        raise ScoupError(
            f"{failed} ({first_line(error)}); check the id, and fetch the weights (safetensors) while online, or "
            "use --segmenter felzenszwalb, which needs no model"
        ) from error
    missing = sorted(loading["missing_keys"])
    if missing:
        raise ScoupError(f"{failed}: its file lacks weights such as {missing[0]!r}; use a complete model")
    commit = getattr(config, "_commit_hash", None) or revision or ""
    stretches = not _is_first(config.model_type)
    parts = getattr(model, "config", config)
    side = parts.prompt_encoder_config.image_size
    side = int(side if isinstance(side, int) else side[0])
    model = model.to(device).eval()
    return SamPoints(model, model_id, commit, side, stretches, normalization, half)


def _is_first(model_type: str) -> bool:
    return model_type == "sam"


def _class_of(transformers: Any, model_type: str) -> Any:
    """The class of a model by its config: also a video model's, whose file holds the image model too."""
    generation = model_type.split("_", 1)[0]
    if generation not in _CLASSES:
        raise ScoupError(f"{model_type!r} is no SAM model; use SAM, SAM 2 or SAM 3")
    kind = getattr(transformers, _CLASSES[generation], None)
    if kind is None:
        raise ScoupError(
            f"this transformers ({transformers.__version__}) has no {generation}; pip install -U it"
        )
    return kind


def _normalization(
    model_id: str, model_type: str, options: dict[str, Any]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    default = _HALF if model_type.startswith("sam3") else _IMAGENET
    return image_normalization(model_id, options) or default


def image_normalization(
    model_id: str, options: dict[str, Any]
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Mean and standard deviation from a model's preprocessor_config.json; None where it has no such file.

    Read here because transformers' own image processors need torchvision.
    """
    from transformers.utils.hub import cached_file

    try:
        path = cached_file(model_id, "preprocessor_config.json", **options)
    except OSError:
        return None
    if path is None:
        return None
    record = json.loads(Path(path).read_text(encoding="utf-8"))
    mean, std = record.get("image_mean"), record.get("image_std")
    sound = all(isinstance(item, list) and len(item) == 3 for item in (mean, std))
    return (tuple(map(float, mean)), tuple(map(float, std))) if sound else None


def _resized(logits: Tensor, size: tuple[int, int]) -> Tensor:
    return functional.interpolate(logits[:, None], size, mode="bilinear", align_corners=False)[:, 0]
