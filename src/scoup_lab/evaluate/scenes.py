"""Scenes of a data set on disk: the inputs of a field, and their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scoup.base import MissingFileError, UnknownNameError
from scoup.io import ScenePaths, load_cameras, splat_source
from scoup.scene import Cameras


@dataclass(frozen=True, eq=False)
class SceneFiles:
    """The inputs of a field; the splat and the features are not read yet."""

    name: str  # of its folder
    folder: Path
    splat: Path  # file or folder of the trained Gaussians
    features: Path  # folder of the region features
    cameras: Cameras  # all of them


@dataclass(frozen=True)
class Places:
    """Places of the parts of a scene, if not the usual ones; ``{scene}`` is replaced by its name."""

    gaussians: str | None = None  # the trained splat; default: the one in the scene's folder
    features: str | None = None  # region features; default: ``language_features`` in the scene's folder
    images: str | None = None  # photographs; default: as ``load_cameras`` finds them
    cameras: str | None = None  # what ``load_cameras`` takes; default: the scene's folder
    undistort: bool = False  # accept cameras with lens distortion

    def open(self, folder: Path, name: str) -> SceneFiles:
        """Find the splat and the features of a scene, and read its cameras."""
        splat = _placed(self.gaussians, name) or folder
        try:
            splat = splat_source(splat).path
        except MissingFileError as error:
            remedy = 'pass gaussians, for example "splats/{scene}/point_cloud.ply"'
            raise MissingFileError(error.path, error.problem, remedy) from error
        features = ScenePaths(folder).features(_placed(self.features, name), to_make=True)
        if not features.is_dir():
            problem = "there is no such folder (expected region features)"
            raise MissingFileError(features, problem, 'pass features, for example "f/{scene}"')
        home, lenses = _placed(self.cameras, name) or folder, "undistort" if self.undistort else "refuse"
        cameras = load_cameras(home, _placed(self.images, name), None, lenses)
        return SceneFiles(name, folder, splat, features, cameras)


USUAL = Places()
"""Everything where it usually lies."""


def check_root(root: Path, data_set: str) -> None:
    """Refuse a root that is not a folder."""
    if not root.is_dir():
        raise MissingFileError(
            root, f"there is no such folder (expected a {data_set} data set)", "check the path"
        )


def choose_scenes(
    root: Path, names: Sequence[str], wanted: Sequence[str], published: Sequence[str], expected: str
) -> list[str]:
    """Return the scenes wanted of those found below ``root``, or all, the published ones first."""
    if not names:
        raise MissingFileError(root, f"contains no labelled scene: no {expected}", "check the path")
    for name in wanted:
        if name not in names:
            raise UnknownNameError("labelled scene", name, names, str(root))
    known = [name for name in published if name in names]
    return list(dict.fromkeys(wanted or [*known, *names]))


def _placed(pattern: str | None, scene: str) -> Path | None:
    return None if pattern is None else Path(pattern.replace("{scene}", scene))
