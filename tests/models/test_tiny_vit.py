"""TinyViT against its formulas written out one window, pixel and head at a time."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from scoup.models.tiny_vit import TinyViT, _Attention, _Block
from tiny_models import lively


@pytest.mark.parametrize("window", [3, 4])
@torch.inference_mode()
def test_attention_has_a_bias_for_each_distance(window: int) -> None:
    torch.manual_seed(window)
    attention = lively(_Attention(8, 2, window)).eval()
    tokens = torch.randn(window * window, 8)
    normal = functional.layer_norm(tokens, (8,), attention.norm.weight, attention.norm.bias)
    # Query, key and value of a head lie side by side, head after head.
    heads = attention.qkv(normal).view(-1, 2, 3, 4)
    numbers: dict[tuple[int, int], int] = {}
    places = [(y, x) for y in range(window) for x in range(window)]
    for y, x in places:
        for other_y, other_x in places:
            numbers.setdefault((abs(y - other_y), abs(x - other_x)), len(numbers))
    rows = []
    for i, (y, x) in enumerate(places):
        row = []
        for head in range(2):
            scores = [
                float(heads[i, head, 0] @ heads[j, head, 1]) / math.sqrt(4)
                + float(attention.attention_biases[head, numbers[abs(y - b), abs(x - a)]])
                for j, (b, a) in enumerate(places)
            ]
            shares = torch.tensor(scores).softmax(0)
            row.append(sum(shares[j] * heads[j, head, 2] for j in range(len(places))))
        rows.append(torch.cat(row))
    wanted = attention.proj(torch.stack(rows))
    torch.testing.assert_close(attention(tokens[None])[0], wanted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("size", [(4, 4), (8, 4), (5, 7), (3, 9)])
def test_windows_cover_the_image_row_by_row_and_padding_is_cut_off(size: tuple[int, int]) -> None:
    torch.manual_seed(0)
    block = lively(_Block(8, 2, 4)).eval()
    image = torch.randn(1, 8, *size)
    height, width = size
    padded = torch.zeros(8, -(-height // 4) * 4, -(-width // 4) * 4)
    padded[:, :height, :width] = image[0]
    attended = torch.zeros_like(padded)
    for top in range(0, padded.shape[1], 4):
        for left in range(0, padded.shape[2], 4):
            tokens = padded[:, top : top + 4, left : left + 4].flatten(1).T
            mixed: Tensor = block.attn(tokens[None])[0]
            attended[:, top : top + 4, left : left + 4] = mixed.T.view(8, 4, 4)
    torch.testing.assert_close(block._attend(image)[0], attended[:, :height, :width], atol=1e-5, rtol=1e-5)


def test_an_image_gives_embeddings_at_a_sixteenth_of_its_size_folded_or_not() -> None:
    torch.manual_seed(0)
    model = lively(TinyViT((8, 8, 16, 16), (1, 1, 2, 1), (1, 2, 2, 4), (7, 3, 4, 3), neck=12))
    image, other = torch.randn(2, 1, 3, 64, 64)
    with torch.no_grad():
        for _ in range(20):
            model(image)  # gives normalisations of batches something to do
    model.eval()
    with torch.inference_mode():
        first, second = model(image)[0], model(other)[0]
        model.fold()
        torch.testing.assert_close(model(image)[0], first, atol=1e-5, rtol=1e-4)
    assert first.shape == (1, 12, 4, 4)
    assert not torch.allclose(first, second, atol=1e-3)
