"""The 3D-OVS protocol: masks from relevancy maps of the two coarser levels, against drawn masks (docs/evaluation.md).

Scores are means over all (frame, class) pairs; there is no localisation.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, MissingFileError, ScoupWarning, existing_file
from scoup.io import open_image, rgb_image
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

WHITE = 127  # a pixel above this belongs to the class
UNITED = {"room": ("wood table", "wood wall")}
"""Scene -> (class, class whose truth it is added to)."""

_CLASSES = "classes.txt"
_REMEDY = "pass the scene folder of a 3D-OVS data set"


def read_segmentations(folder: str | Path) -> list[LabelledFrame]:
    """Return the truth of a scene: ``segmentations/classes.txt`` and ``segmentations/<frame>/<class>.png``, 0 or 255.

    Frames are in the order of their names, classes in that of ``classes.txt``. There are no boxes.

    Warns:
        ScoupWarning: frames lack masks of some classes; these pairs are not scored.
    """
    home = Path(folder) / "segmentations"
    if not home.is_dir():
        raise MissingFileError(home, "there is no such folder (expected masks)", _REMEDY)
    classes = _read_classes(home / _CLASSES)
    frames: list[LabelledFrame] = []
    lacking = 0
    for frame in sorted(path for path in home.iterdir() if path.is_dir()):
        masks: dict[str, Tensor] = {}
        for name in classes:
            path = frame / f"{name}.png"
            if path.is_file():
                masks[name] = torch.from_numpy(read_mask(path, WHITE))
                if not masks[name].any():
                    problem = f"is a truth of nothing (no pixel is above {WHITE})"
                    raise FileFormatError(path, problem, "use masks of 0 and 255, or remove the file")
            else:
                lacking += 1
        if not masks:
            continue
        if len({mask.shape for mask in masks.values()}) > 1:
            raise FileFormatError(frame, "its masks differ in size", "all are of one image")
        height, width = next(iter(masks.values())).shape
        frames.append(LabelledFrame(frame.name, width, height, masks, {}))
    if not frames:
        raise MissingFileError(home, "contains no mask of any class (<frame>/<class>.png)", _REMEDY)
    if lacking:
        warnings.warn(
            f"{home}: {lacking} of the masks that {_CLASSES} names are missing and not scored",
            ScoupWarning,
            stacklevel=2,
        )
    return frames


def read_mask(path: str | Path, above: int) -> np.ndarray:
    """Return [H, W] boolean: where an image, turned to grey, is brighter than ``above`` (0..255)."""
    path = existing_file(path, "a mask")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open_image(path) as image:
            return np.asarray(rgb_image(image).convert("L")) > above


def united(frames: Iterable[LabelledFrame], scene: str) -> list[LabelledFrame]:
    """Return the frames with the rule of some scenes: in ``room`` the truth of "wood table" also counts as "wood wall".

    *Choice*: the rule is taken to be about the truth. Both classes stay queries.
    """
    if scene not in UNITED:
        return list(frames)
    part, whole = UNITED[scene]
    changed = []
    for frame in frames:
        masks = dict(frame.masks)
        if part in masks and whole in masks:
            masks[whole] = masks[whole] | masks[part]
        changed.append(replace(frame, masks=masks))
    return changed


def read_scene(root: Path, scene: str) -> list[LabelledFrame]:
    """Return the frames of a scene below ``root``, with the rule of some scenes."""
    return united(read_segmentations(root / scene), scene)


PROTOCOL = PixelProtocol(
    "3d-ovs",
    "3d-ovs 2D",
    scenes=("bed", "bench", "room", "sofa", "lawn"),
    labels=lambda root, scene: root / scene / "segmentations",
    read=read_scene,
    thresholds={"scoup": 0.3, "langsplatv2": 0.25},
    level_choice="mask",
    levels=("m", "l"),
)


def _read_classes(path: Path) -> list[str]:
    if not path.is_file():
        raise MissingFileError(path, "there is no such file (the names of the classes)", _REMEDY)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FileFormatError(path, "is not text", "expected one class per line") from error
    classes = [line.strip() for line in lines if line.strip()]
    if not classes or len(set(classes)) < len(classes):
        problem = "names a class twice" if classes else "names no class"
        raise FileFormatError(path, problem, "expected one class per line")
    return classes
