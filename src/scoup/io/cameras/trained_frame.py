"""dataparser_transforms.json of nerfstudio: from the frame of the data to the one it trained the splat in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, InputError, JsonNode
from scoup.io.reading import is_orthogonal, read_json
from scoup.scene import Cameras

TRAINED_FRAME = "dataparser_transforms.json"
_WHAT = f"nerfstudio's {TRAINED_FRAME}"
# What ns-process-data did to COLMAP's cameras.
_BEFORE_IT_WAS_NAMED = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]


def in_trained_frame(cameras: Cameras, path: str | Path, transforms: Path | None = None) -> Cameras:
    """Return cameras in the frame in which nerfstudio trained and exports its splat.

    Args:
        cameras: in the frame of COLMAP's model, or of a transforms.json.
        path: dataparser_transforms.json, beside config.yml in the training's output.
        transforms: the transforms.json that the cameras come from. What was done to the cameras in it before
            (``applied_transform``, ``applied_scale``) is part of the file at ``path``, and is not done again.
    """
    path = Path(path)
    content = read_json(path, _WHAT, "copy the file again")
    world, scale = _rigid(content.get("transform")), _scale(content.get("scale"))
    if transforms is not None:
        done = read_json(transforms, "nerfstudio's transforms.json")
        applied = done.get("applied_transform")
        if applied.value is None and (transforms.parent / "colmap" / "sparse" / "0").is_dir():
            applied = replace(applied, value=_BEFORE_IT_WAS_NAMED)
        if applied.value is not None:
            world = world @ np.linalg.inv(_rigid(applied))
        if "applied_scale" in done.object():
            scale /= _scale(done.get("applied_scale"))
    try:
        return Cameras(camera.moved(world[:3, :3], world[:3, 3], scale) for camera in cameras)
    except InputError as error:
        raise FileFormatError(path, f"moves cameras too far ({error})", "copy the file again") from error


def _rigid(transform: JsonNode) -> np.ndarray:
    """Return a rotation and translation [4, 4] from 3 x 4 numbers."""
    moved = np.eye(4)
    moved[:3] = transform.numbers(3, 4)
    if not is_orthogonal(moved[:3, :3]) or np.linalg.det(moved[:3, :3]) < 0:
        problem = f"{transform.place} is not a rotation with a translation"
        raise FileFormatError(transform.path, problem, transform.remedy)
    return moved


def _scale(node: JsonNode) -> float:
    scale = node.number()
    if scale <= 0:
        raise node.error("more than 0")
    return scale
