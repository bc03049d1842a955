"""Points with the number of a class each: ScanNet's labelled meshes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, existing_file, listed
from scoup.io import PlyTable

_MAX_LABEL = 1 << 31

_NAMES = """
    unlabeled, wall, floor, cabinet, bed, chair, sofa, table, door, window, bookshelf, picture, counter, blinds,
    desk, shelves, curtain, dresser, pillow, mirror, floormat, clothes, ceiling, books, refrigerator,
    television, paper, towel, showercurtain, box, whiteboard, person, nightstand, toilet, sink, lamp, bathtub,
    bag, otherstructure, otherfurniture, otherprop
"""
NYU40 = tuple(" ".join(name.split()) for name in _NAMES.split(","))
"""Names of the 40 classes of NYU and of what has none, in the order of ScanNet's labels, as OpenGaussian's
``scripts/eval_scannet.py`` spells them."""


@dataclass(frozen=True, eq=False)
class LabelledPoints:
    """Points of a scan."""

    positions: Tensor  # [P, 3] float32
    labels: Tensor  # [P] int64 number of the class; what stands for none depends on the data set


def read_labelled_ply(path: str | Path) -> LabelledPoints:
    """Return the vertices of a PLY with a ``label``, such as ScanNet's ``<scene>_vh_clean_2.labels.ply``."""
    path = existing_file(path, "a PLY file of labelled points")
    table = PlyTable.read(path)
    missing = [name for name in ("x", "y", "z", "label") if name not in table.names]
    if missing:
        raise FileFormatError(
            path,
            f"its vertices have no {', '.join(missing)} (but {listed(table.names, 5)})",
            "pass the labelled mesh, <scene>_vh_clean_2.labels.ply",
        )
    positions = _finite(path, table.columns(("x", "y", "z")))
    labels = _whole(path, table.columns(("label",), np.float64)[:, 0])
    return LabelledPoints(torch.from_numpy(positions), torch.from_numpy(labels))


def write_labelled_ply(points: LabelledPoints, path: str | Path) -> None:
    """Write vertices as ScanNet does: x, y, z, colour and alpha (grey here), label; without faces."""
    colors = [(name, "u1") for name in ("red", "green", "blue", "alpha")]
    kinds = [*((name, "<f4") for name in "xyz"), *colors, ("label", "<u2")]
    rows = np.zeros(len(points.labels), dtype=kinds)
    for column, name in enumerate("xyz"):
        rows[name] = points.positions[:, column].numpy()
    for name, _ in colors:
        rows[name] = 255 if name == "alpha" else 128
    rows["label"] = points.labels.numpy()
    PlyTable(Path("<memory>"), rows).write(path)


def _finite(path: Path, positions: np.ndarray) -> np.ndarray:
    if not np.isfinite(positions).all():
        raise FileFormatError(path, "has points whose coordinates are not finite", "preprocess it again")
    return positions


def _whole(path: Path, labels: np.ndarray) -> np.ndarray:
    """Return [P] float64 as int64."""
    if not (np.isfinite(labels) & (labels == np.round(labels)) & (np.abs(labels) < _MAX_LABEL)).all():
        raise FileFormatError(path, "has labels that are not whole numbers", "pass the numbers of classes")
    return labels.astype(np.int64)
