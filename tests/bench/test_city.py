"""The city that is built within a limit of memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.city import Cities
from benchmarks.scenes.city import A_BLOCK, City, blocks, regions_of, street_cameras
from benchmarks.study import run

from scoup import raster
from scoup.scene.cameras import Cameras


@pytest.mark.slow
def test_a_city_is_built_within_its_limit(tmp_path: Path) -> None:
    study = Cities(
        sizes=(A_BLOCK,), views=(3,), views_of_sizes=2, size_of_views=A_BLOCK, threads=1, folder=tmp_path
    )
    record = run(study, "city")
    assert [(case["gaussians"], case["views"]) for case in record["cases"]] == [(A_BLOCK, 2), (A_BLOCK, 3)]
    for case in record["cases"]:
        assert 0 < case["coded"] <= A_BLOCK
        assert 0 < case["anonymous"] <= case["resident"] < 16e9
        assert case["bytes_of_splat"] > 200 * A_BLOCK
        assert 0 < case["seconds"]["region sums"] < case["seconds"]["total"]
    assert record["cases"][0]["bytes_of_sums"] < record["cases"][1]["bytes_of_sums"]
    assert f"{A_BLOCK:,}" in study.table(record)
    assert not list(tmp_path.iterdir())


def test_regions_of_a_city_lie_where_its_gaussians_are() -> None:
    plan = City(4)
    cameras = street_cameras(plan, 6, 96, 64)
    regions = regions_of(plan, cameras)
    parts = list(blocks(plan))
    whole = replace(
        parts[0],
        **{
            name: torch.cat([getattr(part, name) for part in parts])
            for name in ("means", "quats", "scales", "opacities", "sh")
        },
    )
    agree = []
    for camera in cameras:
        labels = {level: regions.load(camera.name, level).labels for level in regions.levels}
        there = labels["s"] >= 0
        assert torch.equal(there, labels["l"] >= 0)
        for fine, coarse in (("s", "m"), ("m", "l")):  # each part lies in one whole
            pairs = torch.stack([labels[fine][there], labels[coarse][there]], 1).unique(dim=0)
            assert len(pairs) == len(pairs[:, 0].unique())
        projection = raster.project(whole, camera.resized(there.shape[1], there.shape[0]), "inria")
        alpha = raster.render_channels(projection, torch.ones(len(whole), 1))[1]
        agree.append(float(((alpha > 0.5) == there).float().mean()))
    assert min(agree) > 0.9


def test_a_city_is_the_same_again() -> None:
    first, second = (list(blocks(City(2)))[1] for _ in range(2))
    assert first.fingerprint() == second.fingerprint()
    cameras = street_cameras(City(2), 2)
    maps = [regions_of(City(2), Cameras(list(cameras))).load(cameras[1].name, "m") for _ in range(2)]
    assert torch.equal(maps[0].labels, maps[1].labels)
    assert torch.equal(maps[0].embeddings, maps[1].embeddings)
