"""MobileSAM: its checkpoint under the names of its authors, and TinyViT against its formulas written out."""

from __future__ import annotations

import math
import os
import pickle
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch
import transformers
from torch import Tensor
from torch.nn import functional

from mask_samples import smooth_image
from scoup.base import MissingFileError, ScoupError
from scoup.models.mobile_sam import _empty_model
from scoup.models.sam import Sam, SamImage, open_sam
from scoup.models.sam_decoder import SharedDecoder
from scoup.models.tiny_vit import TinyViT, _Attention, _Block
from tiny_models import lively

POINTS = torch.tensor([[5.5, 5.0], [60.0, 20.25]], dtype=torch.float64)


def in_checkpoint(name: str) -> str:
    """The authors' name of a weight, written out the other way round."""
    name = name.replace("vision_encoder.", "image_encoder.").replace("layer_norm_final", "norm_final")
    if name == "shared_image_embedding.positional_embedding":
        return "prompt_encoder.pe_layer.positional_encoding_gaussian_matrix"
    if name.startswith("prompt_encoder.point_embed."):
        return name.replace("point_embed", "point_embeddings")
    parts = {"conv1": 0, "layer_norm1": 1, "conv2": 3, "layer_norm2": 4, "conv3": 6}
    for part, number in parts.items():
        name = name.replace(f"mask_embed.{part}.", f"mask_downscaling.{number}.")
    for part, number in {"upscale_conv1": 0, "upscale_layer_norm": 1, "upscale_conv2": 3}.items():
        name = name.replace(f"mask_decoder.{part}.", f"mask_decoder.output_upscaling.{number}.")
    if "hypernetworks" in name or "iou_prediction_head" in name:
        name = name.replace("layers.0", "layers.1")
        name = name.replace("proj_in", "layers.0").replace("proj_out", "layers.2")
    elif "mask_decoder.transformer" in name:
        name = name.replace("layer_norm", "norm")
    return name


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return lively(_empty_model(transformers))


@pytest.fixture(scope="module")
def weights(model) -> dict[str, Tensor]:
    twice = "prompt_encoder.shared_embedding.positional_embedding"
    given = {in_checkpoint(name): value for name, value in model.state_dict().items() if name != twice}
    unused = {"image_encoder.norm_head.weight": torch.ones(320), "image_encoder.head.bias": torch.zeros(9)}
    return given | unused


@pytest.fixture(scope="module")
def opened(weights, tmp_path_factory: pytest.TempPathFactory) -> Sam:
    path = tmp_path_factory.mktemp("weights") / "mobile_sam.pt"
    torch.save(weights, path)
    return open_sam(str(path))


@pytest.fixture(scope="module")
def encoded(opened: Sam) -> SamImage:
    """An image at the real size: several heads, two layers, padding below."""
    found = opened.encode(smooth_image(48, 100))
    assert isinstance(found, SamImage)
    return found


def test_weights_find_their_places(model, opened: Sam, encoded: SamImage) -> None:
    own, folded = opened.model.state_dict(), deepcopy(model)
    folded.vision_encoder.fold()
    assert own.keys() == folded.state_dict().keys()
    assert all(torch.equal(own[name], value) for name, value in folded.state_dict().items())
    logits, iou = encoded.predict(POINTS)
    assert logits.shape == (2, 3, 256, 256)
    assert iou.shape == (2, 3)
    record = opened.to_dict()
    assert record["segmenter"] == "mobile-sam"
    assert len(record["segmenter_sha256"]) == 64


def test_16_bits_are_used_where_the_cpu_multiplies_them(
    weights, encoded: SamImage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mobile_sam.pt"
    torch.save(weights, path)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    full = open_sam(str(path), half=True)
    assert {values.dtype for values in full.model.parameters()} == {torch.float32}
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    half = open_sam(str(path), half=True)
    assert half.to_dict() == full.to_dict()  # either kind of machine goes on with a folder
    (logits, iou), (found, sure) = (
        each.predict(POINTS) for each in (encoded, half.encode(smooth_image(48, 100)))
    )
    assert found.dtype == sure.dtype == torch.float32
    assert not torch.equal(found, logits)
    shown, wanted = encoded.without_padding(found[0]), encoded.without_padding(logits[0])
    assert (shown - wanted).abs().mean() < 0.02 * wanted.abs().mean()
    torch.testing.assert_close(sure, iou, atol=0.02, rtol=0.02)


def test_other_files_are_refused(weights, tmp_path: Path) -> None:
    path = tmp_path / "other.pt"
    with pytest.raises(MissingFileError, match="there is no such checkpoint; fetch https://"):
        open_sam(str(path))
    name = "mask_decoder.iou_token.weight"
    without = {key: value for key, value in weights.items() if key != name}
    said = r"other.pt' cannot be loaded: it (is not MobileSAM|contains no weights)"
    for changed in (without, weights | {name: torch.zeros(1, 8)}, weights | {"more": torch.zeros(1)}, [1, 2]):
        torch.save(changed, path)
        with pytest.raises(ScoupError, match=said):
            open_sam(str(path))
    pointer = b"version https://git-lfs.github.com/spec/v1\n"
    for content, said in ((b"no archive", "cannot be loaded"), (pointer, "is a pointer of Git LFS")):
        path.write_bytes(content)
        with pytest.raises(ScoupError, match=said):
            open_sam(str(path))

    class Hostile:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(tmp_path / "ran"),)

    torch.save({name: Hostile()}, path, pickle_module=pickle)
    with pytest.raises(ScoupError, match="cannot be loaded"):
        open_sam(str(path))
    assert not (tmp_path / "ran").exists()


def test_the_decoder_for_many_points_gives_the_numbers_of_transformers(
    opened: Sam, encoded: SamImage
) -> None:
    decoder = getattr(encoded.decode, "__self__")  # noqa: B009 - functions have no such attribute
    assert isinstance(decoder, SharedDecoder)
    prompts = POINTS * 4
    shared, plain = decoder.predict(prompts), opened.predict(decoder.embedding, prompts)
    rows = 4 * (-(-48 * 1024 // 100 // 16))
    torch.testing.assert_close(shared[0][..., :rows, :], plain[0][..., :rows, :], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(shared[1], plain[1], atol=1e-4, rtol=1e-4)
    assert float(plain[0].std()) > 0.01
    assert np.isfinite(shared[0].numpy()).all()


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
