"""Crops against the recipe written out, and embeddings of tiny CLIP and SigLIP models after a round trip."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from extract_support import mask_stacks, random_masks, smooth_image
from hypothesis import given
from hypothesis import strategies as st
from literal_rules import crop_of, exact_crop_of
from tiny_models import saved, tiny_clip, tiny_sam, tiny_siglip

from scoup.base.errors import InputError, ScoupError
from scoup.extract.crops import mask_crops
from scoup.extract.masks import Masks
from scoup.extract.opening import open_embedder
from scoup.extract.plain_colors import PlainColors
from scoup.models.image import open_image_model

os.environ["HF_HUB_OFFLINE"] = "1"

CLIP_MEAN, CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)


def all_crops(
    image: np.ndarray, dense: np.ndarray, side: int, cut_last: bool = True, batch: int = 3
) -> np.ndarray:
    masks = Masks.from_dense(dense)
    parts = list(mask_crops(torch.from_numpy(image), masks, side, cut_last, batch))
    assert [len(part) for part in parts[:-1]] == [batch] * (len(parts) - 1)
    return torch.cat(parts).numpy() if parts else np.zeros((0, side, side, 3), np.uint8)


@given(mask_stacks(most=8), st.sampled_from([1, 7, 32]), st.booleans())
def test_crops_are_those_of_the_recipe(dense: np.ndarray, side: int, cut_last: bool) -> None:
    dense = dense[dense.any((1, 2))]
    image = np.random.default_rng(0).integers(0, 256, (*dense.shape[1:], 3)).astype(np.uint8)
    crops = all_crops(image, dense, side, cut_last)
    for crop, mask in zip(crops, dense, strict=True):
        # Sums in another order may round the other way, where they lie halfway between two numbers.
        assert np.abs(crop - exact_crop_of(image, mask, side, cut_last)).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("build", [tiny_clip, tiny_siglip])
def test_embeddings_are_those_of_the_model_fed_by_hand(build, tmp_path: Path) -> None:
    """Within 1e-3 cosine of LangSplat's recipe: literal crops, CLIP's normalisation, unit length."""
    model = build()
    embedder = open_image_model(str(saved(model, tmp_path)))
    assert (embedder.dim, embedder.side) == ((12, 32) if build is tiny_clip else (16, 32))
    image = smooth_image(60, 80)
    dense = random_masks(20, 60, 80, 1)
    dense = dense[dense.any((1, 2))]
    rows = torch.cat(
        [embedder.embed(c) for c in mask_crops(torch.from_numpy(image), Masks.from_dense(dense), 32)]
    )
    literal = np.stack([crop_of(image, mask, 32) for mask in dense]) / 255
    mean, std = (CLIP_MEAN, CLIP_STD) if build is tiny_clip else ((0.5,) * 3, (0.5,) * 3)
    pixels = torch.from_numpy((literal - mean) / std).float().permute(0, 3, 1, 2)
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
    assert plain.record()["embedder"] == str(tmp_path / "a")


def test_what_cannot_be_loaded_is_told(tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(ScoupError, match=r"embedder 'laion/nothing' cannot be loaded .*colors"):
        open_embedder("laion/nothing")
    with pytest.raises(ScoupError, match="'sam' models have no image features"):
        open_embedder(str(saved(tiny_sam(), tmp_path)))
    with pytest.raises(InputError, match="ARCHITECTURE/PRETRAINED"):
        open_embedder("open_clip:ViT-B-16")
    monkeypatch.setitem(sys.modules, "open_clip", None)
    with pytest.raises(ScoupError, match=r"pip install 'scoup\[open-clip\]'"):
        open_embedder("open_clip:ViT-B-16/laion2b_s34b_b88k")


def test_open_clip_models_are_used_through_their_own_interface(monkeypatch) -> None:
    """A stand-in for the package: the size and normalisation of its image tower are used."""
    weights = torch.randn(3 * 10 * 10, 6, generator=torch.Generator().manual_seed(0))

    class Model(torch.nn.Module):
        visual = SimpleNamespace(image_size=(10, 10), image_mean=(0.2, 0.3, 0.4), image_std=(0.5, 0.6, 0.7))

        def encode_image(self, pixels: torch.Tensor) -> torch.Tensor:
            return pixels.flatten(1) @ weights

    asked = []

    def create_model(name: str, pretrained: str, device: str) -> Model:
        asked.append((name, pretrained, device))
        return Model()

    monkeypatch.setitem(sys.modules, "open_clip", SimpleNamespace(create_model=create_model))
    embedder = open_embedder("open_clip:ViT-B-16/laion2b_s34b_b88k")
    assert asked == [("ViT-B-16", "laion2b_s34b_b88k", "cpu")]
    assert (embedder.dim, embedder.side, embedder.name) == (6, 10, "open_clip:ViT-B-16/laion2b_s34b_b88k")
    crops = torch.from_numpy(smooth_image(10, 10))[None]
    pixels = (crops.permute(0, 3, 1, 2) / 255 - torch.tensor([0.2, 0.3, 0.4]).view(3, 1, 1)) / torch.tensor(
        [0.5, 0.6, 0.7]
    ).view(3, 1, 1)
    expected = torch.nn.functional.normalize(pixels.flatten(1) @ weights, dim=1)
    torch.testing.assert_close(embedder.embed(crops), expected)


def test_plain_colors_tell_colours_apart_and_ignore_what_is_black() -> None:
    embedder = PlainColors()
    red, green = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    red[..., 0], green[..., 1] = 200, 200
    half = red.clone()
    half[:, 32:] = 0
    striped = red.clone()
    striped[::4] = 90
    rows = embedder.embed(torch.stack([red, green, half, striped, torch.zeros_like(red)]))
    assert rows.shape == (5, embedder.dim)
    cosines = rows @ rows.T
    torch.testing.assert_close(rows[:4].norm(dim=1), torch.ones(4))
    assert float(rows[4].abs().sum()) == 0  # nothing to see: "unknown"
    assert float(cosines[0, 2]) > 0.9  # the same colour, half of it
    assert float(cosines[0, 1]) < 0.5
    assert float(cosines[0, 3]) < float(cosines[0, 2])
