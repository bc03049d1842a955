"""dataparser_transforms.json of nerfstudio: from the frame of the data to the one it trained the splat in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scoup.base.errors import FileFormatError, InputError
from scoup.io.reading import matrix, number, read_json
from scoup.scene.cameras import Cameras

TRAINED_FRAME = "dataparser_transforms.json"
_WHAT = f"nerfstudio's {TRAINED_FRAME}"
_BEFORE_IT_WAS_NAMED = [
    [0, 1, 0, 0],
    [1, 0, 0, 0],
    [0, 0, -1, 0],
]  # what ns-process-data did to COLMAP's cameras


def in_trained_frame(cameras: Cameras, path: str | Path, transforms: Path | None = None) -> Cameras:
    """Cameras in the frame in which nerfstudio trained and exports its splat.

    Args:
        cameras: in the frame of COLMAP's model, or of a transforms.json.
        path: dataparser_transforms.json, beside config.yml in the training's output.
        transforms: the transforms.json that the cameras come from. What was done to the cameras in it before
            (``applied_transform``, ``applied_scale``) is part of the file at ``path``, and is not done again.

    Raises:
        MissingFileError: a file is not there.
        FileFormatError: it holds no rotation, translation and scale.
    """
    path = Path(path)
    content = read_json(path, _WHAT)
    if not isinstance(content, dict):
        raise FileFormatError(path, "holds no transform and scale", f"it should be {_WHAT}")
    world, scale = _rigid(path, content.get("transform"), "transform"), _scale(path, content, "scale")
    if transforms is not None:
        done = read_json(transforms, "a nerfstudio transforms.json")
        applied = done.get("applied_transform")
        if applied is None and (transforms.parent / "colmap" / "sparse" / "0").is_dir():
            applied = _BEFORE_IT_WAS_NAMED
        if applied is not None:
            world = world @ np.linalg.inv(_rigid(transforms, applied, "applied_transform"))
        if "applied_scale" in done:
            scale /= _scale(transforms, done, "applied_scale")
    try:
        return Cameras(camera.moved(world[:3, :3], world[:3, 3], scale) for camera in cameras)
    except InputError as error:
        raise FileFormatError(path, f"moves cameras too far ({error})", "copy the file again") from error


def _rigid(path: Path, value: Any, what: str) -> np.ndarray:
    """[4, 4] rotation and translation of the 3 x 4 numbers in a file."""
    moved = np.eye(4)
    moved[:3] = matrix(path, value, (3, 4), what)
    rotation = moved[:3, :3]
    with np.errstate(all="ignore"):
        straight = bool(np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-3)
    if not straight or np.linalg.det(rotation) < 0:
        raise FileFormatError(path, f"{what} is not a rotation with a translation", "copy the file again")
    return moved


def _scale(path: Path, content: dict[str, Any], key: str) -> float:
    scale = number(path, content.get(key), key)
    if scale <= 0:
        raise FileFormatError(path, f"{key} is {scale}, expected more than 0", "copy the file again")
    return scale
