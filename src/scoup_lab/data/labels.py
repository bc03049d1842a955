"""Label files of LERF-OVS: what is where in a frame (docs/evaluation.md)."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from scoup.base import (
    FileFormatError,
    InputError,
    JsonNode,
    MissingFileError,
    ScoupWarning,
    UnknownNameError,
    counted,
    listed,
)
from scoup.io import MAX_IMAGE_SIDE, read_json
from scoup.scene import Camera, Cameras, resize_labels

_SHAPE = 0.01  # share by which the shapes of labels and views may differ, by rounding
_FAR = 1e6  # coordinates beyond this are damage, and more than the polygon painter can take
_MOST_PAINTED, _MOST_KEPT = 1 << 33, 1 << 28  # pixels, of all objects and of all categories
_REMEDY = "the file is damaged or not a LERF-OVS label file"


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """The ground truth of one frame."""

    name: str  # of the frame: the stem of its label file, which is that of its image
    width: int  # in pixels, of the image that was labelled
    height: int
    # per label, boolean [H, W]: all its polygons united. Labels are in the order of the file.
    masks: dict[str, Tensor]
    boxes: dict[str, Tensor]  # per label, [B, 4] float32 (x1, y1, x2, y2), one for each of its objects

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(self.masks)

    def resized(self, width: int, height: int) -> LabelledFrame:
        """Return the same truth at another image size: masks by nearest neighbour, boxes scaled."""
        if (width, height) == (self.width, self.height):
            return self
        # Pixel centres: the box corner at column x covers the point x + 0.5 of the photograph.
        scale = torch.tensor([width / self.width, height / self.height] * 2)
        masks = {label: resize_labels(mask, width, height) for label, mask in self.masks.items()}
        boxes = {label: (corners + 0.5) * scale - 0.5 for label, corners in self.boxes.items()}
        return LabelledFrame(self.name, width, height, masks, boxes)


def read_labels(folder: str | Path) -> list[LabelledFrame]:
    """Return all label files ``*.json`` of a folder, in order of their names."""
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFileError(folder, "there is no such folder (expected label files)", "check the path")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".json")
    if not paths:
        raise MissingFileError(
            folder, "contains no label file (*.json)", "pass the folder of one scene's labels"
        )
    return [read_frame(path) for path in paths]


def read_frame(path: str | Path) -> LabelledFrame:
    """Return one label file. Polygon corners are cut to whole pixels (towards zero) and filled, edges included."""
    path = Path(path)
    content = read_json(path, "LERF-OVS labels", _REMEDY)
    info, objects = content.get("info"), content.get("objects").items()
    width, height = (info.get(side).whole(1, MAX_IMAGE_SIDE) for side in ("width", "height"))
    categories = {item.get("category").text() for item in objects}
    pixels_painted, pixels_kept = (width * height * max(1, len(some)) for some in (objects, categories))
    if pixels_painted > _MOST_PAINTED or pixels_kept > _MOST_KEPT:
        problem = f"has {len(objects)} objects of {len(categories)} categories on {width} x {height} pixels, too many"
        raise FileFormatError(path, problem, _REMEDY)
    canvases: dict[str, Image.Image] = {}
    boxes: dict[str, list[list[float]]] = {}
    for item in objects:
        label, corners, box = _object(item)
        canvas = canvases.get(label) or canvases.setdefault(label, Image.new("1", (width, height)))
        painter = ImageDraw.Draw(canvas)
        painter.polygon(corners, fill=1)
        painter.line([*corners, corners[0]], fill=1)  # an outline of the fill's colour is not drawn
        boxes.setdefault(label, []).append(box)
    for label, canvas in canvases.items():
        if canvas.getbbox() is None:
            problem = f"the truth of {label!r} has no pixel in its {width} x {height} image"
            raise FileFormatError(path, problem, _REMEDY)
    return LabelledFrame(
        path.stem,
        width,
        height,
        {label: torch.from_numpy(np.array(canvas, dtype=bool)) for label, canvas in canvases.items()},
        {label: torch.tensor(corners, dtype=torch.float32) for label, corners in boxes.items()},
    )


def match_frames(frames: Iterable[LabelledFrame], cameras: Cameras) -> list[tuple[LabelledFrame, Camera]]:
    """Return frames with their cameras, found by name (never by number: a view that failed to register shifts
    those).

    Frames without a camera are skipped with a ScoupWarning; those of another shape than their view are refused.
    """
    matched: list[tuple[LabelledFrame, Camera]] = []
    lost: list[str] = []
    for frame in frames:
        try:
            matched.append((frame, cameras[frame.name]))
        except UnknownNameError:
            lost.append(frame.name)
    for frame, camera in matched:
        expected = frame.height * camera.width / frame.width
        if abs(camera.height - expected) > max(_SHAPE * expected, 1.5 * max(1.0, camera.width / frame.width)):
            raise InputError(
                f"the labels of {frame.name!r} are {frame.width} x {frame.height}, another shape than its view "
                f"({camera.width} x {camera.height}); use labels and cameras of the same photographs"
            )
    if not matched:
        raise InputError(
            f"none of the labelled frames ({listed(lost) or 'there are none'}) is among the "
            f"{counted(len(cameras), 'camera')} ({listed(cameras.names)}); labels and cameras are of "
            "different scenes"
        )
    if lost:
        warnings.warn(
            f"{counted(len(lost), 'labelled frame')} without a camera, not scored: {', '.join(lost[:5])}",
            ScoupWarning,
            stacklevel=2,
        )
    return matched


def _object(item: JsonNode) -> tuple[str, list[tuple[int, int]], list[float]]:
    """Return the category, the corners and the box (x1, y1, x2, y2) of an object."""
    corners = [_near(corner, 2) for corner in item.get("segmentation").items()]
    if not corners:
        raise item.get("segmentation").error("a polygon")
    whole = [(int(x), int(y)) for x, y in corners]
    # Two corners are a line and one is a point; the painter wants three.
    whole += whole[-1:] * (3 - len(whole))
    category, box = item.get("category").text(), item.get("bbox")
    if box.value is None:
        xs, ys = zip(*corners, strict=True)
        return category, whole, [min(xs), min(ys), max(xs), max(ys)]
    x1, y1, x2, y2 = _near(box, 4)
    return category, whole, [min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2)]


def _near(node: JsonNode, count: int) -> list[float]:
    numbers = node.numbers(count).tolist()
    if any(abs(entry) > _FAR for entry in numbers):
        raise node.error("numbers near the image")
    return numbers
