"""The data sets of the point-level protocols: their scenes below a folder, and the true classes of points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from scoup.base.errors import looked_up
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup_lab.data.labelled_points import LabelledPoints, read_labelled_ply
from scoup_lab.evaluate.data_sets import Places, check_root, chosen_scenes, find_parts
from scoup_lab.evaluate.protocols import scannet, scenesplat
from scoup_lab.evaluate.protocols.point_labels import NO_CLASS, ClassList

SPLAT = "point_cloud.ply"
"""The splat of a scene if it lies in its folder, where other PLY files may lie too."""


@dataclass(frozen=True)
class PointDataSet:
    """A data set whose points have classes.

    Attributes:
        name: as on the command line.
        protocol: as tables name it.
        class_lists: by name; the truth follows from the list.
        scenes: of the published data set, where it names them.
        pooled: whether points of all scenes are counted together; else figures are means over scenes.
    """

    name: str
    protocol: str
    class_lists: Mapping[str, ClassList]
    scenes: tuple[str, ...]
    pooled: bool


POINT_DATA_SETS = {
    "scannet": PointDataSet("scannet", scannet.PROTOCOL, scannet.CLASS_LISTS, scannet.SCENES, False),
    "scenesplat": PointDataSet("scenesplat", scenesplat.PROTOCOL, scenesplat.CLASS_LISTS, (), True),
}


@dataclass(frozen=True, eq=False)
class PointScene:
    """A scene of a point-level data set, as ``scoup_lab.evaluate.data_sets.SceneFiles``; the truth is not read yet."""

    data_set: PointDataSet
    name: str
    folder: Path
    splat: Path
    features: Path
    cameras: Cameras

    def truth(self, classes: ClassList, gaussians: Gaussians) -> PointTruth:
        """The true classes of the scene's points.

        Raises:
            MissingFileError, FileFormatError: the files of the truth are not there or damaged.
            InputError: they do not fit the Gaussians.
        """
        if self.data_set.name == "scannet":
            path = scannet.labels_path(self.folder)
            found = scannet.gaussian_truth(gaussians, read_labelled_ply(path), classes, str(path))
            return PointTruth(found, None)
        points = scenesplat.read_truth(self.folder, classes)
        return PointTruth(points.labels, points)


@dataclass(frozen=True, eq=False)
class PointTruth:
    """True classes.

    Attributes:
        classes: [P] int64; ``NO_CLASS`` for points that do not count.
        points: the points, which take the classes of Gaussians near them; None where point i is Gaussian i.
    """

    classes: Tensor
    points: LabelledPoints | None

    @property
    def counts(self) -> bool:
        """Whether any point has a class."""
        return bool((self.classes != NO_CLASS).any())

    def answers(self, gaussians: Gaussians, given: Tensor, n_classes: int, neighbours: int) -> Tensor:
        """[P] int64 classes of the points from those given to the Gaussians [N].

        Raises:
            InputError: no Gaussian has a class.
        """
        if self.points is None:
            return given.cpu()
        return scenesplat.nearest_classes(
            gaussians.means, given, self.points.positions, n_classes, neighbours
        )


def find_point_data_set(name: str) -> PointDataSet:
    """A data set by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("point-level data set", name, POINT_DATA_SETS)


def find_class_list(data_set: PointDataSet, name: str) -> ClassList:
    """A list of classes by name.

    Raises:
        UnknownNameError: the data set has none of that name.
    """
    return looked_up(f"list of classes of {data_set.name}", name, data_set.class_lists)


def find_point_scenes(data_set: PointDataSet, root: Path, wanted: Sequence[str] = ()) -> list[str]:
    """Names of the scenes below ``root`` whose points have classes: those wanted, or all, the published ones first.

    Raises:
        MissingFileError: there is no such folder, or no such scene in it.
        UnknownNameError: a scene wanted is not there.
    """
    check_root(root, data_set.name)
    if data_set.name == "scannet":
        names = sorted(path.name for path in root.iterdir() if scannet.labels_path(path).is_file())
        expected = scannet.labels_path(Path("SCENE"))
    else:
        names = scenesplat.scene_names(root)
        expected = Path(scenesplat.SPLITS[0]) / "SCENE" / scenesplat.COORDINATES
    return chosen_scenes(root, names, wanted, data_set.scenes, str(expected))


def open_point_scene(
    data_set: PointDataSet, root: Path, name: str, places: Places, undistort: bool = False
) -> PointScene:
    """Read the cameras of a scene, and find its splat and features.

    Raises:
        MissingFileError: something is not there.
    """
    folder = root / name if data_set.name == "scannet" else scenesplat.scene_folder(root, name)
    if places.gaussians is None and (folder / SPLAT).is_file():
        places = replace(places, gaussians=str(folder / SPLAT))
    return PointScene(data_set, name, folder, *find_parts(folder, name, places, undistort))
