"""CLIP, SigLIP and TIPSv2 image models as dense encoders: a map of features of a photograph, pooled for any region.

CLIP: of the last layer's attention only values and output projection are used, without residual and perceptron, so that
each token keeps to its place (MaskCLIP: Zhou et al., "Extract Free Dense Labels from CLIP", ECCV 2022). TIPSv2: the
same with residual and perceptron, as its authors segment. A region is the mean of its tokens' unit vectors. SigLIP: the
pooling head of the image attends to the tokens of the region alone (Xiao et al., "TextRegion", 2025).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from scoup.base import ScoupError
from scoup.models.entry import DENSE_PREFIX
from scoup.models.hub import ModelRequest, Pretrained, load_pretrained
from scoup.models.image import WITHOUT_MODEL, usual_dtype
from scoup.models.normalization import Normalization
from scoup.models.towers import Tower, as_patches, load_tower, normalization_of

_AT_ONCE = 4  # windows


@dataclass(frozen=True, eq=False)
class DenseModel:
    """An image tower that describes places."""

    name: str  # id of the model, as ``TextEncoder.open`` takes it
    revision: str  # commit it was loaded from, "" if unknown
    tower: Tower
    normalization: Normalization
    device: torch.device | str
    dtype: torch.dtype

    @property
    def side(self) -> int:
        """Side of a window, in pixels."""
        return self.tower.side

    @property
    def patch(self) -> int:
        """Side of the square that one token describes, in pixels."""
        return int(self.tower.config.patch_size)

    @property
    def dim(self) -> int:
        config = self.tower.config
        return int(config.projection_dim if self.tower.kind == "clip" else config.hidden_size)

    @property
    def _in_text_space(self) -> bool:
        """Return True if tokens are: then a region is their mean, otherwise a head pools them."""
        return self.tower.kind in ("clip", "tips")

    def to_dict(self) -> dict[str, Any]:
        return {"embedder": self.name, "embedder_revision": self.revision, "embedder_pooling": "dense"}

    def tokens(self, image: Tensor) -> Tensor:
        """Return [h / patch, w / patch, C] float32 features: unit vectors in the text space; SigLIP's before
        its head.

        The image [3, h, w] in 0..1 is covered by windows (``mean_of_windows``).
        """
        pixels = self.normalization(image.to(self.device)).to(self.dtype)
        mean = mean_of_windows(pixels, self.side, self.patch, self._window_tokens)
        return functional.normalize(mean, dim=2) if self._in_text_space else mean

    def pool(self, tokens: Tensor, shares: Tensor) -> Tensor:
        """Return [N, D] float32 unit vectors of regions that have ``shares`` [N, h, w] of each place's area."""
        with torch.inference_mode():
            flat, weights = tokens.flatten(0, 1), shares.flatten(1).to(tokens)
            if self._in_text_space:
                return functional.normalize(weights @ flat, dim=1)
            pooled = _pool_by_head(_vision(self.tower).head, flat, weights, self.dtype)
            return functional.normalize(pooled.float(), dim=1)

    def _window_tokens(self, pixels: Tensor) -> Tensor:
        """Return [B, window, window, C] float32 of windows [B, 3, side, side]."""
        window = self.side // self.patch
        features = _TOKENS[self.tower.kind](self.tower, pixels).float()
        if self._in_text_space:
            features = functional.normalize(features, dim=2)
        return features.unflatten(1, (window, window))


def mean_of_windows(image: Tensor, side: int, patch: int, encode: Callable[[Tensor], Tensor]) -> Tensor:
    """Return [h / patch, w / patch, C] float32 features of an image [3, h, w].

    The image (multiples of ``patch``, at least ``side``) is covered by as few windows as possible, evenly placed; where
    they overlap, the mean is taken. ``encode`` turns windows [B, 3, side, side] into [B, window, window, C].
    """
    window = side // patch
    rows, columns = image.shape[1] // patch, image.shape[2] // patch
    places = [(y, x) for y in _starts(rows, window) for x in _starts(columns, window)]
    cuts = [image[:, y * patch : (y + window) * patch, x * patch : (x + window) * patch] for y, x in places]
    with torch.inference_mode():
        features = torch.cat([encode(batch) for batch in torch.stack(cuts).split(_AT_ONCE)])
        total = features.new_zeros(rows, columns, features.shape[-1])
        count = features.new_zeros(rows, columns, 1)
        for (y, x), of_window in zip(places, features, strict=True):
            total[y : y + window, x : x + window] += of_window
            count[y : y + window, x : x + window] += 1
        return total / count


def _starts(length: int, window: int) -> list[int]:
    """Return the first places of as few windows as cover a length, evenly placed."""
    count = -(-length // window)
    if count == 1:
        return [0]
    return [(length - window) * number // (count - 1) for number in range(count)]


def _clip_tokens(tower: Tower, pixels: Tensor) -> Tensor:
    vision = _vision(tower)
    states = vision.pre_layrnorm(vision.embeddings(pixels))
    *before, last = vision.encoder.layers
    for layer in before:
        states = _first(layer(states, None))
    attention = last.self_attn
    states = attention.out_proj(attention.v_proj(last.layer_norm1(states)))
    return tower.model.visual_projection(vision.post_layernorm(states[:, 1:]))


def _siglip_tokens(tower: Tower, pixels: Tensor) -> Tensor:
    vision = _vision(tower)
    is_naflex = tower.kind == "naflex"
    states = vision.embeddings(*(as_patches(pixels, tower.config.patch_size) if is_naflex else (pixels,)))
    for layer in vision.encoder.layers:
        states = _first(layer(states, None))
    return vision.post_layernorm(states)


def _tips_tokens(tower: Tower, pixels: Tensor) -> Tensor:
    vision = _vision(tower)
    states = vision.embeddings(pixels)
    *before, last = vision.encoder.layer
    for layer in before:
        states = _first(layer(states))
    states = states + last.layer_scale1(last.attention.o_proj(last.attention.v_proj(last.norm1(states))))
    states = states + last.layer_scale2(last.mlp(last.norm2(states)))
    return vision.layernorm(states)[:, 1 + tower.config.num_register_tokens :]


_TOKENS = {"clip": _clip_tokens, "siglip": _siglip_tokens, "naflex": _siglip_tokens, "tips": _tips_tokens}
"""Kind of a tower -> [B, T, C] features of the places of windows [B, 3, side, side]."""


def open_dense_model(
    name: str, revision: str | None = None, device: torch.device | str = "cpu"
) -> DenseModel:
    """Load an image model ("dense:" and a folder or hub id) as a dense encoder; in 16 bits on a GPU."""
    model_id = name.removeprefix(DENSE_PREFIX)
    request = ModelRequest("embedder", name, WITHOUT_MODEL, model_id, revision)
    dtype = usual_dtype(device)

    def load(files: Pretrained) -> DenseModel:
        tower = load_tower(files, "image")
        if tower.kind in ("siglip", "naflex") and not hasattr(_vision(tower), "head"):
            raise ScoupError("its image model has no pooling head; use another SigLIP, or a CLIP")
        tower.model.to(device=device, dtype=dtype)
        normalization = normalization_of(files, tower)
        return DenseModel(model_id, files.commit, tower, normalization, device, dtype)

    return load_pretrained(request, load)


def _vision(tower: Tower) -> Any:
    return tower.model.vision_model


def _first(output: Any) -> Tensor:
    """Return the hidden states: layers of older versions of transformers return tuples."""
    return output[0] if isinstance(output, tuple) else output


def _pool_by_head(head: Any, tokens: Tensor, weights: Tensor, dtype: torch.dtype) -> Tensor:
    """Return [N, C] SigLIP's attention pooling over tokens [T, C] for weights [N, T].

    A token's weight multiplies its exponential in the softmax: 0 leaves it out, 1 is the head as it is.
    """
    attention = head.attention
    heads = attention.num_heads
    query_weight, key_weight, value_weight = attention.in_proj_weight.float().chunk(3)
    query_bias, key_bias, value_bias = attention.in_proj_bias.float().chunk(3)
    query = (head.probe.float()[0, 0] @ query_weight.T + query_bias).view(heads, -1)
    keys = (tokens @ key_weight.T + key_bias).unflatten(1, (heads, -1))
    values = (tokens @ value_weight.T + value_bias).unflatten(1, (heads, -1))
    scores = torch.einsum("hc,thc->ht", query, keys) / query.shape[1] ** 0.5
    shares = (scores + weights.log()[:, None]).softmax(2)  # [N, h, T]
    mixed = torch.einsum("nht,thc->nhc", shares, values).flatten(1).to(dtype)
    pooled = attention.out_proj(mixed)[:, None]
    return (pooled + head.mlp(head.layernorm(pooled)))[:, 0]
