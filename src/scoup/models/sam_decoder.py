"""SAM's mask decoder for many points of one image: the numbers of transformers' ``SamModel`` up to rounding, for a
third of the work.

The keys, values and queries of the image in the first layer are computed once for all points. In the second layer,
projections of all tokens of the image, different for each point, are moved to the few tokens of the point:
q . (W k) = (W' q) . k. And only the part of a mask that shows the image is upscaled, not the padding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

OUTSIDE = -20.0  # logits of the padding
POINTS_AT_ONCE = {torch.float32: 2, torch.bfloat16: 4}
"""More are slower: the tokens of a few images fit into the caches of a CPU."""


@dataclass(frozen=True, eq=False)
class SharedDecoder:
    """The decoder over one image."""

    model: Any  # a ``SamModel`` of transformers, on the CPU
    embedding: Tensor  # [1, D, h, w] of the image
    shown: tuple[int, int]  # rows and columns of the embedding that show the image; the rest is padding

    def predict(self, prompts: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [P, 3, 4 h, 4 w] and predicted IoU [P, 3] of prompts [P, 2] in pixels of the square."""
        with torch.inference_mode():
            parts = [self._predict(batch) for batch in prompts.split(POINTS_AT_ONCE[self.embedding.dtype])]
        return torch.cat([masks for masks, _ in parts]), torch.cat([iou for _, iou in parts])

    @cached_property
    def _image(self) -> _Image:
        model = self.model
        dense = model.prompt_encoder.no_mask_embed.weight.reshape(1, -1, 1, 1)
        images = self.embedding + dense, model.get_image_wide_positional_embeddings()
        tokens, places = (
            tensor.to(self.embedding.dtype).flatten(2).transpose(1, 2).contiguous() for tensor in images
        )
        first = model.mask_decoder.transformer.layers[0]
        to_image, from_image = first.cross_attn_token_to_image, first.cross_attn_image_to_token
        return _Image(
            tokens,
            places,
            _heads(to_image, to_image.k_proj(tokens + places)),
            _heads(to_image, to_image.v_proj(tokens)),
            _heads(from_image, from_image.q_proj(tokens + places)),
        )

    def _predict(self, prompts: Tensor) -> tuple[Tensor, Tensor]:
        decoder = self.model.mask_decoder
        sparse = self.model.prompt_encoder(
            input_points=prompts.float()[None, :, None],
            input_labels=torch.ones(1, len(prompts), 1, dtype=torch.int32, device=prompts.device),
            input_boxes=None,
            input_masks=None,
        )[0][0]
        fixed = torch.cat([decoder.iou_token.weight, decoder.mask_tokens.weight])
        places = torch.cat([fixed[None].expand(len(prompts), -1, -1), sparse.to(fixed.dtype)], dim=1)
        transformer = decoder.transformer
        tokens, image = self._first_layer(places)
        placed = image + self._image.places
        for layer in transformer.layers[1:]:
            tokens, image = self._later_layer(layer, tokens, places, image, placed)
            torch.add(image, self._image.places, out=placed)
        # Of the last attention's tokens only those of the quality and of the three masks are used.
        networks = decoder.output_hypernetworks_mlps
        used = [0, *range(2, 1 + len(networks))]
        tokens, places = tokens[:, used], places[:, used]
        seen = _to_image(transformer.final_attn_token_to_image, tokens + places, placed, image)
        tokens = transformer.layer_norm_final_attn(tokens + seen)
        iou = decoder.iou_prediction_head(tokens[:, 0].float())[:, 1:]
        weights = torch.stack([networks[n](tokens[:, n]) for n in range(1, len(networks))], dim=1)
        return self._upscale(image, weights), iou

    def _first_layer(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """Apply the first layer, in which all points have the same image."""
        layer, image = self.model.mask_decoder.transformer.layers[0], self._image
        tokens = layer.layer_norm1(_attend(layer.self_attn, places, places, places))
        to_image = layer.cross_attn_token_to_image
        queries = _heads(to_image, to_image.q_proj(tokens + places))
        scores = _with_shared(queries * queries.shape[-1] ** -0.5, image.keys.transpose(2, 3))
        mixed = _with_shared(scores.softmax(-1), image.values)
        tokens = layer.layer_norm2(tokens + to_image.out_proj(_join_heads(mixed)))
        tokens = layer.layer_norm3(tokens + layer.mlp(tokens))
        from_image = layer.cross_attn_image_to_token
        keys = _heads(from_image, from_image.k_proj(tokens + places))
        scores = _with_shared(keys * keys.shape[-1] ** -0.5, image.queries.transpose(2, 3))
        changed = _from_tokens(from_image, scores, tokens)
        return tokens, layer.layer_norm4(changed.add_(image.tokens))

    def _later_layer(
        self, layer: Any, tokens: Tensor, places: Tensor, image: Tensor, placed: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Apply a layer in which every point has its own image; ``placed`` is it with its places added."""
        queries = tokens + places
        tokens = layer.layer_norm1(tokens + _attend(layer.self_attn, queries, queries, tokens))
        seen = _to_image(layer.cross_attn_token_to_image, tokens + places, placed, image)
        tokens = layer.layer_norm2(tokens + seen)
        tokens = layer.layer_norm3(tokens + layer.mlp(tokens))
        attention = layer.cross_attn_image_to_token
        keys = _heads(attention, attention.k_proj(tokens + places))
        keys = keys * keys.shape[-1] ** -0.5
        bias = torch.einsum("hc,bhnc->bhn", attention.q_proj.bias.view(keys.shape[1], -1), keys)
        moved = _through(attention.q_proj.weight, keys)
        scores = torch.baddbmm(bias.flatten(1)[..., None], moved, placed.transpose(1, 2))
        scores = scores.unflatten(1, bias.shape[1:])
        return tokens, layer.layer_norm4(_from_tokens(attention, scores, tokens).add_(image))

    def _upscale(self, image: Tensor, weights: Tensor) -> Tensor:
        """Apply two transposed convolutions (2 x 2, stride 2) as products over pixels, then the masks."""
        decoder = self.model.mask_decoder
        height, width = self.embedding.shape[-2:]
        rows, columns = self.shown
        points = len(image)
        image = image.view(points, height, width, -1)[:, :rows, :columns].flatten(0, 2)
        first, norm, second = decoder.upscale_conv1, decoder.upscale_layer_norm, decoder.upscale_conv2
        inner = _product(first, image)
        inner = functional.gelu(
            functional.layer_norm(inner, inner.shape[-1:], norm.weight, norm.bias, norm.eps)
        )
        pixels = functional.gelu(_product(second, inner)).view(points, -1, second.out_channels)
        masks = torch.bmm(pixels, weights.transpose(1, 2)).view(points, rows, columns, 2, 2, 2, 2, -1)
        # Both convolutions split a pixel into rows and columns: point, mask, row (3), column (3).
        masks = masks.permute(0, 7, 1, 3, 5, 2, 4, 6).reshape(points, -1, 4 * rows, 4 * columns)
        margin = (0, 4 * (width - columns), 0, 4 * (height - rows))
        return functional.pad(masks.float(), margin, value=OUTSIDE)


@dataclass(frozen=True, eq=False)
class _Image:
    """The tokens of the image, [1, T, D], their places, and the first layer's heads of them: shared by all points."""

    tokens: Tensor
    places: Tensor
    keys: Tensor  # of the attention of points to the image
    values: Tensor
    queries: Tensor  # of the attention of the image to points


def _heads(attention: Any, tokens: Tensor) -> Tensor:
    """[B, N, h c] -> [B, h, N, c]."""
    return tokens.unflatten(-1, (attention.num_attention_heads, -1)).transpose(1, 2)


def _join_heads(heads: Tensor) -> Tensor:
    return heads.transpose(1, 2).flatten(2)


def _attend(attention: Any, queries: Tensor, keys: Tensor, values: Tensor) -> Tensor:
    mixed = functional.scaled_dot_product_attention(
        _heads(attention, attention.q_proj(queries)),
        _heads(attention, attention.k_proj(keys)),
        _heads(attention, attention.v_proj(values)),
    )
    return attention.out_proj(_join_heads(mixed))


def _with_shared(heads: Tensor, shared: Tensor) -> Tensor:
    """Heads [B, h, N, c] of points by a matrix [1, h, c, T] shared by all points, which torch's product would copy."""
    rows = heads.transpose(0, 1).flatten(1, 2) @ shared[0]
    return rows.unflatten(1, (len(heads), -1)).transpose(0, 1)


def _through(weight: Tensor, heads: Tensor) -> Tensor:
    """Heads [B, h, N, c] of tokens through a projection [h c, D] of the other side -> [B, h N, D]."""
    by_head = weight.view(heads.shape[1], heads.shape[3], -1)
    return torch.einsum("bhnc,hcd->bhnd", heads, by_head).flatten(1, 2)


def _to_image(attention: Any, queries: Tensor, keys: Tensor, values: Tensor) -> Tensor:
    """Tokens [B, N, D] attend to an image [B, T, D] of each point."""
    heads = _heads(attention, attention.q_proj(queries))
    batch, count, tokens, size = heads.shape
    # The bias of the keys adds the same to all scores of a query, which softmax takes out again.
    scores = torch.bmm(_through(attention.k_proj.weight, heads), keys.transpose(1, 2)) * size**-0.5
    mixed = torch.bmm(scores.softmax(-1), values).view(batch, count, tokens, -1)
    values_of_heads = torch.einsum(
        "bhnd,hcd->bhnc", mixed, attention.v_proj.weight.view(count, size, -1)
    ) + attention.v_proj.bias.view(1, count, 1, size)
    return attention.out_proj(_join_heads(values_of_heads))


def _from_tokens(attention: Any, scores: Tensor, tokens: Tensor) -> Tensor:
    """An image's tokens attend to the point's: scores [B, h, N, T], tokens [B, N, D] -> [B, T, D]."""
    shares = scores.softmax(2).flatten(1, 2)
    values = _heads(attention, attention.v_proj(tokens))
    weight = attention.out_proj.weight.view(-1, *values.shape[1::2])  # [D, h, c]
    moved = torch.einsum("bhnc,dhc->bhnd", values, weight).flatten(1, 2)
    # Shares of a head add up to 1: the heads add the bias together.
    moved += attention.out_proj.bias / scores.shape[1]
    return torch.bmm(shares.transpose(1, 2), moved)


def _product(convolution: Any, pixels: Tensor) -> Tensor:
    """A transposed convolution (2 x 2, stride 2) of pixels [N, D] -> [4 N, C], row by row within each pixel."""
    weight = convolution.weight.permute(0, 2, 3, 1).flatten(1)
    return torch.addmm(convolution.bias.repeat(4), pixels, weight).view(-1, convolution.out_channels)
