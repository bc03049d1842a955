"""Protocols whose unit is the pixel: masks, and points, from relevancy maps against labelled frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from torch import Tensor

from scoup.base import Entry, InputError, UnknownNameError, counted
from scoup.scene import LEVELS, Camera
from scoup_lab.data.labels import LabelledFrame, match_frames
from scoup_lab.evaluate.metrics import any_inside, iou
from scoup_lab.evaluate.relevancy_maps import localize, segment
from scoup_lab.evaluate.rules import MASK_RULES, LevelChoice, MaskRule
from scoup_lab.evaluate.scenes import USUAL, Places, SceneFiles, check_root, choose_scenes
from scoup_lab.evaluate.scores import PairScore


@dataclass(frozen=True)
class PixelProtocol(Entry):
    """A data set of labelled frames, and its rules."""

    title: str  # in tables
    scenes: tuple[str, ...]  # of the published data set
    labels: Callable[[Path, str], Path]  # where the labels of a scene lie below ROOT
    read: Callable[[Path, str], list[LabelledFrame]]  # the labelled frames of a scene below ROOT
    # system -> threshold that its paper tuned for the data set; by default those for LERF-OVS
    thresholds: Mapping[str, float] = field(
        default_factory=lambda: {system: rule.threshold for system, rule in MASK_RULES.items()}
    )
    level_choice: LevelChoice | None = None  # in place of the rule's
    levels: tuple[str, ...] | None = None  # levels that may answer; None for all
    localizes: bool = False  # whether points are scored too
    at_label_size: bool = False  # bring features to the size of the label; else labels to that of the render

    def rule(self, system: str = "scoup") -> MaskRule:
        """Return the constants of a system for this data set."""
        if system not in self.thresholds:
            raise UnknownNameError(f"system with a rule for {self.name}", system, self.thresholds)
        defaults = MASK_RULES[system]
        level_choice = self.level_choice or defaults.level_choice
        return replace(defaults, threshold=self.thresholds[system], level_choice=level_choice)

    def find(self, root: Path, wanted: Sequence[str] = ()) -> list[str]:
        """Return the scenes below ``root`` that have labels: those wanted, or all, the published ones first."""
        check_root(root, self.name)
        names = sorted(
            path.name for path in root.iterdir() if path.is_dir() and self.labels(root, path.name).is_dir()
        )
        expected = f"folder SCENE with {self.labels(root, 'SCENE').relative_to(root)}"
        return choose_scenes(root, names, wanted, self.scenes, expected)

    def open(self, root: Path, name: str, places: Places = USUAL) -> LabelledScene:
        """Read cameras and labels of a scene, and find its splat and features."""
        files = places.open(root / name, name)
        frames = self.read(root, name)
        if not frames:
            raise InputError(f"{self.labels(root, name)}: there are no labels to score")
        matched = match_frames(frames, files.cameras)
        return LabelledScene(**vars(files), protocol=self, frames=matched)

    def score_frame(
        self, frame: LabelledFrame, maps: Tensor, rule: MaskRule | None = None, levels: Sequence[str] = LEVELS
    ) -> list[PairScore]:
        """Score each label of a frame by its relevancy ``maps`` [S, Q, H, W] in 0..1, labels in the frame's order, at
        levels of these names; the truth is brought to the size of the maps by nearest neighbour."""
        rule = rule or self.rule()
        if maps.dim() != 4 or maps.shape[1] != len(frame.labels):
            raise InputError(
                f"frame {frame.name!r} has {counted(len(frame.labels), 'label')}, its relevancy is "
                f"{list(maps.shape)}; expected [S, labels, H, W]"
            )
        height, width = maps.shape[2:]
        if self.at_label_size and (height, width) != (frame.height, frame.width):
            raise InputError(
                f"frame {frame.name!r} is {frame.width} x {frame.height}, its relevancy {width} x {height}; features "
                "are resized to the label, never the label"
            )
        rows = list(range(len(maps)))
        if self.levels is not None:
            rows = self.rows(levels)
            if len(maps) != len(levels):
                raise InputError(f"relevancy of {len(maps)} levels, but {len(levels)} are named")
        truth, pairs = frame.resized(width, height), []
        for index, label in enumerate(frame.labels):
            of_label, hit, pixel = maps[rows, index], None, None
            answer = segment(of_label, rule)
            if self.localizes:
                point = localize(of_label, rule)
                hit, pixel = any_inside(point.pixels.cpu(), truth.boxes[label]), point.pixel
            score = iou(answer.mask.cpu(), truth.masks[label])
            pairs.append(PairScore(frame.name, label, score, hit, rows[answer.level], answer.score, pixel))
        return pairs

    def rows(self, levels: Sequence[str]) -> list[int]:
        """Return the positions of the levels that may answer."""
        if self.levels is None:
            return list(range(len(levels)))
        for level in self.levels:
            if level not in levels:
                wanted = ", ".join(self.levels)
                raise InputError(f"{self.title} queries the levels {wanted}; there is no {level!r}")
        return [list(levels).index(level) for level in self.levels]


@dataclass(frozen=True, eq=False)
class LabelledScene(SceneFiles):
    """A scene of a data set, ready to be built and scored."""

    protocol: PixelProtocol  # that scores it
    frames: list[tuple[LabelledFrame, Camera]]

    @property
    def labels(self) -> list[str]:
        """Return all labels of all frames, in alphabetic order."""
        return sorted({label for frame, _ in self.frames for label in frame.labels})

    @property
    def n_pairs(self) -> int:
        """(frame, label) pairs."""
        return sum(len(frame.labels) for frame, _ in self.frames)

    def map_size(self, frame: LabelledFrame, camera: Camera) -> tuple[int, int]:
        """Return (width, height) of the maps that a frame is scored at."""
        of_label = self.protocol.at_label_size
        return (frame.width, frame.height) if of_label else (camera.width, camera.height)
