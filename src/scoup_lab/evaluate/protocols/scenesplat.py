"""SceneSplat-Bench: labelled points of a scene take the class of the Gaussian nearest to them.

Read from the benchmark's code (unique1i/GaussianWorld_Benchmark, ``gaussian_world_3d_semseg_benchmarks/ludvig/
open_vocab_seg_ludvig_scannet.py`` and its fellows for ScanNet++, Matterport3D and HoliCity, ``occamlgs/
open_vocab_seg_scannet.py``) and from SceneSplat's (zenghjian/SceneSplat, ``pointcept/datasets/scannetgs.py``,
``preprocessing/scannet/preprocess_scannet_gs.py``): the files, the classes, "this is a ..." as text, the argmax of the
cosine, Gaussians without features left out, one confusion matrix over all scenes, classes without points left out of
means. **The f of f-mIoU and f-mAcc is foreground**: the mean leaves out wall, floor and ceiling (and "other furniture"
on Matterport3D). It is no weighting by frequency.

*Choices* where the scripts differ from each other: the one nearest Gaussian answers (LUDVIG's scripts for ScanNet and
ScanNet++; others let the 25 nearest vote, ``neighbours``); predictions are not made alike within true instances, as
the script for OccamLGS does.
"""

from __future__ import annotations

from pathlib import Path

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.scene.gaussians import Gaussians
from scoup_lab.data.class_names import MATTERPORT21, SCANNET20, SCANNET200, SCANNETPP100
from scoup_lab.data.labelled_points import LabelledPoints, read_labelled_npy
from scoup_lab.evaluate.protocols.points import NO_CLASS, ClassList, PointProtocol, PointTruth

SPLITS = ("val", "test", "")
"""Folders of ROOT that contain scenes, in the order in which a scene is looked for."""
COORDINATES, SEGMENT = "coord.npy", "segment"
SCAN = "pc_"  # prefix of the files with the scan's own points, which count where there are any

_STUFF = frozenset({"wall", "floor", "ceiling"})
_PROMPT = "this is a {}"
_HOLICITY = (
    ("this is a building or other construction", 0),
    ("this is a road or street", 1),
    ("this is a terrain or ground that is near a road", 2),
    ("part of a tree or plant", 3),
    ("this is a car or vehicle", 1),
    ("this is a pedestrian", 2),
)
CLASS_LISTS = {
    "scannet20": ClassList("scannet20", SCANNET20, _STUFF, _PROMPT, file="segment20"),
    "scannet200": ClassList("scannet200", SCANNET200, _STUFF, _PROMPT, file="segment200"),
    "scannetpp": ClassList("scannetpp", SCANNETPP100, _STUFF, _PROMPT, file=SEGMENT),
    "matterport": ClassList("matterport", MATTERPORT21, _STUFF | {"other furniture"}, _PROMPT, file=SEGMENT),
    "holicity": ClassList(
        "holicity", ("buildings", "roads", "terrains", "trees"), described=_HOLICITY, file=SEGMENT
    ),
}


def scene_folder(root: Path, name: str) -> Path:
    """Return the folder of a scene below ``root``; that of the first split where there is none."""
    folders = [root / split / name for split in SPLITS]
    return next((folder for folder in folders if (folder / COORDINATES).is_file()), folders[0])


def scene_names(root: Path) -> list[str]:
    """Return names of the folders with points below ``root`` and its splits, sorted."""
    homes = [root / split for split in SPLITS]
    return sorted(
        {path.parent.name for home in homes if home.is_dir() for path in home.glob(f"*/{COORDINATES}")}
    )


def read_truth(folder: Path, classes: ClassList) -> LabelledPoints:
    """Return the labelled points of a scene: of the scan (``pc_coord.npy``, ``pc_segment*.npy``), else
    ``coord.npy`` and ``segment*.npy``, which are points or Gaussians. Negative numbers stand for no class.
    """
    for prefix in (SCAN, ""):
        labels = folder / f"{prefix}{classes.file}.npy"
        if labels.is_file():
            break
    else:
        remedy = f"pass the classes of the benchmark ({', '.join(CLASS_LISTS)})"
        problem = f"there is no such file (expected the classes of {classes.name})"
        raise MissingFileError(folder / f"{classes.file}.npy", problem, remedy)
    points = read_labelled_npy(folder / f"{prefix}{COORDINATES}", labels)
    if len(points.labels) and int(points.labels.max()) >= len(classes.classes):
        raise FileFormatError(
            labels,
            f"has a class {int(points.labels.max())}, {classes.name} has {len(classes.classes)} classes",
            "pass the classes of its benchmark",
        )
    return LabelledPoints(points.positions, points.labels.clamp(min=NO_CLASS))


def point_truth(folder: Path, classes: ClassList, _: Gaussians) -> PointTruth:
    """Return the truth of a scene, whose points take the classes of the Gaussians nearest to them."""
    points = read_truth(folder, classes)
    return PointTruth(points.labels, points)


PROTOCOL = PointProtocol(
    "scenesplat",
    "SceneSplat-Bench",
    scenes=(),
    class_lists=CLASS_LISTS,
    default_classes=("scannet20",),
    pooled=True,
    names=scene_names,
    expected=str(Path(SPLITS[0]) / "SCENE" / COORDINATES),
    folder=scene_folder,
    truth=point_truth,
)
