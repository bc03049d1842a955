"""Scores of (frame, label) pairs by any protocol, and their means by scene and over scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from scoup.base import InputError
from scoup_lab.evaluate.metrics import Interval, bootstrap_interval


@dataclass(frozen=True)
class PairScore:
    """One label in one frame."""

    frame: str
    label: str
    iou: float  # of the mask at the level the mask was taken from, 0..1
    # whether a pixel of maximal averaged relevancy lies in a box of the label; None in protocols without
    # localisation
    hit: bool | None
    level: int  # position of the level of the mask; -1 where none has a say
    score: float  # the largest smoothed relevancy
    pixel: tuple[int, int] | None  # (x, y) of the point; None in protocols without localisation


def pair_names(scores: Sequence[SceneScore]) -> list[list[str]]:
    """Return [scene, frame, label] of all pairs, in order; for JSON."""
    return [[scene.scene, pair.frame, pair.label] for scene in scores for pair in scene.pairs]


def rounded_ious(ious: Iterable[float]) -> list[float]:
    """Return IoU of all pairs for JSON: three decimals."""
    return [round(value, 3) for value in ious]


@dataclass(frozen=True)
class SceneScore:
    """All pairs of a scene, with ``miou`` and ``accuracy`` as plain means over them, 0..1."""

    scene: str  # its name
    rule: str  # name of the rule
    pairs: tuple[PairScore, ...]  # one for each unique label of each frame
    # whose rules were followed; scores of different protocols cannot be set side by side
    protocol: str = "lerf-ovs 2D"

    def __post_init__(self) -> None:
        if not self.pairs:
            raise InputError(f"scene {self.scene!r}: there are no labels to score")

    @property
    def miou(self) -> float:
        return sum(pair.iou for pair in self.pairs) / len(self.pairs)

    def by_label(self) -> dict[str, list[PairScore]]:
        """Return the pairs of each label."""
        found: dict[str, list[PairScore]] = {}
        for pair in self.pairs:
            found.setdefault(pair.label, []).append(pair)
        return found

    @property
    def localizes(self) -> bool:
        """Return whether the protocol scores points too."""
        return all(pair.hit is not None for pair in self.pairs)

    @property
    def accuracy(self) -> float:
        """Share of pairs with a hit; a label counts once a frame, however many boxes it has."""
        if not self.localizes:
            raise InputError(f"the protocol {self.protocol!r} has no localisation")
        return sum(bool(pair.hit) for pair in self.pairs) / len(self.pairs)


def overall(scenes: Iterable[SceneScore]) -> tuple[float, float | None]:
    """Return (mIoU, accuracy) over scenes: the plain mean of their scores, each scene counting alike.

    The accuracy is None in protocols without localisation.
    """
    scenes = list(scenes)
    if not scenes:
        raise InputError("there are no scenes to average")
    protocols = sorted({scene.protocol for scene in scenes})
    if len(protocols) > 1:
        raise InputError(f"scores of different protocols cannot be averaged: {', '.join(protocols)}")
    miou = sum(scene.miou for scene in scenes) / len(scenes)
    if not all(scene.localizes for scene in scenes):
        return miou, None
    return miou, sum(scene.accuracy for scene in scenes) / len(scenes)


def miou_interval(scenes: Sequence[SceneScore]) -> Interval:
    """Return the mean over scenes, each counting alike; queries are drawn scene by scene."""
    return pair_interval(scenes, (pair.iou for scene in scenes for pair in scene.pairs))


def accuracy_interval(scenes: Sequence[SceneScore]) -> Interval | None:
    """Return the same of the localisation accuracy; None in protocols without it."""
    if not all(scene.localizes for scene in scenes):
        return None
    return pair_interval(scenes, (float(bool(pair.hit)) for scene in scenes for pair in scene.pairs))


def paired_difference(first: Sequence[SceneScore], second: Sequence[SceneScore]) -> Interval:
    """Return mIoU of the first minus the second, over the same pairs of the same scenes in the same order."""
    both = ((one.pairs, other.pairs) for one, other in zip(first, second, strict=True))
    pairs = (pair for of_scene in both for pair in zip(*of_scene, strict=True))
    return pair_interval(first, (one.iou - other.iou for one, other in pairs))


def pair_interval(scenes: Sequence[SceneScore], values: Iterable[float]) -> Interval:
    """Return the mean of a value of each pair of scenes, in order; scenes count alike, and queries are drawn."""
    names = [(scene.scene, pair.label) for scene in scenes for pair in scene.pairs]
    return bootstrap_interval(list(values), [label for _, label in names], scenes=[name for name, _ in names])
