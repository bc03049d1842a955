"""Evaluation of a data set by its own protocol: fields, scores and failure sheets scene by scene, then reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base.progress import Progress, no_progress
from scoup.io import check_output, save_png
from scoup.uplift.build_settings import BuildSettings
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.evaluate.data_sets import DataSet, LabelledScene, data_set_preset
from scoup_lab.evaluate.failures import failure_sheet
from scoup_lab.evaluate.label_vectors import encode_labels
from scoup_lab.evaluate.predictions import PredictionCache, file_digest
from scoup_lab.evaluate.report import Report, write_report
from scoup_lab.evaluate.scores import PairScore, SceneScore
from scoup_lab.evaluate.scoring import build_field, predict, score_maps, score_selection


@dataclass(frozen=True)
class EvaluationSettings:
    """How a data set is evaluated.

    Attributes:
        data_set: its protocol.
        rules: whose constants turn relevancy into masks and points.
        build: of the fields.
        rebuild: build fields again that are there already.
        selection: score by the 3D-selection protocol too.
        sheets: draw the worst answers of each scene.
        device: where tensors live.
    """

    data_set: DataSet
    rules: str
    build: BuildSettings
    rebuild: bool = False
    selection: bool = False
    sheets: bool = True
    device: str = "cpu"

    @property
    def stem(self) -> str:
        """Of the names of the report's files."""
        return f"{self.data_set.name}_{self.rules}"

    def check_outputs(self, out: Path, overwrite: bool) -> None:
        """Refuse reports that are there already.

        Raises:
            UnknownNameError: there are no such rules for the data set.
            OutputExistsError: a report is there and ``overwrite`` is false.
        """
        data_set_preset(self.data_set, self.rules)
        for suffix in (".md", ".json", ".tex"):
            check_output(out / f"{self.stem}{suffix}", overwrite)


@dataclass(frozen=True)
class SceneEvaluation:
    """Scores of one scene.

    Attributes:
        score: by the 2D protocol.
        selected: by the 3D-selection protocol; None if it was not wanted.
        levels: names of the field's levels.
    """

    score: SceneScore
    selected: SceneScore | None
    levels: tuple[str, ...]


def evaluate_scene(
    scene: LabelledScene,
    text_source: str,
    out: Path,
    settings: EvaluationSettings,
    progress: Progress = no_progress,
    say: Callable[[str], None] = lambda _: None,
) -> SceneEvaluation:
    """Build what is missing, predict what is not in the cache, score, draw.

    Args:
        scene: with labels.
        text_source: table or model that turns labels into vectors.
        out: folder of the fields, the cache and the failure sheets.
        settings: see there.
        progress: called while building and predicting.
        say: is given a sentence where an interrupted build is continued.
    """
    vectors = encode_labels(scene, text_source, settings.device)
    path = out / "fields" / f"{scene.name}.scoup"
    rebuild, device = settings.rebuild, settings.device
    field = build_field(scene, path, settings.build, text_source, rebuild, device, progress, say)
    cache, digest = PredictionCache(out / "cache"), file_digest(path)
    preset = data_set_preset(settings.data_set, settings.rules)
    maps = predict(scene, vectors, field, digest, cache, progress=progress)
    score = score_maps(settings.data_set, scene.name, maps, preset, field.levels)
    selected = None
    if settings.selection:
        raster_preset = field.info.raster_preset
        selected = score_selection(scene, vectors, FittedField(field), field.gaussians, raster_preset)
    if settings.sheets:

        def map_of(pair: PairScore) -> Tensor:
            ((frame, found),) = predict(scene, vectors, field, digest, cache, [pair.frame])
            return found[:, frame.labels.index(pair.label)]

        sheet = failure_sheet(score, scene, field, map_of, preset)
        save_png(sheet, out / "failures" / f"{scene.name}_{settings.rules}.png", overwrite=True)
    return SceneEvaluation(score, selected, field.levels)


def write_reports(
    evaluations: Sequence[SceneEvaluation],
    out: Path,
    described: dict[str, Any],
    settings: EvaluationSettings,
    overwrite: bool = False,
) -> dict[str, dict[str, Any]]:
    """Write the report of each protocol to ``out``; their records by the stem of the file names.

    Args:
        evaluations: of the scenes.
        out: folder.
        described: what else goes into the records: the data set, the machine.
        settings: as of the scenes.
        overwrite: replace what is there.
    """
    shared = {**described, "build": asdict(settings.build)}
    published = settings.data_set.scenes
    scores = tuple(each.score for each in evaluations)
    reports = {settings.stem: Report(scores[0].protocol, settings.rules, scores, published, shared)}
    selected = tuple(each.selected for each in evaluations if each.selected is not None)
    if selected:
        note = "Another protocol than the 2D ones: never set the two side by side."
        reports[f"{settings.data_set.name}_3d-selection"] = Report(
            selected[0].protocol, selected[0].preset, selected, published, shared, (note,)
        )
    levels = evaluations[0].levels
    return {stem: write_report(report, out, stem, levels, overwrite) for stem, report in reports.items()}
