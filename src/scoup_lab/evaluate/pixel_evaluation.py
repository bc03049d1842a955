"""Evaluation of labelled frames: maps are rendered from the field and scored, and the worst answers drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base import Progress, no_progress
from scoup.io import load_regions, save_png
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.evaluate.evaluation import Evaluation, Say, say_nothing
from scoup_lab.evaluate.failures import failure_sheet
from scoup_lab.evaluate.label_vectors import encode_labels
from scoup_lab.evaluate.pixel_report import PixelScores
from scoup_lab.evaluate.protocols import selection
from scoup_lab.evaluate.protocols.pixels import LabelledScene, PixelProtocol
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.scores import PairScore, SceneScore
from scoup_lab.evaluate.studies.study_scene import ScoringRule, StudyScene


@dataclass(frozen=True)
class PixelResult:
    """Scores of one scene."""

    score: SceneScore  # by the 2D protocol
    selected: SceneScore | None  # by the 3D-selection protocol; None if it was not wanted
    levels: tuple[str, ...]  # names of the field's levels


@dataclass(frozen=True, kw_only=True)
class PixelEvaluation(Evaluation[LabelledScene, PixelResult]):
    """The evaluation of a data set of labelled frames."""

    protocol: PixelProtocol
    rules: str = "scoup"  # whose constants turn relevancy into masks and points
    selection: bool = False  # score by the 3D-selection protocol too

    @property
    def stems(self) -> Sequence[str]:
        self.protocol.rule(self.rules)  # rules that the data set has not are refused at once
        return (f"{self.protocol.name}_{self.rules}",)

    def scene(
        self,
        scene: LabelledScene,
        source: str,
        out: Path,
        progress: Progress = no_progress,
        say: Say = say_nothing,
    ) -> PixelResult:
        vectors = encode_labels(scene, source, self.device)
        path = out / "fields" / f"{scene.name}.scoup"
        field = self.field(scene, path, source, progress)
        rule = self.protocol.rule(self.rules)
        regions = load_regions(scene.features, scene.cameras)
        rasterised = RasterisedScene(field.gaussians, scene.cameras, regions, field.raster_preset)
        study, fitted = StudyScene(scene, vectors, rasterised), FittedField(field)
        score = study.scores(fitted, {"": ScoringRule(rule)}, progress)[""]
        selected = study.selection_score(fitted) if self.selection else None

        def map_of(pair: PairScore) -> Tensor:
            ((frame, camera),) = (both for both in scene.frames if both[0].name == pair.frame)
            return study.relevancy(fitted, frame, camera)[:, frame.labels.index(pair.label)]

        sheet = failure_sheet(score, scene, field, map_of, rule)
        save_png(sheet, out / "failures" / f"{scene.name}_{self.rules}.png", overwrite=True)
        return PixelResult(score, selected, field.levels)

    def reports(self, results: dict[str, PixelResult], described: dict[str, Any]) -> list[Report]:
        """See ``Evaluation``: one by each protocol."""
        of_scenes = list(results.values())
        shared = {**described, "build": self.build.to_dict()}
        published, levels = self.protocol.scenes, of_scenes[0].levels
        scores = tuple(result.score for result in of_scenes)
        stem = self.stems[0]
        of_frames = PixelScores(self.protocol.title, self.rules, scores, published, shared)
        reports = [of_frames.report(stem, levels)]
        selected = tuple(result.selected for result in of_scenes if result.selected is not None)
        if selected:
            note = "Another protocol than the 2D ones: never set the two side by side."
            rules = selected[0].rule
            of_gaussians = PixelScores(selection.PROTOCOL, rules, selected, published, shared, (note,))
            reports.append(of_gaussians.report(f"{self.protocol.name}_3d-selection", levels))
        return reports
