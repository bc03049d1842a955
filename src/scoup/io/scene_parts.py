"""The parts of a scene folder that a build needs, each found in its usual place or named by the user."""

from __future__ import annotations

import shlex
from pathlib import Path

from scoup.base import FileFormatError, MissingFileError
from scoup.io.camera_sources import camera_format, find_cameras, scene_folder
from scoup.io.regions.views import FEATURES_FOLDER
from scoup.io.splats.formats import SplatSource, splat_source


def find_splat(scene: Path, gaussians: Path | None = None) -> SplatSource:
    """Return the trained splat: the one named, else the one in the scene's folder."""
    if gaussians is not None:
        return splat_source(gaussians)
    try:
        return splat_source(scene_folder(scene) if scene.is_dir() else scene)
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


def find_features(scene: Path, features: Path | None = None, to_make: bool = False) -> Path:
    """Return the folder of region features: the one named, else the usual one in the scene's folder, which must exist
    unless it is ``to_make``."""
    if features is not None:
        return features
    folder = scene_folder(scene) / FEATURES_FOLDER
    if not to_make and not folder.is_dir():
        problem = "there is no such folder (the region features were expected here)"
        raise MissingFileError(
            folder,
            problem,
            f"make them with scoup extract {shlex.quote(str(scene))}, or name their folder with `features`",
        )
    return folder
