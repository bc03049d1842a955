"""Dense encoders exported to ONNX: a tiny one against its formula, as an embedder of regions, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mask_samples import smooth_image
from onnx_models import node, save_onnx, value
from scoup import TextEncoder
from scoup.base.errors import FileFormatError, MissingFileError, ScoupError
from scoup.extract import open_embedder
from scoup.extract.dense import DenseEmbedder
from scoup.extract.masks import Masks
from scoup.models.onnx_dense import OnnxDenseModel, open_onnx_dense

SIDE, PATCH, DIM = 16, 4, 6


def save(path: Path, as_tokens: bool = False, shape: tuple[Any, ...] = (1, 3, SIDE, SIDE)) -> np.ndarray:
    """Write an encoder that is one linear map of each patch, [D, 3, p, p]; as tokens [1, h * w, D] or a map."""
    kernel = np.random.default_rng(3).normal(size=(DIM, 3, PATCH, PATCH)).astype(np.float32)
    nodes = [node("Conv", ["pixels", "kernel"], ["map"], strides=[PATCH, PATCH])]
    if as_tokens:
        nodes.append(node("Reshape", ["map", "flat"], ["rows"]))
        nodes.append(node("Transpose", ["rows"], ["tokens"], perm=[0, 2, 1]))
    outputs = [value("tokens" if as_tokens else "map", None)]
    save_onnx(path, nodes, [value("pixels", shape)], outputs, kernel=kernel, flat=np.array([1, DIM, -1]))
    return kernel


@pytest.mark.parametrize("as_tokens", [False, True])
def test_features_are_those_of_the_formula(tmp_path: Path, as_tokens: bool) -> None:
    kernel = save(tmp_path / "tiny.onnx", as_tokens)
    model = open_onnx_dense(f"onnx:{tmp_path / 'tiny.onnx'}")
    assert (model.side, model.patch, model.dim, model.name) == (SIDE, PATCH, DIM, "onnx:tiny")
    pixels = torch.rand(3, 24, 20, generator=torch.Generator().manual_seed(1))
    found = model.tokens(pixels)
    wanted = np.zeros((6, 5, DIM), np.float32)
    for row in range(6):
        for column in range(5):
            patch = pixels[:, row * PATCH : (row + 1) * PATCH, column * PATCH : (column + 1) * PATCH].numpy()
            vector = np.array([(kernel[d] * patch).sum() for d in range(DIM)])
            wanted[row, column] = vector / np.linalg.norm(vector)
    np.testing.assert_allclose(found.numpy(), wanted, atol=1e-5)
    shares = torch.zeros(2, 6, 5)
    shares[0, 1, 2], shares[0, 1, 3], shares[1, 5, 4] = 1.0, 0.25, 0.5
    mixed = wanted[1, 2] + 0.25 * wanted[1, 3]
    pooled = model.pool(found, shares).numpy()
    np.testing.assert_allclose(pooled, [mixed / np.linalg.norm(mixed), wanted[5, 4]], atol=1e-5)


def test_it_embeds_regions_and_is_in_the_record(tmp_path: Path) -> None:
    save(tmp_path / "tiny.onnx")
    embedder = open_embedder(f"dense:onnx:{tmp_path / 'tiny.onnx'}")
    assert isinstance(embedder, DenseEmbedder)
    assert isinstance(embedder.model, OnnxDenseModel)
    record = embedder.to_dict()
    assert (record["embedder"], len(str(record["embedder_sha256"]))) == ("onnx:tiny", 64)
    whole = {"s": Masks.from_dense(np.ones((1, 40, 56), bool))}
    (vector,) = embedder.embed_regions(torch.from_numpy(smooth_image(40, 56)), whole)["s"]
    assert vector.norm().item() == pytest.approx(1)
    with pytest.raises(ScoupError, match="pass a table of the vectors of words"):
        TextEncoder.open("onnx:tiny")


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="there is no such file"):
        open_onnx_dense(f"onnx:{tmp_path / 'none.onnx'}")
    (tmp_path / "bad.onnx").write_bytes(b"no model")
    with pytest.raises(FileFormatError, match="cannot be loaded"):
        open_onnx_dense(f"onnx:{tmp_path / 'bad.onnx'}")
    for shape, message in (
        ((1, 3, "h", "w"), "takes"),
        ((1, 3, 16, 20), "takes"),
        ((1, 3, 18, 18), "returns"),
    ):
        save(tmp_path / "odd.onnx", shape=shape)
        with pytest.raises(FileFormatError, match=message) as caught:
            open_onnx_dense(f"onnx:{tmp_path / 'odd.onnx'}")
        assert "pixels \\[1, 3, S, S\\] in 0..1".replace("\\", "") in str(caught.value)
