"""The city that is built within a limit of memory, and the model on paper that is fitted to its builds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks import city, city_model
from benchmarks.scenes.city import A_BLOCK, City, blocks, regions_of, street_cameras

from scoup import raster
from scoup.base.errors import InputError
from scoup.scene.cameras import Cameras


@pytest.mark.slow
def test_a_city_is_built_within_its_limit(tmp_path: Path) -> None:
    record = city.main(
        city.Arguments(
            sizes=(A_BLOCK,), views=(3,), views_of_sizes=2, size_of_views=A_BLOCK, threads=1, folder=tmp_path,
            out=tmp_path / "city.json",
        )
    )  # fmt: skip
    assert [(case["gaussians"], case["views"]) for case in record["cases"]] == [(A_BLOCK, 2), (A_BLOCK, 3)]
    for case in record["cases"]:
        assert 0 < case["coded"] <= A_BLOCK
        assert 0 < case["anonymous"] <= case["resident"] < 16e9
        assert case["bytes_of_splat"] > 200 * A_BLOCK
        assert 0 < case["seconds"]["region sums"] < case["seconds"]["total"]
    assert record["cases"][0]["bytes_of_sums"] < record["cases"][1]["bytes_of_sums"]
    assert record["cases"][0]["bytes_of_features"] < record["cases"][1]["bytes_of_features"]
    assert f"{A_BLOCK:,}" in city.table(record["cases"])
    assert [path.name for path in tmp_path.iterdir()] == ["city.json"]


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


def case(grows: str, n: int, v: int) -> dict[str, Any]:
    """A build that takes exactly what a model of this kind says."""
    seen = v * city_model.reach(n)
    sums = 4 * n + 700_000 * seen
    seconds = {"load": 1e-6 * n, "coding": 1e-4 * 900 * seen, "region sums": 0.1 * seen + 2e-7 * n,
               "vote": 1e-8 * sums + 5e-7 * n}  # fmt: skip
    return {
        "grows": grows,
        "gaussians": n,
        "views": v,
        "seconds": {**seconds, "total": sum(seconds.values()) + 2.0},
        "regions": [600 * seen, 200 * seen, 100 * seen],
        "bytes_of_splat": 248 * n,
        "bytes_of_features": 3_000_000 * v,
        "bytes_of_sums": sums,
        "bytes_of_field": 30 * n + 800_000,
        "anonymous": 3e8 + 70 * n + 2048 * 900 * seen,
    }


CASES = [case("gaussians", n, 100) for n in (1_000_000, 3_000_000, 10_000_000, 30_000_000)]
CASES += [case("views", 3_000_000, v) for v in (100, 300, 1000, 2000)]
CASES += [case("both", 10_000_000, 660)]


def test_the_model_predicts_what_follows_its_terms() -> None:
    fitted, held_out = city_model.split([city_model.flat(case) for case in CASES])
    assert [(of["N"], of["V"]) for of in held_out] == [
        (30_000_000, 100),
        (3_000_000, 2000),
        (10_000_000, 660),
    ]
    assert len(fitted) == 6
    model = city_model.fit(fitted)
    for of in held_out:
        ratios = city_model.checked(model, of)["predicted_by_measured"]
        np.testing.assert_allclose(list(ratios.values()), 1, rtol=1e-3)


def test_the_city_in_shares_and_in_districts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "measured.json"
    city.write_json(path, {"cases": CASES})
    record = city_model.main(city_model.Arguments(measured=path, out=tmp_path / "model.json"))
    one, districts = record["city"]["one scene"], record["city"]["districts"]
    assert one["bytes_of_splat"] == pytest.approx(248e9, rel=1e-3)
    assert one["region sums"] == pytest.approx(
        (0.1 * 1e6 * city_model.reach(1e9) + 2e-7 * 1e9) / 1000, rel=1e-3
    )
    assert districts["bytes_of_splat"] == pytest.approx(2 * 248e6, rel=1e-3)
    assert districts["total"] == pytest.approx(case("", 2_000_000, 1000)["seconds"]["total"], rel=1e-3)
    assert districts["price"] == pytest.approx(2.5 * 1000 * districts["total"] / 3600)
    limits = {name.split(",")[0]: of for name, of in record["limits"].items()}
    assert limits["embeddings of all regions"]["views"] == pytest.approx(64e9 / (900 * 2048), rel=1e-3)
    assert "own memory, GB" in capsys.readouterr().out


def test_too_few_builds_make_no_model() -> None:
    with pytest.raises(InputError, match="three builds at least"):
        city_model.split([city_model.flat(case) for case in CASES[:3]])
