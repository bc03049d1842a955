"""Text, image and dense encoders: tiny random models read from files, against their formulas, all offline."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
import transformers
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.nn import functional

import tiny_models
from mask_samples import smooth_image
from messages import refuses
from scoup.base import ScoupError, ScoupWarning
from scoup.models.dense import DenseModel, _starts, open_dense_model
from scoup.models.image import open_clip_image_model, open_image_model
from scoup.models.normalization import CLIP, HALF
from scoup.models.text import TextEncoder
from support import unit
from tiny_models import WORDS, save_text_clip, saved, tiny_clip, tiny_siglip, tiny_tips, tiny_tokenizer


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_text_clip(tmp_path_factory.mktemp("clip"))


def test_clip_through_transformers(clip_folder: Path) -> None:
    encoder = TextEncoder.open(clip_folder)
    assert (encoder.dim, encoder.name) == (12, str(clip_folder))
    vectors = encoder.encode(["red apple", "chair"])
    assert vectors.dtype == torch.float32
    torch.testing.assert_close(torch.linalg.vector_norm(vectors, dim=1), torch.ones(2))
    # Alone and without padding the answer is the same.
    model = transformers.CLIPModel.from_pretrained(clip_folder).eval()
    with torch.inference_mode():
        features = model.get_text_features(input_ids=torch.tensor([[1, 3, 4, 6]]))
    expected: Any = getattr(features, "pooler_output", features)
    torch.testing.assert_close(vectors[:1], unit(expected), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(encoder.encode(["chair"]), vectors[1:], atol=1e-6, rtol=1e-5)
    many = encoder.encode(["red apple", "chair"] * 40)
    torch.testing.assert_close(many, vectors.repeat(40, 1), atol=1e-6, rtol=1e-5)
    with pytest.warns(ScoupWarning, match="tokens"):
        encoder.encode(["red apple chair object red apple chair object"])


@torch.inference_mode()
def test_siglip_is_padded_and_tips_is_the_mean_of_its_tokens(tmp_path: Path) -> None:
    siglip = tiny_siglip()
    tiny_tokenizer(saved(siglip, tmp_path / "siglip"), WORDS)
    features = siglip.get_text_features(input_ids=torch.tensor([[1, 4, *[6] * 62]]))
    expected = unit(getattr(features, "pooler_output", features))
    vectors = TextEncoder.open(tmp_path / "siglip").encode(["apple"])
    torch.testing.assert_close(vectors, expected, atol=1e-6, rtol=1e-5)
    tips = tiny_tips(max_position_embeddings=8, vocab_size=7)  # older packages have none: skipped
    tiny_tokenizer(saved(tips, tmp_path / "tips"), WORDS)
    vectors = TextEncoder.open(tmp_path / "tips").encode(["red apple", "chair"])  # of different lengths
    for row, ids in zip(vectors, ([1, 3, 4, 6], [1, 5, 6]), strict=True):
        states = tips.text_model(input_ids=torch.tensor([ids])).last_hidden_state[0]
        torch.testing.assert_close(row, unit(states.mean(0)), atol=1e-5, rtol=1e-4)


def test_models_that_cannot_be_loaded(clip_folder: Path, tmp_path: Path) -> None:
    for model in ("nobody/has-this-model", str(tmp_path), "not a model id", "a/b/c"):
        with pytest.raises(ScoupError, match="table file"):
            TextEncoder.open(model)
    broken = shutil.copytree(clip_folder, tmp_path / "broken")
    tensors = load_file(broken / "model.safetensors")
    del tensors["text_projection.weight"]
    save_file(tensors, broken / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(ScoupError, match="lacks weights"):  # which are not made up
        TextEncoder.open(broken)
    shutil.copytree(clip_folder, broken, dirs_exist_ok=True)
    told = broken / "tokenizer_config.json"
    told.write_text(json.dumps({**json.loads(told.read_text()), "pad_token": None}))
    with pytest.raises(ScoupError, match="encodes no words: its files are damaged"):
        TextEncoder.open(broken)
    config = transformers.BertConfig(
        vocab_size=7, hidden_size=16, num_hidden_layers=1, num_attention_heads=2, intermediate_size=16
    )
    transformers.BertModel(config).save_pretrained(tmp_path / "bert")
    tiny_tokenizer(tmp_path / "bert", WORDS)
    with pytest.raises(ScoupError, match="no text features"):
        TextEncoder.open(tmp_path / "bert")


def test_absent_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    for model, package in (
        ("laion/CLIP-ViT-B-16-laion2B-s34B-b88K", "transformers"),
        ("open_clip:ViT-B-16/laion2b_s34b_b88k", "open_clip"),
    ):
        monkeypatch.setitem(sys.modules, package, None)
        with refuses(ScoupError):
            TextEncoder.open(model)


def test_open_clip_models_are_used_through_their_own_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package: how it is called, and what is made of its results."""
    weights = torch.randn(3 * 10 * 10, 6, generator=torch.Generator().manual_seed(0))

    class Model(torch.nn.Module):
        visual = SimpleNamespace(image_size=(10, 10), image_mean=(0.2, 0.3, 0.4), image_std=(0.5, 0.6, 0.7))

        def encode_text(self, tokens: torch.Tensor) -> torch.Tensor:
            return tokens.float() * 2

        def encode_image(self, pixels: torch.Tensor) -> torch.Tensor:
            return pixels.flatten(1) @ weights

    def create_model(architecture: str, pretrained: str, device: str) -> Model:
        if (architecture, pretrained, device) != ("ViT-B-16", "laion2b_s34b_b88k", "cpu"):
            raise RuntimeError("Model config for X not found.")
        return Model()

    def get_tokenizer(architecture: str):
        return lambda phrases: torch.tensor([[len(phrase), 3, 4] for phrase in phrases])

    def list_models() -> list[str]:
        return ["RN50", "ViT-B-16"]

    stand_in = SimpleNamespace(
        create_model=create_model, get_tokenizer=get_tokenizer, list_models=list_models
    )
    monkeypatch.setitem(sys.modules, "open_clip", stand_in)
    name = "open_clip:ViT-B-16/laion2b_s34b_b88k"
    encoder, embedder = TextEncoder.open(name), open_clip_image_model(name)
    assert encoder.dim == 3
    torch.testing.assert_close(encoder.encode(["apple"]), unit(torch.tensor([[5.0, 3, 4]])))
    assert (embedder.dim, embedder.side, embedder.name) == (6, 10, name)
    crops = torch.from_numpy(smooth_image(10, 10))[None]
    mean, std = (torch.tensor(each).view(3, 1, 1) for each in ([0.2, 0.3, 0.4], [0.5, 0.6, 0.7]))
    pixels = (crops.permute(0, 3, 1, 2) / 255 - mean) / std
    torch.testing.assert_close(embedder.embed(crops), unit(pixels.flatten(1) @ weights))
    for name in ("open_clip:X/y", "open_clip:ViT-B/17/y", "open_clip:ViT-B/16/other"):
        with refuses(ScoupError):
            TextEncoder.open(name)


CLIP_PIXELS = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)


@pytest.mark.parametrize(("build", "dim", "mean", "std"), [
    (tiny_clip, 12, *CLIP_PIXELS), (tiny_siglip, 16, 0.5, 0.5), (tiny_tips, 16, 0, 1),
])  # fmt: skip
def test_embeddings_are_those_of_the_model_fed_by_hand(build, dim, mean, std, tmp_path: Path) -> None:
    """Unit length; within 1e-3 cosine."""
    model = build()
    embedder = open_image_model(str(saved(model, tmp_path)))
    assert (embedder.dim, embedder.side) == (dim, 32)
    crops = np.stack([smooth_image(32, 32, seed) for seed in range(15)])
    crops[7:, :, 16:] = 0  # with a black margin, as crops of regions have one
    rows = embedder.embed(torch.from_numpy(crops))
    pixels = torch.from_numpy((crops / 255 - mean) / std).float().permute(0, 3, 1, 2)
    with torch.inference_mode():
        features = model.get_image_features(pixel_values=pixels)
    expected = unit(getattr(features, "pooler_output", features))
    assert rows.dtype == torch.float32
    assert float((1 - (rows * expected).sum(1)).max()) < 1e-3
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(len(rows)))
    assert float((rows @ rows.T).min()) < 0.99, "the tiny model takes all crops for the same"


def test_crops_of_clip_in_bfloat16(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip, siglip = saved(tiny_clip(), tmp_path / "clip"), saved(tiny_siglip(), tmp_path / "siglip")
    crops = torch.from_numpy(np.stack([smooth_image(32, 32, seed) for seed in range(15)]))
    rows: list[torch.Tensor] = []
    for there, kind in ((True, torch.bfloat16), (False, torch.float32)):
        monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda there=there: there)
        model = open_image_model(str(clip))
        assert (model.dtype, open_image_model(str(siglip)).dtype) == (kind, torch.float32)
        rows.append(model.embed(crops))
    assert rows[0].dtype == torch.float32
    assert not rows[0].equal(rows[1])
    assert float((rows[0] * rows[1]).sum(1).min()) > 0.999


def test_sizes_and_normalisation_come_with_the_model(tmp_path: Path) -> None:
    model = tiny_clip(side=48)
    plain = open_image_model(str(saved(model, tmp_path / "a")))
    named = open_image_model(str(saved(model, tmp_path / "b", image_mean=[0.1] * 3, image_std=[0.9] * 3)))
    assert (plain.side, named.side) == (48, 48)
    crops = torch.from_numpy(smooth_image(48, 48))[None]
    assert float((plain.embed(crops) * named.embed(crops)).sum()) < 0.9999
    assert plain.to_dict()["embedder"] == str(tmp_path / "a")


SIDE, PATCH, GRID = 32, 8, 4


@pytest.fixture(scope="module")
def opened(tmp_path_factory) -> dict[str, DenseModel]:
    models = {"clip": tiny_clip(), "siglip": tiny_siglip(), "tips": tiny_tips()}
    folders = {kind: saved(model, tmp_path_factory.mktemp(kind)) for kind, model in models.items()}
    return {kind: open_dense_model(f"dense:{folder}") for kind, folder in folders.items()}


def photograph(height: int = SIDE, width: int = SIDE, seed: int = 0) -> Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))


@torch.inference_mode()
def test_clip_is_the_value_path_of_its_last_layer(opened: dict[str, DenseModel]) -> None:
    model, image = tiny_clip(), photograph()
    states = model.vision_model(CLIP(image)[None], output_hidden_states=True).hidden_states
    last = model.vision_model.encoder.layers[-1]
    out = last.self_attn.out_proj(last.self_attn.v_proj(last.layer_norm1(states[-2])))
    wanted = unit(model.visual_projection(model.vision_model.post_layernorm(out))[0, 1:]).view(GRID, GRID, -1)
    tokens = opened["clip"].tokens(image)
    torch.testing.assert_close(tokens, wanted, atol=1e-5, rtol=1e-5)
    assert tokens.shape[2] == opened["clip"].dim == 12
    shares = torch.zeros(2, GRID, GRID)
    shares[0, 1, 2], shares[1, 0, 0], shares[1, 3, 3] = 0.25, 0.5, 1.0
    vectors = opened["clip"].pool(tokens, shares)
    mixed = unit(0.5 * tokens[0, 0] + tokens[3, 3])
    torch.testing.assert_close(vectors, torch.stack([tokens[1, 2], mixed]), atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_tips_is_the_last_layer_with_its_values_in_place_of_attention(opened: dict[str, DenseModel]) -> None:
    vision, image, inputs = tiny_tips().vision_model, photograph(), []
    last = vision.encoder.layer[-1]
    last.register_forward_pre_hook(lambda module, given: inputs.append(given[0]))
    vision(pixel_values=image[None])  # not normalised
    mixed = []
    for state in inputs[0][0, 3:]:  # without the class and two register tokens
        state = state + 0.7 * last.attention.o_proj(last.attention.v_proj(last.norm1(state)))
        hidden = functional.gelu(last.mlp.fc1(last.norm2(state)))
        mixed.append(state + 0.7 * last.mlp.fc2(hidden))
    wanted = unit(vision.layernorm(torch.stack(mixed))).view(GRID, GRID, -1)
    tokens = opened["tips"].tokens(image)
    torch.testing.assert_close(tokens, wanted, atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_naflex_reads_patches_row_by_row(tmp_path: Path) -> None:
    model, crop = tiny_models.tiny_siglip2(), (photograph() * 255).byte()
    image, folder = crop / 255, str(saved(model, tmp_path))
    pixels = HALF(image)
    patches = [
        pixels[:, y : y + PATCH, x : x + PATCH].permute(1, 2, 0).flatten()
        for y in range(0, SIDE, PATCH)
        for x in range(0, SIDE, PATCH)
    ]
    features = model.get_image_features(
        pixel_values=torch.stack(patches)[None],
        pixel_attention_mask=torch.ones(1, GRID**2),
        spatial_shapes=torch.tensor([[GRID, GRID]]),
    )
    wanted = unit(getattr(features, "pooler_output", features))  # transformers 5 returns an object
    dense = open_dense_model(f"dense:{folder}")
    found = dense.pool(dense.tokens(image), torch.ones(1, GRID, GRID))
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)
    crops = open_image_model(folder)
    assert (crops.side, dense.side) == (SIDE, SIDE)
    torch.testing.assert_close(crops.embed(crop.permute(1, 2, 0)[None]), wanted, atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_siglips_head_attends_to_the_region_alone(opened: dict[str, DenseModel]) -> None:
    head = tiny_siglip().vision_model.head
    tokens = opened["siglip"].tokens(photograph())
    shares = (torch.rand(5, GRID, GRID, generator=torch.Generator().manual_seed(1)) > 0.6).float()
    shares[4] = 1
    flat = tokens.flatten(0, 1)[None]
    for number, share in enumerate(shares):
        mixed = head.attention(head.probe, flat, flat, key_padding_mask=share.flatten()[None] == 0)[0]
        wanted = unit((mixed + head.mlp(head.layernorm(mixed)))[0, 0])
        found = opened["siglip"].pool(tokens, 0.3 * shares[number : number + 1])[0]  # alike everywhere
        torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", ["clip", "siglip", "tips"])
def test_windows_cover_a_photograph_and_are_averaged_where_they_overlap(kind: str, opened) -> None:
    model, image = opened[kind], photograph(SIDE, 48)  # windows begin at columns 0 and 2
    tokens = model.tokens(image)
    assert tokens.shape[:2] == (4, 6)
    first, second = model.tokens(image[..., :32]), model.tokens(image[..., 16:])
    mean = (first[:, 2:] + second[:, :2]) / 2
    if kind != "siglip":
        mean = unit(mean)
    torch.testing.assert_close(tokens[:, :2], first[:, :2], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(tokens[:, 4:], second[:, 2:], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(tokens[:, 2:4], mean, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("length", "window"), [(4, 4), (5, 4), (8, 4), (9, 4), (31, 7)])
def test_as_few_windows_as_cover_a_length(length: int, window: int) -> None:
    starts = _starts(length, window)
    assert len(starts) == -(-length // window)
    covered = {place for start in starts for place in range(start, start + window)}
    assert covered == set(range(length))


def test_a_package_that_is_too_old_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = saved(tiny_tips(), tmp_path)
    unknown = Mock(side_effect=ValueError("the checkpoint has model type `tipsv2`, which is not recognised"))
    monkeypatch.setattr("transformers.AutoConfig.from_pretrained", unknown)
    monkeypatch.setattr("transformers.__version__", "4.40.0")
    needed = r"tipsv2 models need transformers 5.14 or newer \(this is 4.40.0\); run 'pip install -U"
    with pytest.raises(ScoupError, match=needed):
        open_dense_model(f"dense:{folder}")
