"""Several methods on the same scenes: accuracy, time, storage."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import mean
from typing import Any, ClassVar

import torch
from torch import Tensor

from scoup.base import VERSION, Progress, no_progress, write_text
from scoup_lab.baselines.method import DEFAULTS, Method, MethodSettings
from scoup_lab.bench.measure import Stopwatch
from scoup_lab.evaluate.evaluation import Say, say_nothing
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import (
    PairScore,
    SceneScore,
    accuracy_interval,
    miou_interval,
    overall,
    pair_names,
    paired_difference,
    rounded_ious,
)
from scoup_lab.evaluate.studies.study import Study
from scoup_lab.evaluate.studies.study_scene import ScoringRule, StudyScene
from scoup_lab.evaluate.tables import CAVEATS, Table


@dataclass(frozen=True)
class MethodResult:
    """A method on a scene."""

    method: str  # its title
    score: SceneScore  # by the 2D protocol
    selected: SceneScore | None  # by the 3D-selection protocol; None if it was not wanted
    rasterise_seconds: float  # of all views, which methods that count the same pixels share
    fit_seconds: float  # of everything after that
    query_seconds: float  # mean over labelled frames, all labels of a frame at once, projected before
    bytes_per_gaussian: float  # stored
    shared_bytes: float  # stored once

    @classmethod
    def read(cls, path: Path) -> MethodResult:
        """Read a result that was kept with ``json.dumps(asdict(result))``."""
        record = json.loads(path.read_text())
        for name in ("score", "selected"):
            if (score := record[name]) is not None:
                pairs = tuple(
                    PairScore(**{**pair, "pixel": pair["pixel"] and tuple(pair["pixel"])})
                    for pair in score["pairs"]
                )
                record[name] = SceneScore(**{**score, "pairs": pairs})
        return cls(**record)


@dataclass(frozen=True)
class Comparison(Study[MethodResult]):
    """Methods fitted to the same scenes; the first is set against the others."""

    methods: Sequence[Method]
    rule: MaskRule  # how maps become masks and points, for all of them
    folder: Path  # keeps results, which are found again by all that they depend on
    settings: MethodSettings = DEFAULTS
    selection: bool = False  # score by the 3D-selection protocol too
    say: Say = say_nothing  # called with a line for each result

    stem: ClassVar[str] = "baselines"

    def results(self, scenes: Sequence[StudyScene], progress: Progress = no_progress) -> list[MethodResult]:
        """See ``Study``: every method on every scene, rasterised once for each way of counting pixels."""
        results = []
        total = len(scenes) * len(self.methods)
        progress("compare", 0, total)
        for scene in scenes:
            inputs = _digests(scene)
            for method in self.methods:
                results.append(self._kept_or_new(scene, method, inputs, progress))
                progress("compare", len(results), total)
        return results

    def report(self, results: Sequence[MethodResult], protocol: str, described: dict[str, Any]) -> Report:
        scenes = f"{len({result.score.scene for result in results})} scenes"
        first = self.methods[0].title(self.settings)
        tables = [
            comparison_table(results, f"{protocol}, {scenes}: methods compared"),
            difference_table(results, first, f"{protocol}: {first} against the others"),
            selection_table(results, f"3D selection, {scenes}: methods compared"),
        ]
        record = {
            "protocol": protocol,
            **described,
            "pairs": pair_names([result.score for result in by_method(results)[first]]),
            "methods": comparison_record(results),
            "follows": {
                method.title(self.settings): [method.system, method.follows, method.departs]
                for method in self.methods
            },
        }
        return Report(
            self.stem, "Methods compared", [table for table in tables if table and table.rows], record
        )

    def _kept_or_new(
        self, scene: StudyScene, method: Method, inputs: list[str], progress: Progress
    ) -> MethodResult:
        path = self.folder / scene.name / self._file(method, inputs)
        cached = path.is_file()
        result = MethodResult.read(path) if cached else self._result(scene, method, progress)
        if not cached:
            write_text(path, json.dumps(asdict(result)))
        scored = f"mIoU {100 * result.score.miou:.1f} %, fit in {result.fit_seconds:.1f} s"
        self.say(f"{scene.name}, {result.method}: {scored}{', kept from before' if cached else ''}")
        return result

    def _file(self, method: Method, inputs: list[str]) -> str:
        """Return the name of a kept result, by all that it depends on."""
        matters = {"seed", "build", method.trained_by}
        settings = {name: value for name, value in asdict(self.settings).items() if name in matters}
        # The code of a method that somebody is writing changes without a version.
        code = inspect.getsource(sys.modules[method.uplift.__module__])
        described = [VERSION, settings, asdict(self.rule), self.selection, inputs, repr(method.pixels), code]
        key = hashlib.sha256(json.dumps(described).encode()).hexdigest()
        return f"{method.name}_{key[:16]}.json"

    def _result(self, scene: StudyScene, method: Method, progress: Progress) -> MethodResult:
        rasterised = scene.rasterised
        rasterised.inputs(method.pixels, progress)  # not part of the fit
        rasterised.forget_codes()  # each method pays for its own
        clock = Stopwatch()
        fitted = clock("fit", method.fit, rasterised, replace(self.settings, progress=progress))
        return MethodResult(
            method.title(self.settings),
            scene.scores(fitted, {"": ScoringRule(self.rule)}, progress, clock)[""],
            scene.selection_score(fitted) if self.selection else None,
            rasterised.seconds(method.pixels),
            clock.seconds["fit"][0],
            mean(clock.seconds["query"]),
            fitted.bytes_per_gaussian,
            fitted.shared_bytes,
        )


def _digests(scene: StudyScene) -> list[str]:
    """Return digests of the splat, the cameras, the regions, the labels and their vectors."""
    rasterised, regions = scene.rasterised, scene.rasterised.regions
    poses = [matrix for camera in rasterised.cameras for matrix in (camera.viewmat, camera.K)]
    masks = [mask for frame, _ in scene.labelled.frames for mask in frame.masks.values()]
    embeddings = [regions.embeddings(level)[0] for level in regions.levels]
    tensors = [scene.vectors.queries, scene.vectors.canonical, *poses, *embeddings, *masks]
    return [rasterised.gaussians.fingerprint(), rasterised.raster_preset, *map(_digest, tensors)]


def _digest(tensor: Tensor) -> str:
    """Return SHA-256 of the shape and the values of a tensor, as float32."""
    values = tensor.detach().cpu().to(torch.float32).contiguous()
    return hashlib.sha256(str(list(values.shape)).encode() + values.numpy().tobytes()).hexdigest()


def comparison_table(results: Sequence[MethodResult], title: str) -> Table:
    """Return one row a method: means over scenes, each counting alike."""
    localizes = all(result.score.localizes for result in results)
    headers = ["method", "mIoU", "95 % interval", *(["localisation"] if localizes else [])]
    headers += ["rasterise, s", "fit, s", "query a frame, ms", "bytes a Gaussian", "shared, kB"]
    rows = []
    for name, group in by_method(results).items():
        interval = miou_interval([result.score for result in group])
        cells = [name, *interval.percent()]
        if localizes:
            accuracy = accuracy_interval([result.score for result in group])
            cells.append("-" if accuracy is None else accuracy.percent()[0])
        cells += [
            f"{mean(result.rasterise_seconds for result in group):.2f}",
            f"{mean(result.fit_seconds for result in group):.2f}",
            f"{1e3 * mean(result.query_seconds for result in group):.0f}",
            f"{mean(result.bytes_per_gaussian for result in group):.0f}",
            f"{mean(result.shared_bytes for result in group) / 1e3:.0f}",
        ]
        rows.append(tuple(cells))
    notes = (
        *CAVEATS,
        "Methods are written here from the papers' descriptions, on the same regions, rasteriser and queries; see "
        "docs/evaluation.md for what each follows and where it departs. None of these is a figure of a "
        "system's own code.",
        "Rasterising is shared by methods that count the same pixels.",
    )
    return Table(title, tuple(headers), tuple(rows), notes)


def difference_table(results: Sequence[MethodResult], first: str, title: str) -> Table:
    """Return mIoU of one method minus each other's, paired over queries."""
    grouped = by_method(results)
    rows = []
    for name, group in grouped.items():
        if name != first and first in grouped:
            interval = paired_difference([r.score for r in grouped[first]], [r.score for r in group])
            rows.append((f"{first} - {name}", interval.signed()))
    return Table(title, ("difference of mIoU", "mean and 95 % interval"), tuple(rows))


def selection_table(results: Sequence[MethodResult], title: str) -> Table | None:
    """Return scores of the 3D-selection protocol; None if it was not wanted."""
    rows = []
    for name, group in by_method(results).items():
        selected = [result.selected for result in group if result.selected is not None]
        if selected:
            rows.append((name, *miou_interval(selected).percent()))
    if not rows:
        return None
    note = "Another protocol than the 2D ones: never set the two side by side."
    return Table(title, ("method", "mIoU", "95 % interval"), tuple(rows), (note,))


def by_method(results: Sequence[MethodResult]) -> dict[str, list[MethodResult]]:
    """Return results of each method, scenes in order."""
    grouped: dict[str, list[MethodResult]] = {}
    for result in results:
        grouped.setdefault(result.method, []).append(result)
    return grouped


def comparison_record(results: Sequence[MethodResult]) -> dict[str, Any]:
    """Return the record, for JSON."""
    record = {}
    for name, group in by_method(results).items():
        miou, accuracy = overall([result.score for result in group])
        interval = miou_interval([result.score for result in group])
        selected = [result.selected for result in group if result.selected is not None]
        record[name] = {
            "iou": rounded_ious(pair.iou for result in group for pair in result.score.pairs),
            "selection_iou": rounded_ious(pair.iou for score in selected for pair in score.pairs),
            "miou": miou,
            "miou_interval": interval.ends,
            "accuracy": accuracy,
            "selection_miou": overall(selected)[0] if selected else None,
            "scenes": {result.score.scene: result.score.miou for result in group},
            "rasterise_seconds": mean(result.rasterise_seconds for result in group),
            "fit_seconds": mean(result.fit_seconds for result in group),
            "query_seconds": mean(result.query_seconds for result in group),
            "bytes_per_gaussian": mean(result.bytes_per_gaussian for result in group),
            "shared_bytes": mean(result.shared_bytes for result in group),
        }
    return record
