"""The point-level protocol of ScanNet: every Gaussian is a point of the scan, and is given one of 19, 15 or 10 classes.

Read from OpenGaussian's ``scripts/eval_scannet.py`` (yanmin-wu/OpenGaussian, as in its copy anihcsam/OpenGaussian):
the scenes, the numbers of the classes among the 40 of NYU, their names as texts, Gaussians whose opacity is below 0.1
left out with the points of other classes, mIoU and mAcc of a scene over the classes that it has. Gaussians keep the
positions and the order of the scan's points while they are trained, so Gaussian i has the label of point i.

*Choices* where the script does not apply or is silent: figures are means over scenes; a Gaussian without a code is
given no class and counts as missed (the script gives clusters without features the first class); see
``points.label_gaussians`` for the level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from scoup.base import InputError, counted, looked_up
from scoup.scene import Gaussians
from scoup_lab.data.labelled_points import NYU40, LabelledPoints, read_labelled_ply
from scoup_lab.evaluate.protocols.points import NO_CLASS, ClassList
from scoup_lab.evaluate.scenes import USUAL, Places, SceneFiles, check_root, choose_scenes

TITLE = "ScanNet points"
"""In tables."""
SPLAT = "point_cloud.ply"  # the splat of a scene if it lies in its folder, where other PLY files lie too
SCENES = (
    "scene0000_00", "scene0062_00", "scene0070_00", "scene0097_00", "scene0140_00",
    "scene0200_00", "scene0347_00", "scene0400_00", "scene0590_00", "scene0645_00",
)  # fmt: skip
NUMBERS = {
    "19": (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36),
    "15": (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 33, 34),
    "10": (1, 2, 4, 5, 6, 7, 8, 9, 10, 33),
}
"""Of the classes among the 40, by the name of the list."""
CLASS_LISTS = {name: ClassList(name, tuple(NYU40[n] for n in numbers)) for name, numbers in NUMBERS.items()}
LEAST_OPACITY = 0.1
FARTHEST = 1e-3  # metres between a Gaussian and its point: positions are frozen, and files store float32


def labels_path(folder: Path) -> Path:
    """Return the labelled points of a scene, as ScanNet names them."""
    return folder / f"{folder.name}_vh_clean_2.labels.ply"


def gaussian_truth(gaussians: Gaussians, points: LabelledPoints, classes: ClassList, where: str) -> Tensor:
    """Return [N] int64 true class of each Gaussian, ``NO_CLASS`` where it does not count.

    ``points``: N, with numbers of NYU's 40 classes; ``classes``: one of ``CLASS_LISTS``.
    """
    remedy = (
        "the protocol needs a splat that starts from these points and is trained with their positions frozen and "
        "without densification"
    )
    if len(gaussians) != len(points.labels):
        raise InputError(
            f"{where}: has {counted(len(points.labels), 'point')}, the splat "
            f"{counted(len(gaussians), 'Gaussian')}; {remedy}"
        )
    apart = (gaussians.means.cpu() - points.positions).norm(dim=1)
    if len(apart) and not float(apart.max()) <= FARTHEST:
        position = int(apart.argmax())
        raise InputError(
            f"{where}: Gaussian {position} is {float(apart[position]):.3g} m from its point; {remedy}"
        )
    truth = torch.full(points.labels.shape, NO_CLASS, dtype=torch.int64)
    for position, number in enumerate(NUMBERS[classes.name]):
        truth[points.labels == number] = position
    return truth.masked_fill(gaussians.opacities.cpu() < LEAST_OPACITY, NO_CLASS)


def find_class_list(name: str) -> ClassList:
    """Return a list of classes by name."""
    return looked_up("list of classes of scannet", name, CLASS_LISTS)


def find(root: Path, wanted: Sequence[str] = ()) -> list[str]:
    """Return the names of the scenes below ``root`` whose points have classes: those wanted, or all, the published
    ones first.
    """
    check_root(root, "scannet")
    names = sorted(path.name for path in root.iterdir() if labels_path(path).is_file())
    return choose_scenes(root, names, wanted, SCENES, str(labels_path(Path("SCENE"))))


def open_scene(root: Path, name: str, places: Places = USUAL) -> SceneFiles:
    """Read the cameras of a scene, and find its splat and features; the truth is not read yet."""
    folder = root / name
    if places.gaussians is None and (folder / SPLAT).is_file():
        places = replace(places, gaussians=str(folder / SPLAT))
    return places.open(folder, name)


def read_truth(folder: Path, classes: ClassList, gaussians: Gaussians) -> Tensor:
    """Return [N] int64 true class of each Gaussian of a scene: that of the point of its number."""
    path = labels_path(folder)
    return gaussian_truth(gaussians, read_labelled_ply(path), classes, str(path))
