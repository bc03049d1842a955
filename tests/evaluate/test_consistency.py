"""Multi-view consistency on points whose observations are known."""

from __future__ import annotations

import pytest
import torch

from scoup import raster
from scoup.base.errors import InputError
from scoup.baselines.autoencoder import AutoencoderSettings
from scoup.evaluate.studies.consistency import (
    ConsistencyResult,
    consistency,
    consistency_plot,
    consistency_table,
    gap_differences,
)
from scoup.evaluate.studies.matches import Matches, dominant_gaussians
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.build_settings import BuildSettings
from support import make_camera, small_scene, unit

QUICK = AutoencoderSettings(epochs=1, encoder=(8, 3), decoder=(8,))
SETTINGS = BuildSettings(n_atoms=4, k=2, effort="fast")


def two_views(first: torch.Tensor, second: torch.Tensor) -> tuple[Cameras, Regions]:
    """Two views of 40 x 30, left half region 0 and right half region 1, pixel 0 without a region."""
    cameras = Cameras([make_camera(name="a.png"), make_camera(name="b.png")])
    labels = torch.zeros(30, 40, dtype=torch.int32)
    labels[:, 20:] = 1
    labels[0, 0] = -1
    maps = {
        name: {level: RegionMap(labels, rows) for level in ("s", "m", "l")}
        for name, rows in (("a.png", first), ("b.png", second))
    }
    return cameras, Regions.from_maps(maps)


def test_raw_cosines_are_those_of_the_regions() -> None:
    rows = unit(torch.randn(4, 16, generator=torch.Generator().manual_seed(0)))
    cameras, regions = two_views(rows[:2], rows[2:])
    points = [
        [("a.png", 5), ("b.png", 7)],  # left, left
        [("a.png", 5), ("b.png", 35)],  # left, right
        [("a.png", 0), ("b.png", 7)],  # no region
        [("a.png", 30), ("b.png", 30), ("b.png", 2)],  # three pairs
    ]
    results = consistency("s", Matches("by hand", points), cameras, regions, SETTINGS, QUICK)
    raw = next(result for result in results if (result.level, result.features) == ("m", "raw"))
    cos = (rows @ rows.T).tolist()
    expected = [cos[0][2], cos[0][3], (cos[1][3] + cos[1][2] + cos[3][2]) / 3]
    assert raw.cosines == pytest.approx(expected, abs=1e-5)
    assert raw.pairs == 5
    assert {result.features for result in results} == {"raw", "autoencoder", "sparse codes"}
    rows = consistency_table(results, {"s": "hand"}).rows
    assert len(rows) == 9 + 3
    raw = [row for row in rows if row[0] == "raw"]
    assert float(raw[-1][4]) == pytest.approx(sum(float(row[4]) for row in raw[:-1]) / 3, abs=2e-3)


def test_regions_that_share_a_code_are_alike() -> None:
    """With as many atoms as regions nothing is lost: sparse codes are as consistent as raw embeddings."""
    rows = unit(torch.randn(4, 16, generator=torch.Generator().manual_seed(1)))
    cameras, regions = two_views(rows[:2], rows[2:])
    points = [[("a.png", 5), ("b.png", 7)], [("a.png", 30), ("b.png", 35)]]
    results = consistency("s", Matches("by hand", points), cameras, regions, SETTINGS, QUICK)
    by_kind = {result.features: result.cosines for result in results if result.level == "s"}
    assert by_kind["sparse codes"] == pytest.approx(by_kind["raw"], abs=0.02)


def test_the_plot_shows_the_difference_that_counts() -> None:
    """Features that are all alike have the highest cosine of all, and the smallest gap."""
    cosines = {"raw": (0.8, 0.6), "autoencoder": (0.99, 0.99), "sparse codes": (0.9, 0.8)}
    unmatched = {"raw": (0.5, 0.5), "autoencoder": (0.97, 0.97), "sparse codes": (0.5, 0.6)}
    results = [
        ConsistencyResult("hall", "m", name, cosines[name], 2, 0.5, unmatched[name]) for name in cosines
    ]
    rows = gap_differences(results)
    assert [row[:3] for row in rows] == [("hall", "m", "autoencoder"), ("hall", "m", "sparse codes")]
    means = [row[3].mean for row in rows]
    assert means == pytest.approx([0.02 - 0.2, 0.3 - 0.2])
    assert rows[1][3].low == pytest.approx(0.1)  # of both points alike, so the interval has no extent
    plot = consistency_plot(results)
    assert plot.reference == 0
    assert [row[:2] for row in plot.rows] == [
        ("hall, level m", "autoencoder"),
        ("hall, level m", "sparse codes"),
    ]


def test_unmatched_observations_are_of_the_same_points() -> None:
    rows = unit(torch.randn(4, 16, generator=torch.Generator().manual_seed(2)))
    cameras, regions = two_views(rows[:2], rows[2:])
    points = [[("a.png", 5), ("b.png", 7)], [("a.png", 30), ("b.png", 35)], [("a.png", 2), ("b.png", 30)]]
    for result in consistency("s", Matches("by hand", points), cameras, regions, SETTINGS, QUICK):
        assert len(result.unmatched_cosines) == len(result.cosines) == 3
        assert sum(result.unmatched_cosines) / 3 == pytest.approx(result.unmatched)  # a pair a point


def test_no_overlap() -> None:
    rows = unit(torch.randn(4, 16))
    cameras, regions = two_views(rows[:2], rows[2:])
    with pytest.raises(InputError, match="two views"):
        consistency("s", Matches("by hand", [[("a.png", 4)]]), cameras, regions, SETTINGS, QUICK)


def test_gaussians_match_where_they_dominate() -> None:
    means = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, 5.0], [1.0, 0.0, 4.0]])
    scene = Gaussians(
        means, torch.tensor([[1.0, 0, 0, 0]] * 3), torch.full((3, 3), 0.2), torch.tensor([0.9, 0.9, 0.3]),
        torch.zeros(3, 1, 3),
    )  # fmt: skip
    cameras = [make_camera(name="a.png"), make_camera(name="b.png")]
    found = dominant_gaussians(scene, cameras)
    # The second hides behind the first, the third is faint.
    assert len(found.points) == 1
    centre = 15 * 40 + 20
    assert found.points[0] == [("a.png", centre), ("b.png", centre)]
    weights = raster.render_channels(raster.project(scene, cameras[0]), torch.eye(3))[0][15, 20]
    assert weights[0] > 0.5 > weights[1]


def test_scene_of_random_regions() -> None:
    gaussians, cameras, regions = small_scene(count=200, views=3)
    matches = dominant_gaussians(gaussians, list(cameras))
    results = consistency("s", matches, cameras, regions, SETTINGS, QUICK)
    for result in results:
        assert all(-1.001 <= value <= 1.001 for value in result.cosines)
