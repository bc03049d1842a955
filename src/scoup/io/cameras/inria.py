"""Outputs of Inria's 3D Gaussian Splatting code: cameras.json, cfg_args, point_cloud/iteration_*/."""

from __future__ import annotations

import ast
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from scoup.base import FileFormatError, MissingFileError, existing_file, listed
from scoup.io.image_folder import warn_of_outside
from scoup.io.reading import (
    MAX_IMAGE_SIDE,
    existing_folder,
    make_camera,
    numbered_files,
    read_json,
    read_text,
    sorted_cameras,
)
from scoup.scene import Cameras

CAMERAS_JSON = (
    "cameras of nerfstudio (an object with a list of frames) or of Inria's code (a list of cameras)"
)
"""Contents of a JSON file of cameras, for messages; only reading it shows the format."""
_REMEDY = (
    "a JSON list is read as cameras of Inria's code, each with img_name, width, height, position, rotation, fx and fy; "
    "nerfstudio's transforms.json is an object with a list of frames"
)
_EQUAL_NAMES = (
    "Inria's code has cut folders and endings off; use the scene that the splat was trained on, and name the splat "
    "with `gaussians`"
)


def read_inria_cameras(path: str | Path) -> Cameras:
    """Read cameras.json, sorted by name. Principal points are the image centres; names may lack an extension."""
    path = Path(path)
    cameras = []
    for entry in read_json(path, CAMERAS_JSON, _REMEDY).items():
        name = portable_name(entry.get("img_name").text())
        width, height = (entry.get(key).whole(1, MAX_IMAGE_SIDE) for key in ("width", "height"))
        camera_to_world, center = entry.get("rotation").numbers(3, 3), entry.get("position").numbers(3)
        with np.errstate(all="ignore"):
            viewmat = np.concatenate([camera_to_world.T, -camera_to_world.T @ center[:, None]], axis=1)
        intrinsics = (entry.get("fx").number(), entry.get("fy").number(), width / 2, height / 2)
        cameras.append(make_camera(path, name, viewmat, intrinsics, (width, height)))
    warn_of_outside(path, path.parent, (camera.name for camera in cameras))
    return sorted_cameras(path, cameras, _EQUAL_NAMES)


def read_cfg_args(path: str | Path) -> dict[str, Any]:
    """Return the settings in a cfg_args file, a printed ``Namespace(...)`` of plain values; it is not run."""
    text = read_text(path := existing_file(path, "cfg_args of Inria's code"))
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        if not (
            isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and tree.func.id == "Namespace"
        ):
            raise ValueError("not a Namespace")
        return {item.arg: ast.literal_eval(item.value) for item in tree.keywords if item.arg is not None}
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise FileFormatError(
            path, "is not a printed Namespace of settings", "delete or restore it"
        ) from error


def latest_point_cloud(folder: str | Path) -> Path:
    """Return the PLY of the last iteration in an Inria output folder (or in its point_cloud folder): MonoGS's final, or
    the only PLY where none is numbered."""
    folder = existing_folder(folder, "an output folder of Inria's code")
    inner = folder if folder.name == "point_cloud" else folder / "point_cloud"
    iterations = numbered_files(inner, "iteration_*/point_cloud.ply")
    final, every = inner / "final" / "point_cloud.ply", sorted(inner.rglob("*.ply"))
    if final.is_file():
        return final
    if iterations or len(every) == 1:
        return iterations[max(iterations)] if iterations else every[0]
    found = f" ({listed([file.relative_to(inner).as_posix() for file in every])})" if every else ""
    problem = f"contains no iteration_*/point_cloud.ply and {len(every)} other .ply{found}"
    raise MissingFileError(inner, problem, "use the folder that training wrote, or the PLY itself")


def portable_name(name: str) -> str:
    """Return an image name with forward slashes and without leading ./ whichever system wrote it."""
    return str(PurePosixPath(name.replace("\\", "/")))
