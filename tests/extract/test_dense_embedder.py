"""Embeddings of regions out of one pass, through the whole extraction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from extract.test_pipeline import scene
from mask_samples import random_masks, smooth_image
from scoup.extract import Masks, extract, find_photographs, open_embedder, open_segmenter
from scoup.extract.dense import DenseEmbedder
from scoup.extract.interfaces import RegionEmbedder
from scoup.io import RegionManifest, load_regions
from tiny_models import saved, tiny_clip, tiny_siglip


@pytest.fixture(params=["clip", "siglip"])
def folder(request, tmp_path: Path) -> Path:
    return saved({"clip": tiny_clip, "siglip": tiny_siglip}[request.param](), tmp_path / request.param)


@pytest.mark.parametrize("size", [(40, 56), (90, 31)])
def test_regions_are_pooled_over_the_places_that_they_cover(folder: Path, size: tuple[int, int]) -> None:
    embedder = open_embedder(f"dense:{folder}")
    assert isinstance(embedder, RegionEmbedder)
    assert isinstance(embedder, DenseEmbedder)
    image = torch.from_numpy(smooth_image(*size))
    dense = random_masks(40, *size, seed=3)
    dense = dense[dense.any((1, 2))]
    found = embedder.embed_regions(image, {"s": Masks.from_dense(dense), "m": Masks.from_dense(dense[:0])})
    assert found["s"].shape == (len(dense), embedder.dim)
    assert found["m"].shape == (0, embedder.dim)
    torch.testing.assert_close(found["s"].norm(dim=1), torch.ones(len(dense)))
    # By hand: the scaled photograph's tokens, and the mask's share of each.
    rows, columns = (round(length * 8 / min(size)) for length in size)
    pixels, scaled = image.permute(2, 0, 1)[None].float() / 255, (rows * 8, columns * 8)
    pixels = torch.nn.functional.interpolate(pixels, scaled, mode="bilinear", antialias=True)
    tokens = embedder.model.tokens(pixels[0])
    assert tokens.shape[:2] == (rows, columns)
    for number in (0, len(dense) - 1):
        shares = torch.zeros(1, rows, columns)
        for row in range(rows):
            for column in range(columns):
                y0, y1 = row * size[0] // rows, -(-(row + 1) * size[0] // rows)
                x0, x1 = column * size[1] // columns, -(-(column + 1) * size[1] // columns)
                shares[0, row, column] = float(dense[number, y0:y1, x0:x1].mean())
        expected = embedder.model.pool(tokens, shares)[0]
        torch.testing.assert_close(found["s"][number], expected, atol=1e-5, rtol=1e-4)


def test_an_extraction_with_it_names_the_model_for_texts(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("skimage")
    photographs, cameras = scene(tmp_path / "scene", 1)
    out = tmp_path / "regions"
    segmenter, embedder = open_segmenter("felzenszwalb"), open_embedder(f"dense:{folder}")
    extract(find_photographs(photographs), out, segmenter, embedder)
    manifest = RegionManifest.read(out)
    assert manifest is not None
    assert manifest.settings["embedder"] == str(folder)
    assert manifest.settings["embedder_pooling"] == "dense"
    embeddings = load_regions(out, cameras).load("0.png", "s").embeddings
    assert embeddings.shape[1] == embedder.dim
    assert np.isfinite(embeddings.numpy()).all()
