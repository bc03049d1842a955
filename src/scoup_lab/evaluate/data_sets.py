"""The data sets of the protocols: which scenes lie below a folder, and all that is needed to build and score one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from scoup.base.errors import InputError, MissingFileError, UnknownNameError, looked_up
from scoup.io import find_gaussians, load_cameras
from scoup.io.regions.views import FOLDER_NAME
from scoup.query.presets import QueryPreset, query_preset
from scoup.scene.cameras import Camera, Cameras
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels
from scoup_lab.evaluate.protocols import lerf_ovs, mipnerf360, ref_lerf, threed_ovs


@dataclass(frozen=True)
class DataSet:
    """What the protocols differ in, apart from the rules themselves.

    Attributes:
        name: as on the command line.
        protocol: as tables name it.
        scenes: of the published data set.
        systems: whose presets are known for it.
        at_label_size: whether features are brought to the size of the label (else labels to that of the render).
    """

    name: str
    protocol: str
    scenes: tuple[str, ...]
    systems: tuple[str, ...]
    at_label_size: bool = False


DATA_SETS: dict[str, DataSet] = {
    "lerf-ovs": DataSet(
        "lerf-ovs",
        lerf_ovs.PROTOCOL,
        ("ramen", "teatime", "waldo_kitchen", "figurines"),
        ("scoup", "langsplatv2", "langsplat"),
    ),
    "3d-ovs": DataSet(
        "3d-ovs",
        threed_ovs.PROTOCOL,
        ("bed", "bench", "room", "sofa", "lawn"),
        ("scoup", "langsplatv2"),
    ),
    "mipnerf360": DataSet(
        "mipnerf360",
        mipnerf360.PROTOCOL,
        ("room", "counter", "garden", "bonsai"),
        ("scoup", "langsplatv2"),
        at_label_size=True,
    ),
    "ref-lerf": DataSet(
        "ref-lerf",
        ref_lerf.PROTOCOL,
        ("ramen", "figurines", "teatime", "waldo_kitchen"),
        ("scoup", "langsplatv2", "langsplat"),
    ),
}


class SceneFiles(Protocol):
    """What of a scene its field is built from, whatever scores it; the splat and the features are not read yet.

    Attributes:
        name: of its folder.
        folder: the scene.
        splat: file or folder of the trained Gaussians.
        features: folder of the region features.
        cameras: all of them.
    """

    @property
    def name(self) -> str: ...
    @property
    def folder(self) -> Path: ...
    @property
    def splat(self) -> Path: ...
    @property
    def features(self) -> Path: ...
    @property
    def cameras(self) -> Cameras: ...


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """A scene of a data set, ready to be built and scored; the splat and the features are not read yet.

    Attributes:
        data_set: whose protocol scores it.
        name: of its folder.
        folder: the scene.
        splat: file or folder of the trained Gaussians.
        features: folder of the region features.
        cameras: all of them.
        frames: labelled frames with their cameras.
    """

    data_set: DataSet
    name: str
    folder: Path
    splat: Path
    features: Path
    cameras: Cameras
    frames: list[tuple[LabelledFrame, Camera]]

    @property
    def labels(self) -> list[str]:
        """All labels of all frames, in alphabetic order."""
        return sorted({label for frame, _ in self.frames for label in frame.labels})

    @property
    def n_pairs(self) -> int:
        """(frame, label) pairs."""
        return sum(len(frame.labels) for frame, _ in self.frames)

    def map_size(self, frame: LabelledFrame, camera: Camera) -> tuple[int, int]:
        """(width, height) of the maps a frame is scored at."""
        of_label = self.data_set.at_label_size
        return (frame.width, frame.height) if of_label else (camera.width, camera.height)


@dataclass(frozen=True)
class Places:
    """Where the parts of a scene lie, if not where they usually do; ``{scene}`` is replaced by its name.

    Attributes:
        gaussians: the trained splat. Default: the one in the scene's folder.
        features: region features. Default: ``language_features`` in the scene's folder.
        images: photographs. Default: as ``load_cameras`` finds them.
        cameras: what ``load_cameras`` takes. Default: the scene's folder.
    """

    gaussians: str | None = None
    features: str | None = None
    images: str | None = None
    cameras: str | None = None


def find_data_set(name: str) -> DataSet:
    """A data set by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("data set", name, DATA_SETS)


def data_set_preset(data_set: DataSet, system: str) -> QueryPreset:
    """The constants of a system for a data set, with the data set's own rule for the level.

    Raises:
        UnknownNameError: the system names none for it.
    """
    makers: dict[str, Callable[[str], QueryPreset]] = {
        "lerf-ovs": query_preset,
        "3d-ovs": threed_ovs.preset,
        "mipnerf360": mipnerf360.preset,
        "ref-lerf": query_preset,
    }
    if system not in data_set.systems:
        raise UnknownNameError(f"system with a rule for {data_set.name}", system, data_set.systems)
    return makers[data_set.name](system)


def find_scenes(data_set: DataSet, root: Path, wanted: Sequence[str] = ()) -> list[str]:
    """Names of the scenes below ``root`` that have labels: those wanted, or all, the published ones first.

    Raises:
        MissingFileError: there is no such folder, or no labelled scene in it.
        UnknownNameError: a scene wanted is not there.
    """
    check_root(root, data_set.name)
    names = sorted(
        path.name for path in root.iterdir() if path.is_dir() and _labels(data_set, root, path.name).is_dir()
    )
    expected = f"folder SCENE with {_labels(data_set, root, 'SCENE').relative_to(root)}"
    return chosen_scenes(root, names, wanted, data_set.scenes, expected)


def check_root(root: Path, data_set: str) -> None:
    """Refuse what is no folder.

    Raises:
        MissingFileError: there is no such folder.
    """
    if not root.is_dir():
        raise MissingFileError(
            root, f"there is no such folder (a {data_set} data set was expected)", "check the path"
        )


def chosen_scenes(
    root: Path, names: Sequence[str], wanted: Sequence[str], published: Sequence[str], expected: str
) -> list[str]:
    """The scenes wanted of those found, or all, the published ones first.

    Args:
        root: where they are, for errors.
        names: found there.
        wanted: by the user; none for all.
        published: of the published data set.
        expected: what makes a scene, for errors.

    Raises:
        MissingFileError: none was found.
        UnknownNameError: a scene wanted is not there.
    """
    if not names:
        raise MissingFileError(root, f"holds no labelled scene: no {expected}", "check the path")
    for name in wanted:
        if name not in names:
            raise UnknownNameError("labelled scene", name, names, str(root))
    known = [name for name in published if name in names]
    return list(dict.fromkeys(wanted or [*known, *names]))


def open_scene(
    data_set: DataSet, root: Path, name: str, places: Places = Places(), undistort: bool = False
) -> LabelledScene:
    """Read cameras and labels of a scene, and find its splat and features.

    Raises:
        MissingFileError: something is not there.
        InputError: labels and cameras are of different scenes, or no label is in sight.
    """
    folder = root / name
    splat, features, cameras = find_parts(folder, name, places, undistort)
    labels = _labels(data_set, root, name)
    if data_set.name == "3d-ovs":
        frames = threed_ovs.united(threed_ovs.read_segmentations(folder), name)
    elif data_set.name == "ref-lerf":
        frames = ref_lerf.read_frames(folder)
    else:
        frames = [frame for frame in read_labels(labels) if frame.labels]
    if not frames:
        raise InputError(f"{labels}: there are no labels to score")
    return LabelledScene(data_set, name, folder, splat, features, cameras, match_frames(frames, cameras))


def find_parts(folder: Path, name: str, places: Places, undistort: bool) -> tuple[Path, Path, Cameras]:
    """The splat and the features of a scene, and its cameras, which are read.

    Raises:
        MissingFileError: one is not there.
    """
    splat = _placed(places.gaussians, name) or folder
    try:
        splat = find_gaussians(splat)
    except MissingFileError as error:
        remedy = 'name the trained splats with --gaussians, for example "splats/{scene}/point_cloud.ply"'
        raise MissingFileError(error.path, error.problem, remedy) from error
    features = _placed(places.features, name) or folder / FOLDER_NAME
    if not features.is_dir():
        problem = "there is no such folder (the region features were expected here)"
        raise MissingFileError(
            features, problem, 'say where they are with --features, for example "f/{scene}"'
        )
    home = _placed(places.cameras, name) or folder
    cameras = load_cameras(home, _placed(places.images, name), None, "undistort" if undistort else "refuse")
    return splat, features, cameras


def _labels(data_set: DataSet, root: Path, name: str) -> Path:
    if data_set.name == "ref-lerf":
        return ref_lerf.sentence_folder(root / name)
    return root / name / "segmentations" if data_set.name == "3d-ovs" else root / "label" / name


def _placed(pattern: str | None, scene: str) -> Path | None:
    return None if pattern is None else Path(pattern.replace("{scene}", scene))
