"""The cache of predictions: found again, never for another field, camera or word; damage is mended."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from scoup.base.digests import file_sha256
from scoup_lab.evaluate.predictions import kept_map, prediction_key, tensor_digest
from support import make_camera


def key(**changes) -> str:
    arguments = {
        "source": "a", "camera": make_camera(), "labels": ["cup"], "vectors": torch.ones(1, 4),
        "canonical": torch.zeros(2, 4), "size": (40, 30),
    }  # fmt: skip
    return prediction_key(**{**arguments, **changes})


def test_keys_differ_in_all_that_matters() -> None:
    moved = make_camera(seed=1)
    others = [
        key(source="b"), key(camera=moved), key(camera=make_camera(focal=37.0)), key(labels=["pot"]),
        key(vectors=torch.zeros(1, 4)), key(canonical=torch.zeros(3, 4)), key(size=(41, 30)),
    ]  # fmt: skip
    assert len({key(), *others}) == len(others) + 1
    assert key() == key(camera=make_camera(name="other.png"))  # the same view by another name


def test_predicted_once_and_the_same_to_the_last_bit(tmp_path: Path) -> None:
    values = torch.rand(3, 2, 5, 6)
    calls = []

    def predict() -> torch.Tensor:
        calls.append(1)
        return values

    for _ in range(2):
        assert torch.equal(kept_map(tmp_path / "cache", "scene/frame", key(), predict), values)
    assert len(calls) == 1
    kept_map(tmp_path / "cache", "scene/frame", key(source="b"), predict)
    assert len(calls) == 2


@pytest.mark.parametrize("damage", [b"", b"\xff" * 40, None])
def test_damaged_maps_are_made_again(tmp_path: Path, damage: bytes | None) -> None:
    values = torch.rand(3, 1, 4, 4)
    kept_map(tmp_path, "f", key(), lambda: values * 0)
    (path,) = tmp_path.glob("*.safetensors")
    path.write_bytes(path.read_bytes()[:-7] if damage is None else damage)
    assert torch.equal(kept_map(tmp_path, "f", key(), lambda: values), values)
    assert torch.equal(kept_map(tmp_path, "f", key(), lambda: values * 0), values)


def test_digests(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"abc")
    assert file_sha256(path).startswith("ba7816bf")  # SHA-256 of "abc"
    assert tensor_digest(torch.zeros(2, 3)) != tensor_digest(torch.zeros(3, 2))
