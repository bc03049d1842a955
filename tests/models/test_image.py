"""Image models: embeddings of tiny CLIP and SigLIP models after a round trip through files."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mask_samples import smooth_image
from scoup.base import ScoupError
from scoup.models.image import open_clip_image_model, open_image_model
from tiny_models import saved, tiny_clip, tiny_sam, tiny_siglip, tiny_tips

CLIP_MEAN, CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)


@pytest.mark.parametrize("build", [tiny_clip, tiny_siglip, tiny_tips])
def test_embeddings_are_those_of_the_model_fed_by_hand(build, tmp_path: Path) -> None:
    """CLIP's or SigLIP's normalisation, unit length; within 1e-3 cosine."""
    model = build()
    embedder = open_image_model(str(saved(model, tmp_path)))
    assert (embedder.dim, embedder.side) == ((12, 32) if build is tiny_clip else (16, 32))
    crops = np.stack([smooth_image(32, 32, seed) for seed in range(15)])
    crops[7:, :, 16:] = 0  # with a black margin, as crops of regions have one
    rows = embedder.embed(torch.from_numpy(crops))
    mean, std = {tiny_clip: (CLIP_MEAN, CLIP_STD), tiny_tips: (0, 1)}.get(build, (0.5, 0.5))
    pixels = torch.from_numpy((crops / 255 - mean) / std).float().permute(0, 3, 1, 2)
    with torch.inference_mode():
        features = model.get_image_features(pixel_values=pixels)
    expected = torch.nn.functional.normalize(getattr(features, "pooler_output", features), dim=1)
    assert rows.dtype == torch.float32
    assert float((1 - (rows * expected).sum(1)).max()) < 1e-3
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(len(rows)))
    assert float((rows @ rows.T).min()) < 0.99, "the tiny model takes all crops for the same"


def test_sizes_and_normalisation_come_with_the_model(tmp_path: Path) -> None:
    model = tiny_clip(side=48)
    plain = open_image_model(str(saved(model, tmp_path / "a")))
    named = open_image_model(str(saved(model, tmp_path / "b", image_mean=[0.1] * 3, image_std=[0.9] * 3)))
    assert (plain.side, named.side) == (48, 48)
    crops = torch.from_numpy(smooth_image(48, 48))[None]
    assert float((plain.embed(crops) * named.embed(crops)).sum()) < 0.9999
    assert plain.to_dict()["embedder"] == str(tmp_path / "a")


def test_what_cannot_be_loaded_is_told(tmp_path: Path) -> None:
    with pytest.raises(ScoupError, match=r"embedder 'laion/nothing' cannot be loaded: .*colors"):
        open_image_model("laion/nothing")
    with pytest.raises(ScoupError, match="'sam' models have no image features"):
        open_image_model(str(saved(tiny_sam(), tmp_path)))


def test_open_clip_models_are_used_through_their_own_interface(monkeypatch) -> None:
    """A stand-in for the package: the size and normalisation of its image tower are used."""
    weights = torch.randn(3 * 10 * 10, 6, generator=torch.Generator().manual_seed(0))

    class Model(torch.nn.Module):
        visual = SimpleNamespace(image_size=(10, 10), image_mean=(0.2, 0.3, 0.4), image_std=(0.5, 0.6, 0.7))

        def encode_image(self, pixels: torch.Tensor) -> torch.Tensor:
            return pixels.flatten(1) @ weights

    created = []

    def create_model(name: str, pretrained: str, device: str) -> Model:
        created.append((name, pretrained, device))
        return Model()

    monkeypatch.setitem(sys.modules, "open_clip", SimpleNamespace(create_model=create_model))
    embedder = open_clip_image_model("open_clip:ViT-B-16/laion2b_s34b_b88k")
    assert created == [("ViT-B-16", "laion2b_s34b_b88k", "cpu")]
    assert (embedder.dim, embedder.side, embedder.name) == (6, 10, "open_clip:ViT-B-16/laion2b_s34b_b88k")
    crops = torch.from_numpy(smooth_image(10, 10))[None]
    mean, std = (torch.tensor(each).view(3, 1, 1) for each in ([0.2, 0.3, 0.4], [0.5, 0.6, 0.7]))
    pixels = (crops.permute(0, 3, 1, 2) / 255 - mean) / std
    expected = torch.nn.functional.normalize(pixels.flatten(1) @ weights, dim=1)
    torch.testing.assert_close(embedder.embed(crops), expected)
