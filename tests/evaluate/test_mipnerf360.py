"""Mip-NeRF 360: features at the size of the label, the level by the mean inside its mask."""

from __future__ import annotations

import torch

from messages import refuses
from scoup.field import relevancy
from scoup.uplift import BuildSettings, build
from scoup_lab.baselines.fitted import FittedField, resized_image
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import mipnerf360
from support import small_scene, unit


def frame_of(width: int, height: int) -> LabelledFrame:
    mask = torch.zeros(height, width, dtype=torch.bool)
    mask[3:9, 4:12] = True
    return LabelledFrame("a", width, height, {"cup": mask}, {"cup": torch.zeros(1, 4)})


def test_maps_of_another_size_are_refused() -> None:
    with refuses():
        mipnerf360.PROTOCOL.score_frame(frame_of(20, 14), torch.rand(3, 1, 28, 40))


def test_resizing_is_bilinear_by_pixel_centres() -> None:
    image = torch.rand(5, 6, 2, generator=torch.Generator().manual_seed(0))
    assert resized_image(image, 6, 5) is image
    found = resized_image(image, 9, 4)
    for y in range(4):
        for x in range(9):
            v, u = max((y + 0.5) * 5 / 4 - 0.5, 0), max((x + 0.5) * 6 / 9 - 0.5, 0)
            v0, u0 = int(v), int(u)
            v1, u1 = min(v0 + 1, 4), min(u0 + 1, 5)
            a, b = v - v0, u - u0
            expected = (1 - a) * ((1 - b) * image[v0, u0] + b * image[v0, u1])
            expected += a * ((1 - b) * image[v1, u0] + b * image[v1, u1])
            assert torch.allclose(found[y, x], expected, atol=1e-6)


def test_features_are_resized_before_they_are_compared() -> None:
    """Of a language field: coefficients are resized, which is the same as resizing features."""
    gaussians, cameras, regions = small_scene(count=80, views=2)
    field = build(gaussians, cameras, regions, BuildSettings(n_atoms=8))
    fitted, projection = FittedField(field), field.project(cameras[0])
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    found = fitted.relevancy(projection, queries, canonical, (25, 19))
    assert found.shape == (3, 2, 19, 25)
    codes = field.render_codes(cameras[0])
    for level in range(3):
        features = unit(resized_image(codes[level] @ field.codebook[level], 25, 19))
        cosines = (features @ torch.cat([queries, canonical]).T).permute(2, 0, 1)
        expected = relevancy(cosines[None, :2], cosines[None, 2:])[0]
        assert torch.allclose(found[level], expected, atol=1e-5)
    same = fitted.relevancy(projection, queries, canonical, (40, 30))
    assert same.equal(field.relevancy(cameras[0], queries, canonical))
