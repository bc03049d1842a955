"""Dense encoders exported to ONNX: a tiny one against its formula, through an extraction, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from mask_samples import smooth_image
from scoup import TextEncoder
from scoup.base.errors import FileFormatError, MissingFileError, ScoupError
from scoup.extract import extract, find_photographs, open_embedder, open_segmenter
from scoup.extract.dense import DenseEmbedder
from scoup.extract.masks import Masks
from scoup.io.regions.manifest import read_manifest
from scoup.models.onnx_dense import OnnxDenseModel, open_onnx_dense

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402 - after the check that it is there

SIDE, PATCH, DIM = 16, 4, 6


def save(path: Path, as_tokens: bool = False, shape: tuple[Any, ...] = (1, 3, SIDE, SIDE)) -> np.ndarray:
    """Write an encoder that is one linear map of each patch, [D, 3, p, p]; as tokens [1, h * w, D] or a map."""
    kernel = np.random.default_rng(3).normal(size=(DIM, 3, PATCH, PATCH)).astype(np.float32)
    nodes = [helper.make_node("Conv", ["pixels", "kernel"], ["map"], strides=[PATCH, PATCH])]
    constants = {"kernel": kernel, "flat": np.array([1, DIM, -1])}
    if as_tokens:
        nodes.append(helper.make_node("Reshape", ["map", "flat"], ["rows"]))
        nodes.append(helper.make_node("Transpose", ["rows"], ["tokens"], perm=[0, 2, 1]))
    tensors = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    inputs = [helper.make_tensor_value_info("pixels", TensorProto.FLOAT, shape)]
    outputs = [helper.make_tensor_value_info("tokens" if as_tokens else "map", TensorProto.FLOAT, None)]
    graph = helper.make_graph(nodes, "encoder", inputs, outputs, tensors)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 16)], ir_version=8), path)
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


def test_it_embeds_the_regions_of_photographs(tmp_path: Path) -> None:
    pytest.importorskip("skimage")
    save(tmp_path / "tiny.onnx")
    (tmp_path / "images").mkdir()
    Image.fromarray(smooth_image(40, 56)).save(tmp_path / "images" / "view.png")
    embedder = open_embedder(f"dense:onnx:{tmp_path / 'tiny.onnx'}")
    assert isinstance(embedder, DenseEmbedder)
    assert isinstance(embedder.model, OnnxDenseModel)
    photographs, out = find_photographs(tmp_path), tmp_path / "features"
    extract(photographs, out, open_segmenter("felzenszwalb"), embedder)
    manifest = read_manifest(out)
    assert manifest is not None
    assert manifest.settings["embedder"] == "onnx:tiny"
    assert len(manifest.settings["embedder_sha256"]) == 64
    whole = np.ones((1, 40, 56), bool)
    (vector,) = embedder.embed_regions(
        torch.from_numpy(smooth_image(40, 56)), {"s": Masks.from_dense(whole)}
    )["s"]
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
