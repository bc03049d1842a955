"""Which pixels count: each rule against loops over pixels and Gaussians."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from scoup import raster
from scoup.base import InputError
from scoup.scene import Camera, Gaussians
from scoup_lab.baselines.pixel_rules import (
    CentrePixel,
    PixelWeights,
    TopContributors,
    VisibleInView,
    centre_pixels,
    pixel_weights,
)
from support import make_camera, random_gaussians, small_scene


def weights_of(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """[N, H, W] blending weights, from rendering each Gaussian's own channel."""
    image, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(len(gaussians)))
    return image.permute(2, 0, 1).numpy()


def dense(pairs: list[PixelWeights], count: int, height: int, width: int) -> np.ndarray:
    out = np.zeros((count, height * width))
    for part in pairs:
        np.add.at(out, (part.gaussian, part.pixel), part.weight)
    return out.reshape(count, height, width)


@pytest.mark.parametrize("pixels", [1, 41, 100, 10**6])
def test_pixel_weights_are_the_blending_weights_whatever_the_bands(pixels: int) -> None:
    scene, camera = random_gaussians(60, 1), make_camera()
    pairs = list(pixel_weights(raster.project(scene, camera), pixels))
    np.testing.assert_allclose(dense(pairs, 60, 30, 40), weights_of(scene, camera), atol=1e-6)
    with pytest.raises(InputError):
        next(pixel_weights(raster.project(scene, camera), 0))


def test_centre_pixels() -> None:
    camera = make_camera(seed=3)
    scene = random_gaussians(80, 2, ("plain", "behind", "nan"))
    found = centre_pixels(scene, camera)
    for mean, pixel in zip(scene.means.double(), found, strict=True):
        x, y, z = (camera.viewmat[:3, :3] @ mean + camera.viewmat[:3, 3]).tolist()
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = z > 0 and 0 <= u < 40 and 0 <= v < 30
        assert pixel == (int(v) * 40 + int(u) if inside else -1)
    assert (found >= 0).any()
    assert (found < 0).any()


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
    sums = rule.region_sums(gaussians, cameras, regions)
    for level, name in enumerate(regions.levels):
        rows = regions.embeddings(name)[1]
        expected = np.zeros((50, sum(part.stop - part.start for part in rows.values())))
        for camera in cameras:
            weights = weights_of(gaussians, camera)
            kept = literal(rule, weights, centre_pixels(gaussians, camera))
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
    by_hand = [
        [0.9, 0.2, 0.2, 0.2],
        [*[0.14] * 8, 0.9, 0.8],
        [0.14],
        [0.5],
    ]  # ties, two clear ones, one alone
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
    sums = VisibleInView().region_sums(gaussians, cameras, regions)
    for camera in cameras:
        centres = centre_pixels(gaussians, camera)
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
