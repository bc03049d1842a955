"""The LERF-OVS protocol: 2D masks and points from relevancy maps, against hand-drawn labels (docs/evaluation.md).

Not to be mixed with the 3D-selection protocol: the same field scores very differently there.
"""

from __future__ import annotations

from pathlib import Path

from scoup_lab.data.labels import LabelledFrame, read_labels
from scoup_lab.evaluate.protocols.pixels import PixelProtocol


def label_folder(root: Path, scene: str) -> Path:
    """Return the folder with the label files of a scene."""
    return root / "label" / scene


def read_labelled_frames(root: Path, scene: str) -> list[LabelledFrame]:
    """Return the frames of a scene that have a label."""
    return [frame for frame in read_labels(label_folder(root, scene)) if frame.labels]


PROTOCOL = PixelProtocol(
    "lerf-ovs",
    "lerf-ovs 2D",
    scenes=("ramen", "teatime", "waldo_kitchen", "figurines"),
    labels=label_folder,
    read=read_labelled_frames,
    localizes=True,
)
