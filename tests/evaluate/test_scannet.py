"""ScanNet's point-level protocol: numbers of classes, frozen positions, points that do not count."""

from __future__ import annotations

from pathlib import Path

import torch

from messages import refuses
from scoup.scene import Gaussians
from scoup_lab.data.labelled_points import NYU40, LabelledPoints
from scoup_lab.evaluate.protocols import scannet
from scoup_lab.evaluate.protocols.points import NO_CLASS

CLASSES = scannet.CLASS_LISTS


def splat(positions: torch.Tensor, opacities: torch.Tensor | None = None) -> Gaussians:
    count = len(positions)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(count, 4).contiguous()
    opacities = torch.full((count,), 0.9) if opacities is None else opacities
    return Gaussians(positions, quats, torch.full((count, 3), 0.01), opacities, torch.zeros(count, 1, 3))


def test_classes_are_those_of_the_published_script() -> None:
    assert len(NYU40) == 41
    assert (NYU40[1], NYU40[5], NYU40[28], NYU40[40]) == ("wall", "chair", "showercurtain", "otherprop")
    assert CLASSES["19"].classes == (
        "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf", "picture",
        "counter", "desk", "curtain", "refrigerator", "showercurtain", "toilet", "sink", "bathtub",
    )  # fmt: skip
    gone = {"picture", "refrigerator", "showercurtain", "bathtub"}
    assert CLASSES["15"].classes == tuple(name for name in CLASSES["19"].classes if name not in gone)
    assert CLASSES["10"].classes == (
        "wall", "floor", "bed", "chair", "sofa", "table", "door", "window", "bookshelf", "toilet"
    )  # fmt: skip
    assert len(scannet.SCENES) == 10
    assert scannet.labels_path(Path("x/scene0000_00")) == Path(
        "x/scene0000_00/scene0000_00_vh_clean_2.labels.ply"
    )


def test_labels_become_positions_in_the_list() -> None:
    #                       wall floor cabinet sofa toilet otherprop none beyond
    labels = torch.tensor([1, 2, 3, 6, 33, 40, 0, 99])
    positions = torch.rand(8, 3, generator=torch.Generator().manual_seed(0))
    points = LabelledPoints(positions, labels)
    for name, expected in {
        "19": [0, 1, 2, 5, 16, NO_CLASS, NO_CLASS, NO_CLASS],
        "15": [0, 1, 2, 5, 13, NO_CLASS, NO_CLASS, NO_CLASS],
        "10": [0, 1, NO_CLASS, 4, 9, NO_CLASS, NO_CLASS, NO_CLASS],
    }.items():
        assert scannet.gaussian_truth(splat(positions), points, CLASSES[name], "x").tolist() == expected


def test_faint_gaussians_do_not_count() -> None:
    positions = torch.rand(3, 3, generator=torch.Generator().manual_seed(0))
    points = LabelledPoints(positions, torch.tensor([1, 1, 1]))
    faint = splat(positions, torch.tensor([0.0999, 0.1, 0.5]))
    assert scannet.gaussian_truth(faint, points, CLASSES["19"], "x").tolist() == [NO_CLASS, 0, 0]


def test_splats_of_other_points_are_refused() -> None:
    positions = torch.rand(4, 3, generator=torch.Generator().manual_seed(0))
    points = LabelledPoints(positions, torch.ones(4, dtype=torch.int64))
    moved, endless = positions.clone(), positions.clone()
    moved[2] += 0.01
    endless[1] = torch.nan
    for wrong in (positions[:3], moved, positions.flip(0), endless):
        with refuses():
            scannet.gaussian_truth(splat(wrong), points, CLASSES["19"], "a.ply")
