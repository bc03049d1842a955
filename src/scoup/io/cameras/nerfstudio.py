"""nerfstudio's transforms.json: OpenGL camera-to-world poses, intrinsics for all frames or for each."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, JsonNode, ScoupWarning, counted, foreign_kind, listed, write_text
from scoup.io.cameras.inria import CAMERAS_JSON, portable_name
from scoup.io.image_folder import find_beside, warn_of_outside
from scoup.io.images import image_size
from scoup.io.reading import MAX_IMAGE_SIDE, Distorted, make_camera, read_json, sorted_cameras
from scoup.scene import Camera, Cameras

_REMEDY = (
    "a JSON object is read as nerfstudio's transforms.json, with a list of frames that each have a file_path; Inria's "
    "cameras.json is a list"
)
_PINHOLE_LIKE = {"PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"}
_LENS = re.compile("camera_type|(camera_)?projection(_type)?|lens_(type|model)")
_BENT = re.compile(
    r"(is_|opencv_|simple_|radial_|thin_prism_)*(fisheye|lat_?long|equirect\w*|orthographic|panoram\w*|spherical\w*|omni\w*|"
    r"cylind\w*)(624)?|f_?theta\w*", re.I
)  # fmt: skip
"""Flags and names of lenses that are not pinholes, of nerfstudio, instant-ngp and others. Names of cameras, labels and
descriptions say nothing of the lens."""
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")  # the first six are those of distortion_params
_USED = ("k1", "k2", "p1", "p2")
_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", *_DISTORTION, "distortion_params")
_FLIP = np.diag([1.0, -1.0, -1.0])  # OpenGL's camera looks along -z with y up


def read_transforms(
    path: str | Path, distorted: Distorted = "refuse", by_nerfstudio: bool = False
) -> Cameras:
    """Read transforms.json, sorted by name; ``image_path`` is set where the named file (or one that has the
    name and an image extension) exists.

    Cameras are named by the file names of their images, or by whole paths where two would be equal.

    Args:
        by_nerfstudio: the splat was trained by nerfstudio, which takes intrinsics of the file before those of frames.

    Warns:
        ScoupWarning: frames were skipped because neither the file nor their (missing) image gives their size, or name
            images outside of the file's folder, which are not opened; or intrinsics of file and frames differ.
    """
    path = Path(path)
    content = read_json(path, CAMERAS_JSON, _REMEDY)
    if "frames" not in content.object() and (kind := foreign_kind(content.object())):
        raise FileFormatError(path, *kind)
    frames = content.get("frames").items()
    paths = [portable_name(frame.get("file_path").text()) for frame in frames]
    warn_of_outside(path, path.parent, paths)
    short = [name.rsplit("/", 1)[-1] for name in paths]
    names = short if len(set(short)) == len(short) else paths
    if not by_nerfstudio:
        _warn_of_two_intrinsics(content, frames)
    cameras, unmasked = [], []
    for name, relative, frame in zip(names, paths, frames, strict=True):
        camera = _camera(name, relative, frame, content, distorted, by_nerfstudio)
        if camera is not None:
            mask = frame.get("mask_path")
            if mask.value is not None:
                camera = replace(camera, mask_path=find_beside(path.parent, portable_name(mask.text())))
                unmasked += [camera.name] if camera.mask_path is None else []
            cameras.append(camera)
    if unmasked:
        what = f"{path}: {counted(len(unmasked), 'mask')} (mask_path) not found ({listed(unmasked)})"
        warnings.warn(f"{what}; their photographs are taken whole", ScoupWarning, stacklevel=2)
    skipped = len(frames) - len(cameras)
    if skipped and not cameras:
        raise FileFormatError(
            path, "has no image size (w, h), and no readable image to take it from", "add w and h to it"
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
        frames.append({
            "file_path": file_path, "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy,
            "cx": camera.cx, "cy": camera.cy, **dict(zip(_USED, camera.distortion, strict=False)),
            "transform_matrix": pose.tolist(),
        })  # fmt: skip
    content = {"camera_model": "OPENCV", "frames": frames}
    write_text(path, json.dumps(content, indent=1) + "\n", overwrite)


def _warn_of_two_intrinsics(content: JsonNode, frames: list[JsonNode]) -> None:
    """Warn of intrinsics of the file that frames replace by others."""
    shared = {key: value for key in _INTRINSICS if (value := content.get(key).value) is not None}
    if any(frame.get(key).value not in (None, value) for frame in frames for key, value in shared.items()):
        warnings.warn(
            f"{content.path}: has intrinsics of the file and others of frames, which are used, as in instant-ngp; "
            "nerfstudio trains with those of the file: for its splats, remove those of the frames",
            ScoupWarning,
            stacklevel=3,
        )


def _camera(
    name: str, relative: str, frame: JsonNode, content: JsonNode, distorted: Distorted, by_nerfstudio: bool
) -> Camera | None:
    """Return one frame; None if its size cannot be known. Its settings come before those of the whole file."""
    path = frame.path

    def setting(key: str) -> JsonNode:
        nodes = frame.get(key), content.get(key)
        first, second = reversed(nodes) if by_nerfstudio and key in _INTRINSICS else nodes
        return second if first.value is None else first

    keys = sorted({*content.object(), *frame.object()})
    coefficients = _distortion(name, keys, setting)
    image_path = find_beside(path.parent, relative)
    if setting("w").value is None or setting("h").value is None:
        if image_path is None:
            return None
        try:
            width, height = image_size(image_path)
        except FileFormatError:
            return None
    else:
        width, height = (setting(key).whole(1, MAX_IMAGE_SIDE) for key in ("w", "h"))
    intrinsics = (
        *_focal(setting, width, height),
        setting("cx").number(width / 2),
        setting("cy").number(height / 2),
    )
    pose = setting("transform_matrix").numbers(4, 4)
    camera_to_world = pose[:3, :3] @ _FLIP
    with np.errstate(all="ignore"):
        viewmat = np.concatenate([camera_to_world.T, -camera_to_world.T @ pose[:3, 3:]], axis=1)
    named = name if os.path.splitext(name)[1] or image_path is None else name + image_path.suffix
    return make_camera(path, named, viewmat, intrinsics, (width, height), coefficients, distorted, image_path)


def _distortion(name: str, keys: list[str], setting: Callable[[str], JsonNode]) -> tuple[float, ...]:
    """Return (k1, k2, p1, p2) of a frame; any other lens is refused."""
    model = setting("camera_model").value
    for node in map(setting, keys):
        key, value = node.place.rpartition(".")[2], node.value
        if key == "camera_model":
            refused = value is not None and str(value).upper() not in _PINHOLE_LIKE
        elif isinstance(value, str) and model is None and _LENS.fullmatch(key):
            refused = _BENT.fullmatch(value) is not None
        else:  # a flag
            set_ = value.lower() == "true" if isinstance(value, str) else bool(value)
            refused = set_ and _BENT.fullmatch(key) is not None
        if refused:
            problem = f"frame {name!r} has {key} {str(value)[:40]!r}, a lens that is not supported"
            remedy = "make pinhole images, for example with ns-process-data or colmap"
            raise FileFormatError(node.path, problem, remedy)
    distortion = {key: setting(key).number(0.0) for key in _DISTORTION}
    every = setting("distortion_params")
    if every.value is not None:
        distortion |= dict(zip(_DISTORTION, every.numbers(6).tolist(), strict=False))
    for key, value in distortion.items():
        if value and key not in _USED:
            problem = f"frame {name!r} has distortion {key}, which is not supported"
            raise FileFormatError(every.path, problem, "undistort the images with colmap image_undistorter")
    return tuple(distortion[key] for key in _USED)


def _focal(setting: Callable[[str], JsonNode], width: int, height: int) -> tuple[float, float]:
    """Return (fx, fy) in pixels, from focal lengths or angles of view in radians."""
    fx, fy = setting("fl_x"), setting("fl_y")
    if fx.value is None and fy.value is None:
        focal = width / (2 * _tangent(setting("camera_angle_x")))
        angle = setting("camera_angle_y")
        return focal, height / (2 * _tangent(angle)) if angle.value else focal
    return (fy if fx.value is None else fx).number(), (fx if fy.value is None else fy).number()


def _tangent(angle: JsonNode) -> float:
    """Return the tangent of half an angle of view."""
    if angle.value is None:
        raise FileFormatError(angle.path, "has neither fl_x nor camera_angle_x", "add the focal length")
    tangent = math.tan(angle.number() / 2)
    if not 1e-6 < tangent < 1e6:
        raise angle.error("an angle of view in radians")
    return tangent
