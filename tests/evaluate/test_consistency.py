"""Multi-view consistency on points whose observations are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from messages import refuses
from scoup import raster
from scoup.coding import fit_codes
from scoup.scene import Camera, Cameras, RegionMap, Regions
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import AutoencoderSettings, fit_autoencoder
from scoup_lab.evaluate.studies.consistency import (
    ConsistencyResult,
    consistency,
    consistency_table,
    gap_differences,
)
from scoup_lab.evaluate.studies.matches import Matches, dominant_gaussians, tracked_points
from support import gaussians_at, make_camera, unit

QUICK = AutoencoderSettings(epochs=1, encoder=(8, 3), decoder=(8,))
SETTINGS = BuildSettings(n_atoms=4, k=2, effort="fast")


CAMERAS = Cameras([make_camera(name="a.png"), make_camera(name="b.png")])
FEATURES = {"raw", "autoencoder", "sparse codes"}


def two_views(labels: torch.Tensor, rows: torch.Tensor, levels: str = "m") -> Regions:
    """Two views of the same labels; half of the rows are embeddings of the first one."""
    halves = zip(CAMERAS.names, rows.chunk(2), strict=True)
    return Regions.from_maps({name: dict.fromkeys(levels, RegionMap(labels, half)) for name, half in halves})


def halves(seed: int) -> tuple[torch.Tensor, Regions]:
    """Four embeddings, and views of 40 x 30: left half region 0, right half region 1, pixel 0 without a region."""
    labels = (torch.arange(40) >= 20).int().repeat(30, 1)
    labels[0, 0] = -1
    rows = unit(torch.randn(4, 16, generator=torch.Generator().manual_seed(seed)))
    return rows, two_views(labels, rows, "sml")


def measured(
    points: list, regions: Regions, settings: BuildSettings = SETTINGS, network=QUICK, seed: int = 0
):
    return consistency("s", Matches("by hand", points), CAMERAS, regions, settings, network, seed=seed)


def test_raw_cosines_are_those_of_the_regions() -> None:
    rows, regions = halves(0)
    points = [
        [("a.png", 5), ("b.png", 7)],  # left, left
        [("a.png", 5), ("b.png", 35)],  # left, right
        [("a.png", 0), ("b.png", 7)],  # no region
        [("a.png", 30), ("b.png", 30), ("b.png", 2)],  # three pairs
    ]
    results = measured(points, regions)
    raw = next(result for result in results if (result.level, result.features) == ("m", "raw"))
    cos = (rows @ rows.T).tolist()
    expected = [cos[0][2], cos[0][3], (cos[1][3] + cos[1][2] + cos[3][2]) / 3]
    assert raw.cosines == pytest.approx(expected, abs=1e-5)
    assert raw.pairs == 5
    pairs = [[("a.png", 5), ("b.png", 7)], [("a.png", 30), ("b.png", 35)], [("a.png", 2), ("b.png", 30)]]
    for result in measured(pairs, regions):  # unmatched observations are of the same points
        assert len(result.unmatched_cosines) == len(result.cosines) == 3
        assert sum(result.unmatched_cosines) / 3 == pytest.approx(result.unmatched)
    assert {result.features for result in results} == FEATURES
    rows = consistency_table(results).rows
    assert len(rows) == 9 + 3
    raw = [row for row in rows if row[0] == "raw"]
    assert float(raw[-1][4]) == pytest.approx(sum(float(row[4]) for row in raw[:-1]) / 3, abs=2e-3)
    with refuses():  # no overlap
        measured([[("a.png", 4)]], regions)


def test_each_kind_of_feature_is_compared_between_the_observations_of_a_point() -> None:
    """Three stripes, each seen in two views, with six embeddings, which neither four atoms nor three numbers and a
    small network can tell apart: what is decoded differs. So do the cosines of the pairs: none may be mixed up."""
    rows = unit(torch.randn(6, 16, generator=torch.Generator().manual_seed(1)))
    labels = (torch.arange(40) // 14).int().repeat(30, 1)
    points = [[("a.png", column), ("b.png", column + 40)] for column in (3, 20, 35)]
    settings = BuildSettings(n_atoms=4, k=1, keep=1, effort="fast")
    network_settings = replace(QUICK, epochs=60, learning_rate=0.01)
    results = measured(points, two_views(labels, rows), settings, network_settings, seed=3)
    network = fit_autoencoder(rows, network_settings, 3)
    book = fit_codes(rows, n_atoms=4, k=1, effort="fast", seed=3)
    decoded = {
        "raw": rows,
        "autoencoder": network.decode(network.encode(rows)),
        "sparse codes": unit(book.codes.to_dense() @ book.atoms),
    }
    by_kind = {result.features: result for result in results}
    cosines = {kind: (values[:3] * values[3:]).sum(1) for kind, values in decoded.items()}
    for kind, expected in cosines.items():
        assert by_kind[kind].cosines == pytest.approx(expected.tolist(), abs=1e-4), kind
        assert len({round(cosine, 1) for cosine in expected.tolist()}) == 3
        assert kind == "raw" or (expected - cosines["raw"]).abs().max() > 0.1


def test_unmatched_is_what_is_left_when_partners_are_exchanged() -> None:
    """Each of 40 columns is a region of its own, all at right angles: alike where matched, else not."""
    labels = torch.arange(40, dtype=torch.int32).repeat(30, 1)
    points = [[("a.png", column), ("b.png", column)] for column in range(40)]
    settings = BuildSettings(n_atoms=40, k=1, keep=1, effort="fast")
    results = measured(points, two_views(labels, torch.eye(40).repeat(2, 1)), settings)
    for kind in ("raw", "sparse codes"):
        (result,) = (each for each in results if each.features == kind)
        assert result.cosines == pytest.approx([1.0] * 40, abs=1e-3)
        assert result.unmatched < 0.2


def test_points_of_a_model_are_observed_where_they_project_to(tmp_path: Path) -> None:
    """And only in the images of their own track."""
    cameras = Cameras([make_camera(name=f"{name}.png", seed=seed) for seed, name in enumerate("abc")])
    positions = torch.tensor([[0.1, -0.2, 4.3], [-0.3, 0.1, 5.2]])
    tracks = zip(positions.tolist(), ("1 0 2 0", "2 0 3 0"), strict=True)
    lines = [f"{number} {x} {y} {z} 0 0 0 0.1 {track}" for number, ((x, y, z), track) in enumerate(tracks, 1)]
    (tmp_path / "points3D.txt").write_text("\n".join(lines))
    images = (f"{n} 1 0 0 0 0 0 0 1 {name}\n1 1 -1\n" for n, name in enumerate(cameras.names, 1))
    (tmp_path / "images.txt").write_text("".join(images))

    def observed(camera: Camera, position: torch.Tensor) -> tuple[str, int]:
        x, y, z = (camera.viewmat[:3, :3].float() @ position + camera.viewmat[:3, 3].float()).tolist()
        column, row = int(camera.fx * x / z + camera.cx), int(camera.fy * y / z + camera.cy)
        return camera.name, row * camera.width + column

    a, b, c = cameras
    matches = tracked_points(tmp_path, cameras)
    assert matches is not None
    first, second = positions
    assert matches.points == [
        [observed(a, first), observed(b, first)],
        [observed(b, second), observed(c, second)],
    ]


def test_the_table_shows_the_difference_that_counts() -> None:
    """Features that are all alike have the highest cosine of all, and the smallest gap."""
    cosines = {"raw": (0.8, 0.6), "autoencoder": (0.99, 0.99), "sparse codes": (0.9, 0.8)}
    unmatched = {"raw": (0.5, 0.5), "autoencoder": (0.97, 0.97), "sparse codes": (0.5, 0.6)}
    results = [
        ConsistencyResult("hall", "m", name, cosines[name], 2, 0.5, unmatched[name]) for name in cosines
    ]
    rows = gap_differences(results)
    assert [row[:3] for row in rows] == [("hall", "m", "autoencoder"), ("hall", "m", "sparse codes")]
    assert [row[3].mean for row in rows] == pytest.approx([0.02 - 0.2, 0.3 - 0.2])
    assert rows[1][3].low == pytest.approx(0.1)  # of both points alike, so the interval has no extent
    shown = {row[0]: row[-1] for row in consistency_table(results).rows if row[1] == "hall"}
    assert shown["raw"] == "-"
    assert shown["autoencoder"].startswith("-0.180 [")
    assert shown["sparse codes"] == "+0.100 [+0.100, +0.100]"


def test_gaussians_match_where_they_dominate() -> None:
    """The second hides behind the first, the third is faint."""
    scene = gaussians_at(torch.tensor([[0.0, 0, 3], [0, 0, 5], [1, 0, 4]]), 0.2)
    scene = replace(scene, opacities=torch.tensor([0.9, 0.9, 0.3]))
    centre = 15 * 40 + 20
    assert dominant_gaussians(scene, list(CAMERAS)).points == [[("a.png", centre), ("b.png", centre)]]
    weights = raster.render_channels(raster.project(scene, CAMERAS[0]), torch.eye(3))[0][15, 20]
    assert weights[0] > 0.5 > weights[1]
    two = gaussians_at(torch.tensor([[-1.0, 0, 4], [1, 0.5, 4]]), 0.2)  # each is a point of its own
    pixels = [15 * 40 + 11, (15 + 4) * 40 + 29]  # 36 / 4 pixels aside, 39.6 / 8 below
    expected = [[("a.png", pixel), ("b.png", pixel)] for pixel in pixels]
    assert dominant_gaussians(two, list(CAMERAS)).points == expected
