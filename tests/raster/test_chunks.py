"""Chunks of Gaussians that a camera cannot see are passed over, and nothing changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup import raster
from scoup.raster import native
from scoup.scene import Camera, Gaussians
from support import examples

pytest.importorskip("scoup._native", reason="the compiled core is not built")
COUNT = 30_000  # four chunks


def town(seed: int) -> Gaussians:
    """Gaussians far apart, some of them huge, needles, or not finite."""
    numbers = np.random.default_rng(seed)
    means = numbers.uniform(-50, 50, (COUNT, 3)) * [1, 1, 0.05]
    scales = 10 ** numbers.uniform(-2, 0, (COUNT, 3))
    odd = numbers.integers(0, COUNT, 40)
    scales[odd[:10]] *= [100, 0.01, 1]
    means[odd[10:20], 0] = np.nan
    scales[odd[20:30]] = np.inf
    opacities = numbers.uniform(0, 1, COUNT)
    opacities[odd[30:]] = np.inf
    return Gaussians(means, numbers.normal(size=(COUNT, 4)), scales, opacities, np.zeros((COUNT, 1, 3)))  # type: ignore[arg-type]


@settings(max_examples=examples(25), deadline=None)
@given(
    seed=st.integers(0, 3),
    eye=st.tuples(*[st.floats(-60, 60)] * 3),
    target=st.tuples(*[st.floats(-60, 60)] * 3),
    focal=st.sampled_from([10.0, 60.0, 400.0]),
    preset=st.sampled_from(sorted(raster.RASTER_PRESETS)),
    most=st.sampled_from([0, native.MOST_ROWS_IN_MEMORY]),
)
def test_what_is_seen_is_the_same(
    seed: int, eye: tuple[float, ...], target: tuple[float, ...], focal: float, preset: str, most: int
) -> None:
    if np.linalg.norm(np.subtract(eye, target)[:2]) < 1e-3:
        return
    camera = Camera.look_at(eye, target, "view", 64, 48, focal)
    gaussians = town(seed)
    labels = torch.arange(4).repeat_interleave(16).expand(48, 64)[None]
    with pytest.MonkeyPatch.context() as patch:
        for module in (native, raster):
            patch.setattr(module, "MOST_ROWS_IN_MEMORY", most)
        prepared = raster.prepare_gaussians(gaussians, "native")
    plain = dataclasses.replace(
        prepared, handle=native.make_scene(prepared.gaussians, prepared.order, many_views=False)
    )
    found = [raster.region_sums(raster.project(each, camera, preset), labels) for each in (prepared, plain)]
    for name in ("gaussian", "combination", "weight"):
        assert torch.equal(getattr(found[0], name), getattr(found[1], name))


def test_chunks_are_passed_over() -> None:
    """A camera that sees a corner of the town keeps memory for fewer rows than there are."""
    gaussians = dataclasses.replace(town(0), scales=torch.full((COUNT, 3), 0.01))
    prepared = raster.prepare_gaussians(gaussians, "native")
    corner = raster.project(prepared, Camera.look_at((40, 40, 0), (60, 60, 0), "corner", 64, 48, 60.0))
    behind = raster.project(prepared, Camera.look_at((70, 0, 0), (80, 0, 0), "away", 64, 48, 60.0))
    everything = raster.project(prepared, Camera.look_at((-300, 0, 0), (0, 0, 0), "all", 64, 48, 60.0))
    rows = []
    for projection in (behind, corner, everything):
        assert isinstance(projection, native.NativeProjection)
        rows.append(projection.handle.n_looked_at)
    assert rows[0] == 0 < rows[1] < rows[2] == COUNT
