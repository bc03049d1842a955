"""The demo scene: counts, sameness, and a truth that lies over the render."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from messages import refuses
from scoup.base import UnknownNameError
from scoup.raster import project, render_channels
from scoup.scene import LEVELS
from scoup_lab.synthetic import TABLE, DemoScene, make_demo_scene
from scoup_lab.synthetic.art.things import Parts
from synthetic.small_scenes import SMALL


def test_counts_and_values(scene: DemoScene):
    gaussians = scene.gaussians
    assert len(gaussians) == SMALL["n_gaussians"] == len(scene.part_of_gaussian)
    assert bool(gaussians.finite().all())
    assert gaussians.quats.norm(dim=1).sub(1).abs().max() < 1e-5
    assert gaussians.opacities.min() > 0
    assert gaussians.opacities.max() < 1
    haze = scene.part_of_gaussian < 0
    assert 0.01 < haze.float().mean() < 0.06
    assert gaussians.opacities[~haze].min() >= 0.6
    flat = gaussians.scales[~haze].sort(dim=1).values
    assert (flat[:, 0] < 0.6 * flat[:, 1]).float().mean() > 0.95
    assert len(scene.building) == SMALL["n_building"]
    assert len(scene.held_out) == SMALL["n_held_out"]
    assert scene.regions.view_names == scene.building.names
    assert scene.regions.levels == LEVELS


def test_objects_lie_in_no_order(scene: DemoScene):
    part = scene.part_of_gaussian.double()
    assert abs(float(torch.corrcoef(torch.stack([part[1:], part[:-1]]))[0, 1])) < 0.05


def drawn_objects(scene: DemoScene) -> tuple[torch.Tensor, torch.Tensor, dict[str, float]]:
    """[H, W] object that a held-out view shows most, its opacity, and the IoU of each name with the truth."""
    objects = torch.from_numpy(scene.parts.at_level(scene.part_of_gaussian.numpy(), "m"))
    one_hot = torch.nn.functional.one_hot(objects + 1, len(scene.parts.objects) + 1)[:, 1:].float()
    camera = scene.held_out[0]
    weights, alpha = render_channels(project(scene.gaussians, camera), one_hot)
    drawn = weights.argmax(-1)
    overlaps = {}
    for name, mask in scene.labelled_frame(camera.name).masks.items():
        shown = drawn == scene.parts.objects.index(name)
        overlaps[name] = float((shown & mask).sum() / (shown | mask).sum())
    return drawn, alpha, overlaps


def test_the_truth_lies_over_the_render(scene: DemoScene):
    drawn, alpha, overlaps = drawn_objects(scene)
    assert (alpha > 0.9).float().mean() > 0.94
    truth = scene.parts.at_level(scene.part_maps[scene.held_out[0].name], "m")
    assert (drawn.numpy() == truth).mean() > 0.85
    assert overlaps["teddy bear"] > 0.8
    assert overlaps["table"] > 0.8
    assert np.mean(list(overlaps.values())) > 0.6


@pytest.mark.slow
def test_the_truth_lies_over_the_render_at_full_size():
    overlaps = list(drawn_objects(make_demo_scene(n_held_out=1))[2].values())
    assert np.mean(overlaps) > 0.8
    assert np.quantile(overlaps, 0.75) > 0.88


def test_labelled_frames_hold_what_is_in_sight(scene: DemoScene):
    name = scene.held_out.names[0]
    frame = scene.labelled_frame(name, ("m", "l"))
    assert frame.name == "held_out_00"
    assert {"table", "teapot", "fruit bowl"} <= set(frame.labels)
    for label, mask in frame.masks.items():
        rows, columns = mask.nonzero().unbind(1)
        x0, y0, x1, y1 = frame.boxes[label][0].tolist()
        assert (columns.min(), rows.min(), columns.max(), rows.max()) == (x0, y0, x1, y1)
    group = scene.parts.groups.index("fruit bowl")
    members = [scene.parts.objects[k] for k in np.flatnonzero(scene.parts.group_of_object == group)]
    union = torch.stack([scene.mask(name, member) for member in members]).any(0)
    assert torch.equal(union, scene.mask(name, "fruit bowl"))


def test_unknown_names_list_the_nearest(scene: DemoScene):
    with refuses(UnknownNameError):
        scene.level_of("tea pot")
    with refuses(UnknownNameError):
        scene.text_vectors(["ketle"])


def test_what_cannot_be_made_is_refused():
    wrong_sizes: tuple[dict[str, Any], ...] = ({"n_gaussians": 10}, {"width": 4}, {"n_building": 0})
    for wrong in wrong_sizes:
        with refuses():
            make_demo_scene(**wrong)
    room = TABLE.things()
    with refuses():  # two things of one name
        Parts.of((*room, room[-1]))
