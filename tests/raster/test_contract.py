"""Every backend against the brute-force evaluation, over random and ugly scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from messages import refuses
from raster.hard_scenes import hard_scene
from raster.parity import ABSOLUTE, BACKENDS, RELATIVE
from scoup import raster
from scoup.base import UnknownNameError
from support import KINDS, examples, make_camera, random_gaussians, random_labels, scenes, unit

pytestmark = pytest.mark.parametrize("backend", BACKENDS)

# An independent evaluation of the blending weights, per pixel in float64, straight from the formulas. Written without
# the package's rasteriser: conics by matrix inversion, no tiles, no sorting tricks.

CONSTANTS = {"inria": (0.2, 0.99), "gsplat": (0.01, 0.99)}


@dataclass(frozen=True)
class Truth:
    """weights [N, H, W] float64; unsure [H, W]: pixels where a threshold is too close to call in float32."""

    weights: np.ndarray
    unsure: np.ndarray


def blending_weights(gaussians, camera, preset: str, margin: float = 2e-3) -> Truth:
    near, alpha_max = CONSTANTS[preset]
    names = ("means", "quats", "scales", "opacities")
    means, quats, scales, opacities = (getattr(gaussians, name).double().numpy() for name in names)
    viewmat, height, width = camera.viewmat.numpy(), camera.height, camera.width
    ys, xs = np.mgrid[:height, :width] + 0.5
    weights = np.zeros((len(means), height, width))
    unsure = np.zeros((height, width), bool)

    drawable = []
    for i in range(len(means)):
        numbers = np.concatenate([means[i], quats[i], scales[i]])
        if not np.isfinite(numbers).all() or np.isnan(opacities[i]) or not quats[i].any():
            continue
        depth = (viewmat[:3, :3] @ means[i] + viewmat[:3, 3])[2]
        if depth > near:
            drawable.append((depth, i))
    transmittance = np.ones((height, width))
    stopped = np.zeros((height, width), bool)
    for _, i in sorted(drawable):
        centre, covariance = _project(means[i], quats[i], scales[i], camera, preset)
        conic = np.linalg.inv(covariance)
        dx, dy = xs - centre[0], ys - centre[1]
        q = conic[0, 0] * dx * dx + (conic[0, 1] + conic[1, 0]) * dx * dy + conic[1, 1] * dy * dy
        alpha = np.minimum(alpha_max, min(opacities[i], 1.0) * np.exp(-0.5 * q))
        unsure |= ~stopped & (np.abs(alpha * 255 - 1) < margin)
        alpha[alpha < 1 / 255] = 0
        after = transmittance * (1 - alpha)
        unsure |= ~stopped & (alpha > 0) & (np.abs(after / 1e-4 - 1) < margin)
        stopped |= after < 1e-4
        weights[i] = np.where(stopped, 0, alpha * transmittance)
        transmittance = np.where(stopped, transmittance, after)
    return Truth(weights, unsure)


def _project(mean, quat, scale, camera, preset):
    viewmat, K, width, height = camera.viewmat.numpy(), camera.K.numpy(), camera.width, camera.height
    w, x, y, z = quat / np.linalg.norm(quat)
    rotation = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    covariance = rotation @ np.diag(scale**2) @ rotation.T
    tx, ty, tz = viewmat[:3, :3] @ mean + viewmat[:3, 3]
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    half_x, half_y = width / (2 * fx), height / (2 * fy)
    if preset == "inria":  # how far out on an image a Gaussian is drawn as it is
        left = right = 1.3 * half_x
        up = down = 1.3 * half_y
    else:
        left, right = cx / fx + 0.3 * half_x, (width - cx) / fx + 0.3 * half_x
        up, down = cy / fy + 0.3 * half_y, (height - cy) / fy + 0.3 * half_y
    sx, sy = tz * np.clip(tx / tz, -left, right), tz * np.clip(ty / tz, -up, down)
    jacobian = np.array([[fx / tz, 0, -fx * sx / tz**2], [0, fy / tz, -fy * sy / tz**2]])
    turned = jacobian @ viewmat[:3, :3]
    return (fx * tx / tz + cx, fy * ty / tz + cy), turned @ covariance @ turned.T + 0.3 * np.eye(2)


def close(actual, expected, sure):
    """All sure pixels [H, W] agree; the last axes of actual/expected are [H, W]."""
    actual = actual.numpy().astype(np.float64)
    limit = RELATIVE * np.abs(expected) + ABSOLUTE
    worst = np.where(sure, np.abs(actual - expected) / limit, 0)
    assert worst.size == 0 or worst.max() <= 1, f"error is {worst.max():.3g} x the limit"


@settings(max_examples=examples(60), deadline=None)
@given(scene=scenes(), preset=st.sampled_from(["inria", "gsplat"]))
@example(hard_scene("copies", 3), "inria")  # ties in depth go by index
@example(hard_scene("wall", 3), "inria")  # the Gaussian that would cross the bound is left out
def test_channels_and_alpha_equal_brute_force(backend, scene, preset):
    gaussians, camera = scene
    truth = blending_weights(gaussians, camera, preset)
    values = torch.randn(len(gaussians), 3, generator=torch.Generator().manual_seed(1))
    image, alpha = raster.render_channels(raster.project(gaussians, camera, preset, backend), values)
    assert image.shape == (camera.height, camera.width, 3)
    assert np.mean(truth.unsure) < 0.2 or truth.unsure.size < 20
    expected = np.einsum("nhw,nc->chw", truth.weights, values.numpy().astype(np.float64))
    close(image.permute(2, 0, 1), expected, ~truth.unsure)
    close(alpha, truth.weights.sum(0), ~truth.unsure)
    assert torch.isfinite(image).all()
    assert torch.isfinite(alpha).all()


@settings(max_examples=examples(40), deadline=None)
@given(scene=scenes(), kept=st.sampled_from([0.0, 0.1, 0.5]), channels=st.integers(0, 9))
def test_values_alone_are_those_beside_alpha(backend, scene, kept, channels):
    gaussians, camera = scene
    generator = torch.Generator().manual_seed(1)
    values = torch.randn(len(gaussians), channels, generator=generator)
    values[torch.rand(len(gaussians), generator=generator) >= kept] = 0  # tiles without any are not drawn
    projection = raster.project(gaussians, camera, backend=backend)
    expected, _ = raster.render_channels(projection, values)
    assert torch.equal(raster.render_values(projection, values), expected)


@settings(max_examples=examples(40), deadline=None)
@given(scene=scenes(25), levels=st.integers(1, 4), regions=st.integers(1, 9), seed=st.integers(0, 999))
def test_region_sums_equal_brute_force(backend, scene, levels, regions, seed):
    gaussians, camera = scene
    truth = blending_weights(gaussians, camera, "inria")
    labels = random_labels(levels, camera.height, camera.width, regions, seed)
    labels[:, torch.from_numpy(truth.unsure)] = -1  # only sure pixels are compared
    sums = raster.region_sums(raster.project(gaussians, camera, "inria", backend), labels)
    combinations = {tuple(own) for own in labels.flatten(1).T.tolist()} - {(-1,) * levels}
    assert sorted(map(tuple, sums.table.tolist())) == sorted(combinations)
    expected = np.zeros((len(gaussians), len(sums.table)))
    for number, own in enumerate(sums.table):
        where = (labels == own[:, None, None]).all(0).numpy()
        expected[:, number] = truth.weights[:, where].sum(1)
    actual = np.zeros_like(expected)
    actual[sums.gaussian.numpy(), sums.combination.numpy()] = sums.weight.numpy()
    assert np.abs(actual - expected).max(initial=0) <= 1e-5 * expected.max(initial=1)
    assert ((actual > 0) == (expected > 0)).all()
    pair = sums.gaussian.long() * 100_000 + sums.combination
    assert (pair[1:] > pair[:-1]).all()  # sorted, each once


@settings(max_examples=examples(25), deadline=None)
@given(scene=scenes(25), k=st.integers(1, 5), seed=st.integers(0, 999))
def test_codes_and_cosines_equal_decoded_features(backend, scene, k, seed):
    gaussians, camera = scene
    generator = torch.Generator().manual_seed(seed)
    levels, n_atoms, dim, count = 3, 7, 16, len(gaussians)
    indices = torch.randint(n_atoms, (count, levels, k), generator=generator, dtype=torch.uint8)
    weights = torch.rand(count, levels, k, generator=generator)
    weights[: count // 3] = 0  # Gaussians without a code
    codebook = torch.randn(levels, n_atoms, dim, generator=generator)
    queries = unit(torch.randn(4, dim, generator=generator))
    projection = raster.project(gaussians, camera, backend=backend)

    rendered = raster.render_codes(projection, indices, weights, n_atoms)
    cosines = raster.render_cosines(projection, indices, weights, codebook, queries)
    again, norms = raster.render_cosines_and_norms(projection, indices, weights, codebook, queries)
    assert torch.equal(again, cosines)
    assert norms.shape == (levels, camera.height, camera.width)
    assert rendered.shape == (levels, camera.height, camera.width, n_atoms)
    assert cosines.shape == (levels, 4, camera.height, camera.width)
    for level in range(levels):
        dense = torch.zeros(count, n_atoms).scatter_add_(1, indices[:, level].long(), weights[:, level])
        image, _ = raster.render_channels(projection, dense)
        assert torch.allclose(rendered[level], image, rtol=1e-4, atol=1e-6)
        features, _ = raster.render_channels(projection, dense @ codebook[level])
        directions = unit(features.double())
        expected = (directions @ queries.T.double()).permute(2, 0, 1).float()
        solid = features.norm(dim=-1) > 1e-4
        assert torch.allclose(norms[level], features.norm(dim=-1), rtol=1e-3, atol=1e-4)
        assert torch.allclose(cosines[level][:, solid], expected[:, solid], atol=1e-4)
        decoded = raster.render_features(projection, indices, weights, codebook)[level]
        assert torch.allclose(decoded[solid], directions[solid].float(), atol=1e-4)
        assert not decoded[features.abs().sum(-1) == 0].any()
        assert (cosines[level][:, features.abs().sum(-1) == 0] == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_each_ugly_kind_alone(backend, kind):
    gaussians = random_gaussians(12, 5, (kind,))
    camera = make_camera(33, 21, seed=3)
    truth = blending_weights(gaussians, camera, "inria")
    _, alpha = raster.render_channels(raster.project(gaussians, camera, backend=backend), torch.ones(12, 1))
    close(alpha, truth.weights.sum(0), ~truth.unsure)
    drawn = kind not in ("behind", "opacity 0", "nan", "zero quat")
    assert bool((alpha > 0).any()) == drawn


def test_empty_scenes_views_and_maps(backend):
    camera = make_camera(7, 5)
    labels = torch.zeros(3, 5, 7, dtype=torch.int32)
    for gaussians in (random_gaussians(0, 0), random_gaussians(5, 0, ("behind",))):
        count = len(gaussians)
        projection = raster.project(gaussians, camera, backend=backend)
        image, alpha = raster.render_channels(projection, torch.ones(count, 2))
        assert image.shape == (5, 7, 2)
        assert not image.any()
        assert not alpha.any()
        indices, weights = torch.zeros(count, 3, 2, dtype=torch.uint8), torch.ones(count, 3, 2)
        assert not raster.render_codes(projection, indices, weights, 4).any()
        sums = raster.region_sums(projection, labels)
        assert len(sums.gaussian) == len(sums.combination) == len(sums.weight) == 0
        assert sums.table.tolist() == [[0, 0, 0]]
    projection = raster.project(random_gaussians(9, 1), camera, backend=backend)
    for none, levels in ((labels - 1, 3), (labels[:0], 0)):
        sums = raster.region_sums(projection, none)
        assert len(sums.gaussian) == 0
        assert sums.table.shape[1] == levels
    assert raster.render_channels(projection, torch.zeros(9, 0))[0].shape == (5, 7, 0)
    indices, weights = torch.zeros(9, 3, 2, dtype=torch.uint8), torch.ones(9, 3, 2)
    assert not raster.render_codes(projection, indices[..., :0], weights[..., :0], 4).any()
    cosines = raster.render_cosines(projection, indices, weights, torch.ones(3, 4, 6), torch.zeros(0, 6))
    assert cosines.shape == (3, 0, 5, 7)


def test_what_does_not_fit_is_refused(backend):
    projection = raster.project(random_gaussians(9, 1), make_camera(), backend=backend)
    indices, weights = torch.zeros(9, 3, 4, dtype=torch.uint8), torch.zeros(9, 3, 4)
    codebook, queries = torch.ones(3, 8, 6), torch.ones(2, 6)
    whole = torch.zeros(3, 31, 40, dtype=torch.int32)
    wrong: list[Any] = [
        (raster.region_sums, whole), (raster.region_sums, whole[:, 1:].float()), (raster.region_sums, whole[0, 1:]),
        (raster.render_channels, torch.zeros(8, 3)),
        (raster.render_codes, indices, torch.zeros(9, 3, 5), 8), (raster.render_codes, indices[..., 1:], weights, 8),
        (raster.render_codes, indices[1:], weights[1:], 8),
        (raster.render_cosines, indices, weights, codebook[:2], queries),
        (raster.render_cosines, indices, weights, codebook, queries[:, 1:]),
        (raster.render_cosines, indices, weights, codebook[0], queries),
        (raster.render_cosines, indices, weights, codebook, queries[0]),
    ]  # fmt: skip
    for function, *parts in wrong:
        with refuses():
            function(projection, *parts)
    for preset, name in (("inira", backend), ("inria", "refrence")):
        with refuses(UnknownNameError):
            raster.project(random_gaussians(2, 0), make_camera(), preset, name)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int64])
def test_an_atom_beyond_the_codebook_is_refused(backend, dtype):
    projection = raster.project(random_gaussians(9, 1), make_camera(), backend=backend)
    indices, weights = torch.zeros(9, 3, 4, dtype=dtype), torch.ones(9, 3, 4)
    indices[7, 0, 0] = 8  # of the first level: it must not pass for atom 0 of the second
    with refuses():
        raster.render_codes(projection, indices, weights, 8)
    with refuses():
        raster.render_cosines(projection, indices, weights, torch.ones(3, 8, 6), torch.ones(2, 6))
