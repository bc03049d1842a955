"""ONNX pairs in both layouts: tiny graphs that paint a disc around the point, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from onnx_models import node, save_onnx, value
from scoup.base.errors import FileFormatError, MissingFileError, ScoupError
from scoup.extract import mask_settings, open_segmenter
from scoup.models.onnx_sam import open_onnx_sam

SIDE = 64
GRID = SIDE // 4
RADII = (99.0, 8.0, 16.0, 24.0)  # of the four masks; the first is for prompts without doubt


def save_encoder(folder: Path, second: bool) -> None:
    """The embedding is the mean of the image in every token: the points alone decide the masks."""
    nodes = [node("ReduceMean", ["image"], ["mean"], keepdims=0)]
    outputs = ["image_embed", "high_res_feats_0", "high_res_feats_1"] if second else ["image_embeddings"]
    nodes += [node("Expand", ["mean", "shape"], [name]) for name in outputs]
    shape = [1, 3, SIDE, SIDE] if second else ["height", "width", 3]
    values = [value(name, [1, 1, 4, 4]) for name in outputs]
    save_onnx(
        folder / "tiny_encoder.onnx", nodes, [value("image", shape)], values, shape=np.array([1, 1, 4, 4])
    )


def save_decoder(
    folder: Path, second: bool, masks: int = 4, batch: Any = "count", name: str = "tiny_decoder"
) -> None:
    """Logits are ten times radius - distance to the first point, in pixels of the model's square."""
    first = 4 - masks
    y, x = np.mgrid[:GRID, :GRID].astype(np.float32) * 4 + 2
    constants = {
        "grid": np.stack([x, y])[None, None],  # [1, 1, 2, h, w]
        "steep": np.array(10, np.float32),
        "radii": np.array(RADII[first:], np.float32)[None, :, None, None],
        "scores": np.array([[0.1, 0.95, 0.9, 0.85][first:]], np.float32),
        "zero": np.array([0]), "one": np.array([1]), "shape5": np.array([-1, 1, 2, 1, 1]),
    }  # fmt: skip
    outputs = ["masks" if second else "low_res_masks", "iou_predictions"]
    embeddings = ["image_embed", "high_res_feats_0", "high_res_feats_1"] if second else ["image_embeddings"]
    nodes = [
        node("Slice", ["point_coords", "zero", "one", "one"], ["point"]),  # [B, 1, 2]
        node("Reshape", ["point", "shape5"], ["placed"]),
        node("Sub", ["grid", "placed"], ["offset"]),
        node("ReduceL2", ["offset"], ["distance"], axes=[2], keepdims=0),  # [B, 1, h, w]
        node("Sub", ["radii", "distance"], ["inside"]),
        node("Mul", ["inside", "steep"], [outputs[0]]),
        # Labels of first points are 1; what is added is 0, for every point.
        node("Slice", ["point_labels", "zero", "one", "one"], ["label"]),  # [B, 1]
        node("Mul", ["label", "scores"], [outputs[1]]),
    ]

    inputs = [
        *(value(key, [1, 1, 4, 4]) for key in embeddings),
        value("point_coords", [batch, "points", 2]), value("point_labels", [batch, "points"]),
        value("mask_input", [batch, 1, GRID, GRID]), value("has_mask_input", [1]),
        *([] if second else [value("orig_im_size", [2])]),
    ]  # fmt: skip
    results = [value(outputs[0], [batch, masks, GRID, GRID]), value(outputs[1], [batch, masks])]
    save_onnx(folder / f"{name}.onnx", nodes, inputs, results, **constants)


@pytest.fixture(autouse=True)
def small_square(monkeypatch) -> None:
    monkeypatch.setattr("scoup.models.onnx_sam.SIDE", SIDE)


@pytest.mark.parametrize(
    ("second", "masks", "batch"), [(False, 4, "count"), (False, 4, 1), (True, 3, "count")]
)
@pytest.mark.parametrize("size", [(40, 64), (64, 64), (90, 30)])
def test_masks_lie_around_their_points(tmp_path: Path, second: bool, masks: int, batch: Any, size) -> None:
    save_encoder(tmp_path, second)
    save_decoder(tmp_path, second, masks, batch)
    model = open_onnx_sam(f"onnx:{tmp_path}")
    image = np.zeros((*size, 3), np.uint8)
    height, width = size
    points = torch.tensor([[width / 4, height / 2], [width * 0.6, height * 0.4], [2.0, 3.0]] * 2).double()
    encoded = model.encode(image)
    logits, iou = encoded.predict(points)
    assert logits.shape == (6, 3, GRID, GRID)
    torch.testing.assert_close(iou, torch.tensor([[0.95, 0.9, 0.85]]).expand(6, 3))
    large = encoded.upscale(logits.flatten(0, 1)).view(6, 3, *size)
    # Stretched images have discs that are stretched back.
    factor = (SIDE / width, SIDE / height) if second else (SIDE / max(size), SIDE / max(size))
    y, x = np.mgrid[:height, :width] + 0.5
    for number, (px, py) in enumerate(points.numpy()):
        distance = np.hypot((x - px) * factor[0], (y - py) * factor[1])
        for channel, radius in enumerate(RADII[1:]):
            certain = np.abs(distance - radius) > 3
            inside = (large[number, channel] > 0).numpy()
            assert np.array_equal(inside[certain], (distance < radius)[certain])


def test_a_pair_segments_an_image_and_its_files_are_in_the_record(tmp_path: Path) -> None:
    save_encoder(tmp_path, second=False)
    save_decoder(tmp_path, second=False)
    save_decoder(
        tmp_path, second=False, masks=1, name="tiny_decoder_single"
    )  # beside it, as they are published
    segmenter = open_segmenter(f"onnx:{tmp_path}", mask_settings("fast", points_per_side=4))
    masks = segmenter.segment(np.zeros((64, 64, 3), np.uint8))
    small = masks["s"].dense()
    assert len(small) == 16
    assert np.mean(small.sum((1, 2))) == pytest.approx(np.pi * 8**2, rel=0.1)
    first, second = segmenter.to_dict()["segmenter_sha256"]
    assert len(first) == len(second) == 64
    assert first != second


def test_other_files_are_refused(tmp_path: Path) -> None:
    def refused(error: type[ScoupError], said: str, folder: str = "") -> None:
        with pytest.raises(error, match=said):
            open_onnx_sam(f"onnx:{tmp_path / folder}")

    refused(MissingFileError, "there is no such folder", "none")
    refused(MissingFileError, r"contains 0 files named \*encoder\*")
    save_encoder(tmp_path, second=True)
    pointer = b"version https://git-lfs.github.com/spec/v1\n"
    for content, said in ((b"no model", "cannot be loaded"), (pointer, "is a pointer of Git LFS")):
        (tmp_path / "a_decoder.onnx").write_bytes(content)
        refused(FileFormatError, rf"a_decoder.onnx: {said}")
    (tmp_path / "a_decoder.onnx").unlink()
    save_decoder(tmp_path, second=False)
    refused(FileFormatError, "does not take its encoder")
    save_encoder(tmp_path, second=False)
    save_decoder(tmp_path, second=False, masks=1)
    refused(FileFormatError, "returns one mask per point")
    save_decoder(tmp_path, second=False, name="other_decoder")
    refused(MissingFileError, r"contains 2 files named \*decoder\*")


def test_a_missing_runtime_is_named(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(ScoupError, match=r"needs the package onnxruntime: pip install 'scoup\[onnx\]'"):
        open_onnx_sam(f"onnx:{tmp_path}")
