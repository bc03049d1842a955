"""nerfstudio's transforms.json: OpenGL camera-to-world poses, intrinsics for all frames or for each."""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base.atomic import write_text
from scoup.base.counts import counted
from scoup.base.errors import FileFormatError, ScoupWarning
from scoup.io.cameras.inria import CAMERAS_JSON, portable_name
from scoup.io.image_folder import find_beside, warn_of_outside
from scoup.io.images import image_size
from scoup.io.reading import Distorted, make_camera, matrix, number, pixels, read_json, sorted_cameras
from scoup.scene.cameras import Camera, Cameras

_REMEDY = (
    "a JSON object is read as nerfstudio's transforms.json, with a list of frames that each have a file_path; Inria's "
    "cameras.json is a list"
)
_PINHOLE_LIKE = {"PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"}
_FLIP = np.diag([1.0, -1.0, -1.0])  # OpenGL's camera looks along -z with y up


def read_transforms(path: str | Path, distorted: Distorted = "refuse") -> Cameras:
    """Read transforms.json, sorted by name; ``image_path`` is set where the named file (or one that has the
    name and an image extension) exists.

    Cameras are named by the file names of their images, or by whole paths where two would be alike.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is damaged, lacks intrinsics, or a frame is distorted while that is refused.

    Warns:
        ScoupWarning: frames were skipped because neither the file nor their (missing) image gives their size, or name
            images outside of the file's folder, which are not opened.
    """
    path = Path(path)
    content = read_json(path, CAMERAS_JSON)
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        raise FileFormatError(path, "has no list of frames", _REMEDY)
    frames = content["frames"]
    for position, frame in enumerate(frames):
        if (
            not isinstance(frame, dict)
            or not isinstance(frame.get("file_path"), str)
            or not frame["file_path"]
        ):
            raise FileFormatError(path, f"frame {position} has no file_path", _REMEDY)
    paths = [portable_name(frame["file_path"]) for frame in frames]
    warn_of_outside(path, path.parent, paths)
    short = [name.rsplit("/", 1)[-1] for name in paths]
    names = short if len(set(short)) == len(short) else paths
    cameras = []
    for name, relative, frame in zip(names, paths, frames, strict=True):
        camera = _camera(path, name, relative, {**content, **frame}, distorted)
        if camera is not None:
            cameras.append(camera)
    skipped = len(frames) - len(cameras)
    if skipped and not cameras:
        raise FileFormatError(
            path, "gives no image size (w, h), and no image is there to tell it", "add w and h to it"
        )
    if skipped:
        warnings.warn(
            f"{path}: skipped {skipped} of {counted(len(frames), 'frame')} without an image size and a readable image",
            ScoupWarning,
            stacklevel=2,
        )
    return sorted_cameras(path, cameras)


def write_transforms(cameras: Cameras, path: str | Path, overwrite: bool = False) -> None:
    """Write transforms.json with intrinsics for each frame. Images are named relative to the file where they
    lie below it, and as ``images/NAME`` where a camera has none.

    Raises:
        OutputExistsError, InputError: as ``atomic.check_output``.
    """
    base = Path(path).absolute().parent
    frames = []
    for camera in cameras:
        file_path = f"images/{camera.name}"
        if camera.image_path is not None:
            image_path = camera.image_path.absolute()
            below = image_path.is_relative_to(base)
            file_path = (image_path.relative_to(base) if below else image_path).as_posix()
        pose = np.eye(4)
        rotation = camera.viewmat[:3, :3].numpy().T
        pose[:3, :3], pose[:3, 3] = rotation @ _FLIP, camera.position.numpy()
        k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
        frames.append(
            {
                "file_path": file_path,
                "w": camera.width,
                "h": camera.height,
                "fl_x": camera.fx,
                "fl_y": camera.fy,
                "cx": camera.cx,
                "cy": camera.cy,
                **({"k1": k1, "k2": k2, "p1": p1, "p2": p2} if camera.distortion else {}),
                "transform_matrix": pose.tolist(),
            }
        )
    content = {"camera_model": "OPENCV", "frames": frames}
    write_text(path, json.dumps(content, indent=1) + "\n", overwrite)


def _camera(
    path: Path, name: str, relative: str, entry: Mapping[str, Any], distorted: Distorted
) -> Camera | None:
    """One frame, or None if its size cannot be known. ``entry`` is the file's settings under the frame's."""
    model = entry.get("camera_model", "OPENCV")
    if not isinstance(model, str) or model not in _PINHOLE_LIKE:
        problem = f"camera model {str(model)[:40]!r} of frame {name!r} is not supported"
        raise FileFormatError(
            path, problem, "make pinhole images, for example with ns-process-data or colmap"
        )
    for coefficient in ("k3", "k4"):
        if entry.get(coefficient) and number(path, entry[coefficient], f"{coefficient} of frame {name!r}"):
            problem = f"frame {name!r} has distortion {coefficient}, which is not supported"
            raise FileFormatError(path, problem, "undistort the images with colmap image_undistorter")
    image_path = find_beside(path.parent, relative)
    if entry.get("w") is None or entry.get("h") is None:
        if image_path is None:
            return None
        try:
            width, height = image_size(image_path)
        except FileFormatError:
            return None
    else:
        width = pixels(path, entry["w"], f"w of frame {name!r}")
        height = pixels(path, entry["h"], f"h of frame {name!r}")
    intrinsics = (
        *_focal(path, name, entry, width, height),
        number(path, entry.get("cx", width / 2), f"cx of frame {name!r}"),
        number(path, entry.get("cy", height / 2), f"cy of frame {name!r}"),
    )
    coefficients = tuple(
        number(path, entry.get(key) or 0.0, f"{key} of frame {name!r}") for key in ("k1", "k2", "p1", "p2")
    )
    pose = matrix(path, entry.get("transform_matrix"), (4, 4), f"transform_matrix of frame {name!r}")
    camera_to_world = pose[:3, :3] @ _FLIP
    with np.errstate(all="ignore"):
        viewmat = np.concatenate([camera_to_world.T, -camera_to_world.T @ pose[:3, 3:]], axis=1)
    named = name if os.path.splitext(name)[1] or image_path is None else name + image_path.suffix
    return make_camera(path, named, viewmat, intrinsics, (width, height), coefficients, distorted, image_path)


def _focal(path: Path, name: str, entry: Mapping[str, Any], width: int, height: int) -> tuple[float, float]:
    fx, fy = entry.get("fl_x"), entry.get("fl_y")
    if fx is None and fy is None:
        angle = entry.get("camera_angle_x")
        if angle is None:
            raise FileFormatError(
                path, f"frame {name!r} has neither fl_x nor camera_angle_x", "add the focal length"
            )
        tangent = math.tan(number(path, angle, f"camera_angle_x of frame {name!r}") / 2)
        if not 1e-6 < tangent < 1e6:
            raise FileFormatError(
                path, f"camera_angle_x of frame {name!r} is not an angle of view", "it is in radians"
            )
        fx = width / (2 * tangent)
        angle = entry.get("camera_angle_y")
        if angle is None:
            return fx, fx
        tangent = math.tan(number(path, angle, f"camera_angle_y of frame {name!r}") / 2)
        fy = height / (2 * tangent) if tangent > 1e-6 else fx
        return fx, fy
    fx = fy if fx is None else fx
    fy = fx if fy is None else fy
    return number(path, fx, f"fl_x of frame {name!r}"), number(path, fy, f"fl_y of frame {name!r}")
