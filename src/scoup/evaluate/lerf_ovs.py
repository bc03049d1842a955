"""The LERF-OVS protocol: 2D masks and points from relevancy maps, against hand-drawn labels
(docs/protocols.md).

Not to be mixed with the 3D-selection protocol: the same field scores very differently there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from torch import Tensor

from scoup.errors import InputError
from scoup.evaluate.lerf_labels import LabelledFrame, match_frames, read_frame, read_labels
from scoup.evaluate.metrics import any_inside, iou
from scoup.query import PRESETS, QueryPreset, localize, segment

__all__ = [
    "LabelledFrame",
    "PairScore",
    "SceneScore",
    "match_frames",
    "overall",
    "read_frame",
    "read_labels",
    "score_frame",
    "score_scene",
]

PROTOCOL = "lerf-ovs 2D"


@dataclass(frozen=True)
class PairScore:
    """One label in one frame.

    Attributes:
        frame, label: which.
        iou: of the mask at the level the mask was taken from, 0..1.
        hit: whether a pixel of maximal averaged relevancy lies in a box of the label.
        level: position of the level of the mask.
        localization_level: position of the level of the point.
        score: the largest smoothed relevancy.
        pixel: (x, y) of the point.
    """

    frame: str
    label: str
    iou: float
    hit: bool
    level: int
    localization_level: int
    score: float
    pixel: tuple[int, int]


@dataclass(frozen=True)
class SceneScore:
    """All pairs of a scene, with ``miou`` and ``accuracy`` as plain means over them, 0..1.

    Attributes:
        scene: its name.
        preset: name of the query preset.
        pairs: one for each unique label of each frame.
    """

    scene: str
    preset: str
    pairs: tuple[PairScore, ...]
    protocol: str = PROTOCOL

    @property
    def miou(self) -> float:
        return sum(pair.iou for pair in self.pairs) / len(self.pairs)

    @property
    def accuracy(self) -> float:
        """Share of pairs with a hit; a label counts once a frame, however many boxes it has."""
        return sum(pair.hit for pair in self.pairs) / len(self.pairs)


def score_frame(
    frame: LabelledFrame,
    relevancy: Mapping[str, Tensor] | Tensor,  # each [S, H, W], or [S, Q, H, W]
    preset: QueryPreset = PRESETS["scoup"],
) -> list[PairScore]:
    """Score each label of a frame.

    Args:
        frame: the truth; resized to the size of the relevancy maps (masks nearest) if they differ.
        relevancy: per label of the frame [S, H, W] in 0..1 (a mapping may make them as it is asked), or all
            stacked in the order of ``frame.labels``, [S, Q, H, W].
        preset: how maps become masks and points. The protocol's default is "scoup", which chooses the level as the
            paper does; everyday queries (``segment``) choose it otherwise.

    Raises:
        InputError: a label has no relevancy map.
    """
    if isinstance(relevancy, Tensor) and (relevancy.dim() != 4 or relevancy.shape[1] != len(frame.labels)):
        raise InputError(
            f"frame {frame.name!r} has {len(frame.labels)} labels, its relevancy is {list(relevancy.shape)}; "
            "expected [S, labels, H, W]"
        )
    pairs = []
    for position, label in enumerate(frame.labels):
        if isinstance(relevancy, Tensor):
            maps = relevancy[:, position]
        elif label in relevancy:
            maps = relevancy[label]
        else:
            raise InputError(f"frame {frame.name!r}: there is no relevancy map for the label {label!r}")
        pairs.append(_score_pair(frame, label, maps, preset))
    return pairs


def _score_pair(frame: LabelledFrame, label: str, maps: Tensor, preset: QueryPreset) -> PairScore:
    segmentation = segment(maps, preset)
    localization = localize(maps, preset)
    truth = frame.only(label).resized(maps.shape[2], maps.shape[1])
    return PairScore(
        frame=frame.name,
        label=label,
        iou=iou(segmentation.mask.cpu(), truth.masks[label]),
        hit=any_inside(localization.pixels.cpu(), truth.boxes[label]),
        level=segmentation.level,
        localization_level=localization.level,
        score=segmentation.score,
        pixel=localization.pixel,
    )


def score_scene(
    scene: str,
    frames: Iterable[tuple[LabelledFrame, Mapping[str, Tensor] | Tensor]],
    preset: QueryPreset = PRESETS["scoup"],
) -> SceneScore:
    """Score all frames of a scene, given with their relevancy as for ``score_frame`` (a generator is fine), by
    default with the paper's own rules, preset "scoup".

    Raises:
        InputError: there is not a single label.
    """
    pairs = [pair for frame, relevancy in frames for pair in score_frame(frame, relevancy, preset)]
    if not pairs:
        raise InputError(f"scene {scene!r}: there are no labels to score")
    return SceneScore(scene, preset.name, tuple(pairs))


def overall(scenes: Iterable[SceneScore]) -> tuple[float, float]:
    """(mIoU, accuracy) over scenes: the plain mean of their scores, each scene counting alike.

    Raises:
        InputError: there are no scenes.
    """
    scenes = list(scenes)
    if not scenes:
        raise InputError("there are no scenes to average")
    count = len(scenes)
    return sum(scene.miou for scene in scenes) / count, sum(scene.accuracy for scene in scenes) / count
