"""Text encoders over tiny random CLIP and SigLIP models, all offline."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import transformers
from safetensors.torch import load_file, save_file

from messages import refuses
from scoup.base import ScoupError, ScoupWarning
from scoup.models.text import TextEncoder
from tiny_models import WORDS, save_text_clip, saved, tiny_siglip, tiny_tips, tiny_tokenizer


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
    torch.testing.assert_close(
        vectors[:1], torch.nn.functional.normalize(expected, dim=1), atol=1e-5, rtol=1e-4
    )
    torch.testing.assert_close(encoder.encode(["chair"]), vectors[1:], atol=1e-6, rtol=1e-5)
    many = encoder.encode(["red apple", "chair"] * 40)
    torch.testing.assert_close(many, vectors.repeat(40, 1), atol=1e-6, rtol=1e-5)
    with pytest.warns(ScoupWarning, match="tokens"):
        encoder.encode(["red apple chair object red apple chair object"])


def test_siglip_through_transformers(tmp_path: Path) -> None:
    model = tiny_siglip()
    saved(model, tmp_path)
    tiny_tokenizer(tmp_path, WORDS)
    encoder = TextEncoder.open(str(tmp_path))
    assert encoder.dim == 16
    with torch.inference_mode():
        features = model.get_text_features(input_ids=torch.tensor([[1, 4, *[6] * 62]]))
    expected = torch.nn.functional.normalize(getattr(features, "pooler_output", features), dim=1)
    torch.testing.assert_close(encoder.encode(["apple"]), expected, atol=1e-6, rtol=1e-5)


def test_tips_is_the_mean_of_its_tokens(tmp_path: Path) -> None:
    model = tiny_tips(max_position_embeddings=8, vocab_size=7)
    saved(model, tmp_path)
    tiny_tokenizer(tmp_path, WORDS)
    vectors = TextEncoder.open(str(tmp_path)).encode(["red apple", "chair"])  # of different lengths
    for row, ids in zip(vectors, ([1, 3, 4, 6], [1, 5, 6]), strict=True):
        with torch.inference_mode():
            states = model.text_model(input_ids=torch.tensor([ids])).last_hidden_state[0]
        expected = torch.nn.functional.normalize(states.mean(0), dim=0)
        torch.testing.assert_close(row, expected, atol=1e-5, rtol=1e-4)


def test_models_that_cannot_be_loaded(clip_folder: Path, tmp_path: Path) -> None:
    for model in ("nobody/has-this-model", str(tmp_path), "not a model id", "a/b/c"):
        with pytest.raises(ScoupError, match="table file"):
            TextEncoder.open(model)
    broken = shutil.copytree(clip_folder, tmp_path / "broken")
    weights = broken / "model.safetensors"
    tensors = load_file(weights)
    del tensors["text_projection.weight"]
    save_file(tensors, weights, metadata={"format": "pt"})
    with pytest.raises(ScoupError, match="lacks weights"):  # which are not made up
        TextEncoder.open(broken)
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(ScoupError, match="cannot be loaded"):
        TextEncoder.open(broken)
    weights.unlink()
    with pytest.raises(ScoupError, match="cannot be loaded"):
        TextEncoder.open(broken)
    config = transformers.BertConfig(hidden_size=16, num_hidden_layers=1, num_attention_heads=2, vocab_size=7,
                                     intermediate_size=16)  # fmt: skip
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


def test_open_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package: how it is called, and what is made of its result."""

    class Model(torch.nn.Module):
        def encode_text(self, tokens: torch.Tensor) -> torch.Tensor:
            return tokens.float() * 2

    def create_model(architecture: str, pretrained: str, device: str) -> Model:
        if (architecture, pretrained) != ("ViT-B-16", "laion2b_s34b_b88k"):
            raise RuntimeError("Model config for X not found.")
        return Model()

    def get_tokenizer(architecture: str):
        return lambda phrases: torch.tensor([[len(phrase), 3, 4] for phrase in phrases])

    stand_in = SimpleNamespace(create_model=create_model, get_tokenizer=get_tokenizer)
    monkeypatch.setitem(sys.modules, "open_clip", stand_in)
    encoder = TextEncoder.open("open_clip:ViT-B-16/laion2b_s34b_b88k")
    assert encoder.dim == 3
    expected = torch.nn.functional.normalize(torch.tensor([[5.0, 3, 4]]), dim=1)
    torch.testing.assert_close(encoder.encode(["apple"]), expected)
    with pytest.raises(ScoupError, match="not found"):
        TextEncoder.open("open_clip:X/y")
