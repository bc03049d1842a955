"""Region features in the compact layout as the first code wrote them."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open

from frozen_versions import VERSIONS
from scoup.io import load_regions
from scoup.io.regions import compact
from scoup.io.regions.manifest import VERSION, read_manifest, write_manifest
from scoup.io.regions.views import ViewRegions
from support import small_scene

FIRST = VERSIONS / "5ee6213"


def test_they_are_read_as_they_were_written() -> None:
    cameras = small_scene(1, views=1, width=32, height=24, seed=7)[1]
    regions, kept = load_regions(FIRST, cameras), np.load(FIRST / "view_00.npz")
    for level in regions.levels:
        region_map = regions.load("view_00.png", level)
        assert np.array_equal(region_map.labels.numpy(), kept[f"labels.{level}"])
        unit = torch.nn.functional.normalize(torch.from_numpy(kept[f"embeddings.{level}"]).float(), dim=1)
        assert torch.allclose(region_map.embeddings.float(), unit, atol=1e-3)


def contents(path: Path) -> tuple[str, dict[str, bytes]]:
    """Header and tensors of a file, labels inflated: zlib's many versions pack them differently."""
    with safe_open(path, framework="numpy") as stream:
        tensors = {name: stream.get_tensor(name).tobytes() for name in stream.keys()}  # noqa: SIM118
        header = stream.metadata()["scoup"]
    labels = {name: zlib.decompress(packed) for name, packed in tensors.items() if name.startswith("labels.")}
    return header, tensors | labels


def test_the_same_is_written_today(tmp_path: Path) -> None:
    """A file of another form needs a version of its own, and its folder in tests/frozen/versions."""
    assert VERSION == 1
    kept, manifest = np.load(FIRST / "view_00.npz"), read_manifest(FIRST)
    assert manifest is not None
    of_levels = [
        {level: kept[f"{kind}.{level}"] for level in ("s", "m", "l")} for kind in ("labels", "embeddings")
    ]
    compact.write_view(
        tmp_path, "view_00", ViewRegions("view_00.png", of_levels[0], of_levels[1], ""), manifest.fingerprint
    )
    assert contents(tmp_path / "view_00.regions") == contents(FIRST / "view_00.regions")
    write_manifest(tmp_path, manifest)
    assert (tmp_path / "regions.json").read_text() == (FIRST / "regions.json").read_text()
