"""The 3D-selection protocol: silhouettes of Gaussians drawn alone."""

from __future__ import annotations

import pytest
import torch

from messages import refuses
from scoup import raster
from scoup.scene import Gaussians
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import lerf_ovs
from scoup_lab.evaluate.protocols.selection import NEIGHBOURS, OPAQUE, THRESHOLD, score_scene, silhouette
from scoup_lab.evaluate.scores import overall
from support import make_camera, random_gaussians
from uplift.edits import joined


def blob(x: float, z: float, opacity: float = 0.99) -> Gaussians:
    return Gaussians(
        torch.tensor([[x, 0.0, z]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.2),
        torch.tensor([opacity]), torch.zeros(1, 1, 3),
    )  # fmt: skip


def test_what_hides_a_thing_does_not_hide_its_silhouette() -> None:
    scene, camera = joined(blob(0, 2), blob(0, 4)), make_camera()
    behind = silhouette(scene, torch.tensor([False, True]), camera, "inria")
    alone = silhouette(blob(0, 4), torch.tensor([True]), camera, "inria")
    assert behind.equal(alone)
    assert alone.any()
    assert not silhouette(scene, torch.tensor([False, False]), camera, "inria").any()


def test_silhouettes_begin_at_their_opacity() -> None:
    camera = make_camera()
    faint = blob(0, 3, 0.03)  # under 10 / 255
    assert not silhouette(faint, torch.tensor([True]), camera, "inria").any()
    scene = random_gaussians(40, 3)
    chosen = torch.arange(40) % 2 == 0
    projection = raster.project(scene.select(chosen), camera, "inria")
    alpha = raster.render_channels(projection, torch.ones(20, 1))[0][..., 0]
    expected = alpha > 10 / 255
    assert silhouette(scene, chosen, camera, "inria").equal(expected)
    assert (NEIGHBOURS, THRESHOLD, OPAQUE) == (10, 0.6, 10 / 255)


def test_scores() -> None:
    scene, camera = joined(blob(-0.6, 3), blob(0.6, 3)), make_camera(name="a.png")
    left, right = torch.tensor([True, False]), torch.tensor([False, True])
    truth = silhouette(scene, left, camera, "inria")
    nothing = torch.zeros_like(truth)
    frame = LabelledFrame("a", 40, 30, {"cup": truth, "pot": truth, "none": nothing}, {})
    chosen = {"cup": left, "pot": right, "none": torch.zeros(2, dtype=torch.bool)}
    score = score_scene("s", scene, [(frame, camera)], chosen)
    # A selection that shows nothing scores 0, even where the truth is empty.
    assert [pair.iou for pair in score.pairs] == [1.0, pytest.approx(0.0, abs=0.05), 0.0]
    assert score.protocol == "3D selection"
    with refuses():
        score_scene("s", scene, [(frame, camera)], {"cup": left})


def test_protocols_are_never_averaged_together() -> None:
    scene, camera = blob(0, 3), make_camera(name="a.png")
    chosen = {"cup": torch.tensor([True])}
    frame = LabelledFrame(
        "a", 40, 30, {"cup": torch.ones(30, 40, dtype=torch.bool)}, {"cup": torch.zeros(1, 4)}
    )
    three = score_scene("s", scene, [(frame, camera)], chosen)
    with refuses():
        overall([three, lerf_ovs.PROTOCOL.score("s", [(frame, torch.rand(3, 1, 30, 40))])])
