"""CLIP and SigLIP image models: crops to unit vectors, through transformers or open_clip."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.base.errors import ScoupError
from scoup.models.hub import OPEN_CLIP, first_line, load_local_first, open_clip_names
from scoup.models.sam import image_normalization

_CLIP = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))
_HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
_WITHOUT = "or use --embedder colors, which needs no model"


class ImageModel:
    """An image tower.

    Args:
        name: id of the model, as text encoders are asked for.
        revision: commit it was loaded from, "" if there is none.
        encode: normalised pixels [B, 3, side, side] in ``dtype`` -> [B, D].
        side: of its images.
        normalization: mean and standard deviation of its images, of RGB 0..1.
        device, dtype: of the model.
    """

    def __init__(
        self,
        name: str,
        revision: str,
        encode: Callable[[Tensor], Tensor],
        side: int,
        normalization: tuple[tuple[float, ...], tuple[float, ...]],
        device: torch.device | str,
        dtype: torch.dtype,
    ) -> None:
        self.name = name
        self.side = side
        self._encode = encode
        self._device, self._dtype = torch.device(device), dtype
        self._mean, self._std = (torch.tensor(v, device=device).view(3, 1, 1) for v in normalization)
        self._record = {"embedder": name, "embedder_revision": revision, "embedder_side": side}
        self.dim = int(self.embed(torch.zeros(1, side, side, 3, dtype=torch.uint8)).shape[1])

    def record(self) -> dict[str, Any]:
        """What decides the result, as plain values for the manifest."""
        return dict(self._record)

    def embed(self, crops: Tensor) -> Tensor:
        """[B, D] float32 unit vectors of crops [B, side, side, 3] uint8."""
        pixels = crops.to(self._device).permute(0, 3, 1, 2).float() / 255
        with torch.inference_mode():
            features = self._encode(((pixels - self._mean) / self._std).to(self._dtype))
        return functional.normalize(features.float(), dim=1).clone()


def open_image_model(
    name: str, revision: str | None = None, device: torch.device | str = "cpu"
) -> ImageModel:
    """Load an image model; in 16 bits on a GPU.

    Args:
        name: a folder or hub id of a CLIP or SigLIP model, or "open_clip:ARCHITECTURE/PRETRAINED".
        revision: branch, tag or commit of a hub model; the commit found is recorded.

    Raises:
        ScoupError: a package, the weights (safetensors) or a part of them are not there.
    """
    dtype = torch.float16 if torch.device(device).type == "cuda" else torch.float32
    if name.startswith(OPEN_CLIP):
        return _open_open_clip(name, device, dtype)
    try:
        import transformers
    except ImportError as error:
        raise ScoupError(
            f"embedder {name!r} needs the package transformers: pip install 'scoup[models]', {_WITHOUT}"
        ) from error

    def load(options: dict[str, Any]) -> Any:
        return (*_load(transformers, name, options), image_normalization(name, options))

    failed = f"embedder {name!r} cannot be loaded"
    try:
        config, model, loading, normalization = load_local_first(load, name, revision)
    except Exception as error:  # hub, network, JSON and safetensors each raise kinds of their own
        raise ScoupError(
            f"{failed} ({first_line(error)}); check the id, and fetch the weights (safetensors) while online, "
            f"{_WITHOUT}"
        ) from error
    is_clip = _is_clip(config)
    if not is_clip and not hasattr(model, "get_image_features"):
        raise ScoupError(f"{failed}: {config.model_type!r} models have no image features; use CLIP or SigLIP")
    missing = sorted(key for key in loading["missing_keys"] if not key.endswith("position_ids"))
    if missing:
        raise ScoupError(f"{failed}: its file lacks weights such as {missing[0]!r}; use a complete model")
    model = model.to(device=device, dtype=dtype).eval()

    def encode(pixels: Tensor) -> Tensor:
        if is_clip:
            return model(pixel_values=pixels).image_embeds
        features = model.get_image_features(pixel_values=pixels)
        return getattr(features, "pooler_output", features)  # transformers 5 gives an object

    side = int(getattr(config, "vision_config", config).image_size)
    commit = getattr(config, "_commit_hash", None) or revision or ""
    normalization = normalization or (_CLIP if is_clip else _HALF)
    return ImageModel(name, commit, encode, side, normalization, device, dtype)


def _is_clip(config: Any) -> bool:
    return config.model_type in ("clip", "clip_vision_model")


def _load(transformers: Any, model_id: str, options: dict[str, Any]) -> tuple[Any, Any, dict[str, Any]]:
    """Config, image model, and what transformers reports of loading it."""
    config = transformers.AutoConfig.from_pretrained(model_id, **options)
    wanted, kind = config, transformers.AutoModel
    if _is_clip(config):
        kind = transformers.CLIPVisionModelWithProjection
        wanted = getattr(config, "vision_config", config)
        # The size of the projection is written twice, and only the outer one is always right.
        wanted.projection_dim = config.projection_dim
    # Safetensors only: loading a pickled checkpoint runs whatever it contains.
    model, loading = kind.from_pretrained(
        model_id, config=wanted, use_safetensors=True, output_loading_info=True, **options
    )
    return config, model, loading


def _open_open_clip(text: str, device: torch.device | str, dtype: torch.dtype) -> ImageModel:
    architecture, pretrained = open_clip_names(text)
    try:
        import open_clip  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ScoupError(
            f"embedder {text!r} needs the package open_clip: pip install 'scoup[open-clip]', {_WITHOUT}"
        ) from error
    try:
        model = open_clip.create_model(architecture, pretrained=pretrained, device=device).to(dtype).eval()
    except Exception as error:  # as above
        raise ScoupError(
            f"embedder {text!r} cannot be loaded ({first_line(error)}); check the id, and fetch the weights "
            f"while online, {_WITHOUT}"
        ) from error
    visual = model.visual
    side = visual.image_size if isinstance(visual.image_size, int) else visual.image_size[0]
    normalization = (
        tuple(getattr(visual, "image_mean", None) or _CLIP[0]),
        tuple(getattr(visual, "image_std", None) or _CLIP[1]),
    )
    return ImageModel(text, "", model.encode_image, int(side), normalization, device, dtype)
