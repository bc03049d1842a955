"""The parts of a scene folder that a build needs, each found in its usual place or named by the user."""

from __future__ import annotations

import shlex
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.io.camera_images import folder_photographs
from scoup.io.camera_sources import CameraSource, camera_format, find_cameras, has_cameras, scene_folder
from scoup.io.regions.views import FEATURES_FOLDER
from scoup.io.scenes import camera_photographs
from scoup.io.splats.formats import SplatSource, splat_source


@dataclass(frozen=True)
class ScenePaths:
    """The paths of the parts of a scene: each in its usual place, or where the user says."""

    scene: Path
    """Its folder, or its file of cameras."""

    @property
    def folder(self) -> Path:
        """The folder that the path means (``camera_sources.scene_folder``)."""
        return scene_folder(self.scene)

    @property
    def has_cameras(self) -> bool:
        """Whether it is the folder of a scene, by its files of cameras."""
        return has_cameras(self.scene)

    def cameras(self) -> CameraSource:
        """Return the source of the cameras (``camera_sources.find_cameras``)."""
        return find_cameras(self.scene)

    def splat(self, gaussians: Path | None = None) -> SplatSource:
        """Return the trained splat: the one named, else the one in the scene's folder."""
        if gaussians is not None:
            return splat_source(gaussians)
        scene = self.scene
        try:
            return splat_source(self.folder if scene.is_dir() else scene)
        except FileFormatError as error:
            if not scene.exists():
                raise FileFormatError(scene, "there is no such scene", "check the path") from error
            if scene.is_dir():
                find_cameras(scene)  # a folder without cameras is not a scene; the error suggests scenes
            elif camera_format(scene) is None:
                problem = "is neither a scene nor a splat"
                raise FileFormatError(scene, problem, "pass the folder of cameras and photographs") from error
            problem = error.problem if scene.is_dir() else "is not a splat, and none is named"
            raise FileFormatError(error.path, problem, "name the trained splat with `gaussians`") from error

    def features(self, features: Path | None = None, to_make: bool = False) -> Path:
        """Return the folder of region features: the one named, else the usual one in the scene's folder, which must
        exist unless it is ``to_make``."""
        if features is not None:
            return features
        folder = self.folder / FEATURES_FOLDER
        if not to_make and not folder.is_dir():
            problem = "there is no such folder (the region features were expected here)"
            raise MissingFileError(
                folder,
                problem,
                f"make them with scoup extract {shlex.quote(str(self.scene))}, or name their folder with `features`",
            )
        return folder

    def photographs(self, images: str | Path | None = None) -> list[tuple[str, Path, Path | None]]:
        """Return name, file and mask of the photographs: those of the cameras, as ``camera_photographs``, or without
        cameras all of the folder, as ``folder_photographs``."""
        scene = self.scene
        if not scene.exists():
            raise MissingFileError(scene, "there is no such scene", "check the path")
        with suppress(MissingFileError):  # no cameras: all photographs of a folder
            named, searched = camera_photographs(scene, images)
            if named and searched:
                message = f"{scene}: cameras without a photograph have no regions ({searched})"
                warnings.warn(message, ScoupWarning, stacklevel=3)
            if not named:
                problem = f"has cameras, but none of their photographs was found ({searched})"
                raise FileFormatError(
                    scene, problem, "pass the folder that their names are relative to as `images`"
                )
            return named
        return [(name, path, None) for name, path in folder_photographs(scene, images).items()]
