"""Uplift without training, against loops: which pixels count, dense features, medians, and what a scene keeps."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from messages import refuses
from scoup import raster
from scoup.base import InputError
from scoup.scene import Camera, Gaussians
from scoup.uplift import BuildSettings, GaussianCodes, RegionSums, region_sums
from scoup_lab.baselines import rasterised_scene
from scoup_lab.baselines.dense import dense_features, mean_features
from scoup_lab.baselines.fitted import FittedChannels
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.pixel_rules import (
    AllPixels,
    CentrePixel,
    PixelWeights,
    TopContributors,
    VisibleInView,
    pixel_weights,
    pixels_under,
)
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.baselines.sparse import vote_entropy, without_half
from scoup_lab.baselines.visible_median import streaming_median
from support import make_camera, random_gaussians, small_scene, unit


def weights_of(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """[N, H, W] blending weights, from rendering each Gaussian's own channel."""
    image, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(len(gaussians)))
    return image.permute(2, 0, 1).numpy()


@pytest.mark.parametrize("pixels", [1, 41, 100, 10**6])
def test_pixel_weights_are_the_blending_weights_whatever_the_bands(pixels: int) -> None:
    scene, camera = random_gaussians(60, 1), make_camera()
    dense = np.zeros((60, 30 * 40))
    for part in pixel_weights(raster.project(scene, camera), pixels):
        np.add.at(dense, (part.gaussian, part.pixel), part.weight)
    np.testing.assert_allclose(dense.reshape(60, 30, 40), weights_of(scene, camera), atol=1e-6)
    with pytest.raises(InputError):
        next(pixel_weights(raster.project(scene, camera), 0))


def test_centre_pixels() -> None:
    camera = make_camera(seed=3)
    scene = random_gaussians(80, 2, ("plain", "behind", "nan"))
    found = pixels_under(scene.means, camera)
    for mean, pixel in zip(scene.means.double(), found, strict=True):
        x, y, z = (camera.viewmat[:3, :3] @ mean + camera.viewmat[:3, 3]).tolist()
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = z > 0 and 0 <= u < 40 and 0 <= v < 30
        assert pixel == (int(v) * 40 + int(u) if inside else -1)
    assert 0 < (found < 0).sum() < 80


def literal(rule: object, weights: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """[N, H * W] the weights that a rule keeps."""
    count = len(weights)
    flat = weights.reshape(count, -1)
    out = np.zeros_like(flat)
    for pixel in range(flat.shape[1]):
        ray = sorted((i for i in range(count) if flat[i, pixel] > 0), key=lambda i: (-flat[i, pixel], i))
        for rank, i in enumerate(ray):
            centre = centres[i] == pixel
            kept = rank < rule.count if isinstance(rule, TopContributors) else centre
            out[i, pixel] = flat[i, pixel] if kept else 0
    return out


@pytest.mark.parametrize("rule", [CentrePixel(), TopContributors(1), TopContributors(3)])
def test_region_sums_against_loops(rule: CentrePixel | TopContributors) -> None:
    gaussians, cameras, regions = small_scene(count=50, views=2)
    sums = rule.region_sums(RasterisedScene(gaussians, cameras, regions))
    for level, name in enumerate(regions.levels):
        rows = regions.embeddings(name)[1]
        expected = np.zeros((50, sum(part.stop - part.start for part in rows.values())))
        for camera in cameras:
            weights = weights_of(gaussians, camera)
            kept = literal(rule, weights, pixels_under(gaussians.means, camera))
            labels = regions.load(camera.name, name).labels.flatten().numpy()
            for pixel, label in enumerate(labels):
                if label >= 0:
                    expected[:, rows[camera.name].start + label] += kept[:, pixel]
        np.testing.assert_allclose(sums.matrix(level).toarray(), expected, atol=1e-5)


def pairs_of(weights: list[float]) -> PixelWeights:
    numbers = np.arange(len(weights))
    return PixelWeights(numbers, numbers.copy(), np.array(weights, np.float32))


def test_the_gate_against_its_steps() -> None:
    """Each condition by itself, as sets, on weights of all sizes."""
    rng = np.random.default_rng(0)
    drawn = [rng.random(count) ** 2 * scale for scale in (0.1, 0.3, 1.0) for count in (1, 2, 3, 17, 100)]
    # Ties, two clear ones, one alone.
    by_hand = [[0.9, 0.2, 0.2, 0.2], [*[0.14] * 8, 0.9, 0.8], [0.14], [0.5]]
    for weights in (np.asarray(each, np.float32) for each in (*drawn, *by_hand)):
        count = len(weights)
        order = sorted(range(count), key=lambda i: -weights[i])
        covering, sum_so_far = set(), 0.0
        for i in order:
            covering.add(i)
            sum_so_far += float(weights[i])
            if sum_so_far >= 0.75 * float(weights.astype(float).sum()):
                break
        kept = covering & {i for i in range(count) if weights[i] >= 0.13} & set(order[: count // 2])
        kept = kept or {order[0]}
        clear = {i for i in range(count) if weights[i] > 0.15}
        upper = {i for i in range(count) if weights[i] > np.quantile(weights.astype(float), 0.85)}
        kept &= clear if len(clear) > len(upper) else upper
        assert set(VisibleInView().of_view(pairs_of(list(weights))).gaussian.tolist()) == kept
    assert len(VisibleInView().of_view(pairs_of([])).gaussian) == 0


def test_the_gate_sees_a_view_as_a_whole() -> None:
    """Not band by band: the sums are those of the weights at all centres."""
    gaussians, cameras, regions = small_scene(count=50, views=2)
    sums = VisibleInView().region_sums(RasterisedScene(gaussians, cameras, regions))
    for camera in cameras:
        centres = pixels_under(gaussians.means, camera)
        at_centre = weights_of(gaussians, camera).reshape(50, -1)
        found = [(i, at_centre[i, centres[i]]) for i in range(50) if centres[i] >= 0]
        seen = [(i, float(weight)) for i, weight in found if weight > 0]
        passed = VisibleInView().of_view(pairs_of([weight for _, weight in seen])).gaussian
        expected = {seen[place] for place in passed}
        assert 0 < len(expected) < len(seen)
        for level, name in enumerate(regions.levels):
            labels = regions.load(camera.name, name).labels.flatten()
            gaussian, region, weight = sums.triplets(camera.name, level)
            there = {i: weight for i, weight in expected if labels[centres[i]] >= 0}
            found = dict(zip(gaussian.tolist(), weight.tolist(), strict=True))
            assert found == pytest.approx(there, abs=1e-5)
            assert region.tolist() == [int(labels[centres[i]]) for i in gaussian]


def test_sums_are_made_once_for_equal_rules_and_codes_for_settings_that_differ_in_the_vote(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = BuildSettings(n_atoms=4, k=2, effort="fast")
    scene, learn = RasterisedScene(*small_scene(views=2)), Mock(wraps=rasterised_scene.code_regions)
    assert scene.region_sums() is scene.region_sums()
    stages: list[tuple[str, int, int]] = []
    for pixels in (AllPixels("auto"), TopContributors(), TopContributors()):
        scene.inputs(pixels, progress=lambda *told: stages.append(told))
    assert stages.count(("region sums", 2, 2)) == 2
    assert scene.region_sums(CentrePixel()) is scene.region_sums(CentrePixel())
    assert scene.region_sums(CentrePixel()) is not scene.region_sums()
    assert scene.seconds(CentrePixel()) > 0
    monkeypatch.setattr(rasterised_scene, "code_regions", learn)
    for changes in ({}, {"keep": 0}, {"rounds": 1}):
        scene.inputs().codes(replace(quick, **changes))
        scene.inputs(CentrePixel()).codes(quick)
    assert learn.call_count == 1
    scene.inputs().codes(replace(quick, seed=1))
    assert learn.call_count == 2
    scene.forget_codes()
    scene.inputs().codes(quick)
    assert learn.call_count == 3


def test_features_are_sums_and_means_of_embeddings() -> None:
    """``dense_features`` of unit norm; ``mean_features`` as long as the paper's Eq. 3 makes them."""
    gaussians, cameras, regions = small_scene(count=60, views=2)
    sums = region_sums(gaussians, cameras, regions)
    for s, level in enumerate(regions.levels):
        rows, _ = regions.embeddings(level)
        summed, total = torch.zeros(60, 16), torch.zeros(60)
        for camera in cameras:
            region_map = regions.load(camera.name, level)
            weights, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(60))
            has = region_map.labels >= 0
            summed += weights[has].T @ region_map.embeddings[region_map.labels[has].long()]
            total += weights[has].sum(0)
        assert torch.allclose(dense_features(sums, rows, s), unit(summed), atol=1e-4)
        found, seen = mean_features(sums, rows, s), total > 1e-4
        assert torch.allclose(found[seen], (summed / total[:, None])[seen], atol=1e-4)
        lengths = found.norm(dim=1)
        assert lengths.max() <= 1 + 1e-5
        assert lengths[seen].min() < 0.9  # regions differ
        assert not found[total == 0].any()


@pytest.mark.parametrize("views", [1, 4])
def test_the_streaming_median_against_a_loop(views: int) -> None:
    scene = RasterisedScene(*small_scene(count=50, views=views))
    inputs = scene.inputs(VisibleInView())
    for level, embeddings in enumerate(inputs.embeddings):
        assert inputs.sums.rows is not None
        expected = torch.zeros(50, 16)
        weights = [0.0] * 50
        for view, rows in inputs.sums.rows[level].items():
            for gaussian, region, weight in zip(*inputs.sums.triplets(view, level), strict=True):
                direction = embeddings[rows][int(region)]
                weights[gaussian] += float(weight)
                before = expected[gaussian]
                tangent = direction - (direction @ before) * before
                expected[gaussian] = unit(before + float(weight) / weights[gaussian] * tangent)
        found = streaming_median(inputs.sums, embeddings, level)
        assert torch.allclose(found, expected, atol=1e-5)
        assert torch.equal(found.any(1), torch.tensor(weights) > 0)
        assert 0 < int(found.any(1).sum()) < 50
    fitted = METHODS["visible-centre-median"].fit(scene)  # is this median behind the gate
    assert isinstance(fitted, FittedChannels)
    for level, channels in enumerate(fitted.channels):
        assert torch.equal(channels, streaming_median(inputs.sums, inputs.embeddings[level], level))
    plain = scene.inputs()  # several regions in a view enter as their mean
    if views == 1:
        mean = torch.from_numpy(plain.sums.matrix(0) @ plain.embeddings[0].numpy())
        assert torch.allclose(streaming_median(plain.sums, plain.embeddings[0], 0), unit(mean), atol=1e-5)
    with refuses():  # rows must be known
        streaming_median(RegionSums.empty(scene.gaussians, scene.regions.levels), torch.ones(3, 4), 0)


def test_halves_by_the_entropy_of_votes() -> None:
    rows = torch.tensor([[1.0, 0, 0, 0], [0.25, 0.25, 0.25, 0.25], [0, 0, 0, 0], [2, 2, 0, 0]])
    for scaled in (rows, 7 * rows):
        assert vote_entropy(scaled[:, None])[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])
    votes = torch.rand(41, 3, 8, generator=torch.Generator().manual_seed(0)) ** 4
    votes[5:9, 1] = 0  # without votes
    entropy = vote_entropy(votes)
    whole = GaussianCodes(torch.zeros(41, 3, 8, dtype=torch.uint8), votes)
    calm, torn = (without_half(whole, whole, half).weights for half in ("highest", "lowest"))
    for level in range(3):
        kept, dropped = calm[:, level].any(1), torn[:, level].any(1)
        voted = votes[:, level].any(1)
        assert torch.equal(kept | dropped, voted)
        assert not (kept & dropped).any()
        assert abs(int(kept.sum()) - int(dropped.sum())) <= 1
        assert entropy[kept, level].max() <= entropy[dropped, level].min()
        assert torch.equal(calm[kept, level], votes[kept, level])
