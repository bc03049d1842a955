"""Depth of a view and the position of a mask, against what is known of a scene."""

from __future__ import annotations

import gc

import pytest
import torch

from query.conftest import Queried
from scoup import raster
from scoup.field import render_depth
from scoup.query.view_answer import mask_position
from scoup.scene import Camera


def test_depth_is_the_mean_of_what_paints_a_pixel(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    projection = field.project(camera)
    found = render_depth(projection, field.gaussians, camera)
    means = field.gaussians.means.double()
    distances = (means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3])[:, 2]
    total = torch.zeros(camera.height, camera.width, dtype=torch.float64)
    alpha = torch.zeros_like(total)
    for number, distance in enumerate(distances.tolist()):
        one = torch.zeros(len(field), 1)
        one[number] = 1
        share = raster.render_channels(projection, one)[0][..., 0].double()
        total += share * distance
        alpha += share
    painted = alpha >= 0.5
    assert painted.any()
    assert torch.equal(torch.isfinite(found), painted)
    assert torch.allclose(found[painted].double(), (total / alpha)[painted], rtol=1e-4)


def test_the_position_of_a_flat_wall() -> None:
    """Pixels at one distance along the view direction lie on a plane."""
    camera = Camera.look_at((1.0, 2.0, 3.0), (1.0, 2.0, -4.0), "a.png", 20, 10, 15.0, up=(0.0, 1.0, 0.0))
    mask, depth = torch.zeros(10, 20, dtype=torch.bool), torch.full((10, 20), 5.0)
    mask[4:6, 9:11] = True  # the middle of the image
    found = mask_position(mask, depth, camera)
    assert found is not None
    assert found[2].item() == pytest.approx(-2.0)
    # A median is one of the values: half a pixel beside the middle.
    assert torch.allclose(found[:2], torch.tensor([1.0, 2.0]).double(), atol=0.5 / 15 * 5 + 1e-6)
    right = torch.zeros_like(mask)
    right[5, 19] = True
    moved = mask_position(right, depth, camera)
    assert moved is not None
    assert moved[0].item() == pytest.approx(1.0 + (19.5 - 10) / 15 * 5)
    depth[5, 19] = torch.nan
    assert mask_position(right, depth, camera) is None


def test_answers_know_their_position_after_the_projection_is_gone(queried: Queried) -> None:
    field, camera = queried.field, queried.camera
    view = field.at(camera)
    expected, answers = view.renders.depth(), field.at(camera).answer(queried.texts)
    del view
    gc.collect()
    for answer in answers:
        found, wanted = answer.position, mask_position(answer.main_parts, expected, camera)
        assert (found is None) == (wanted is None)
        assert found is None or (wanted is not None and torch.equal(found, wanted))
    assert any(answer.position is not None for answer in answers)
