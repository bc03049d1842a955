"""Ablations: the rows of ``ablation_rows`` on scenes rasterised once, over several codebook seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any, ClassVar

from scoup.base import Progress, no_progress
from scoup.uplift import BuildSettings
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.evaluate.metrics import Interval
from scoup_lab.evaluate.published import ABLATIONS as PUBLISHED
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import PairScore, SceneScore, pair_interval, pair_names, rounded_ious
from scoup_lab.evaluate.studies.ablation_rows import Ablation
from scoup_lab.evaluate.studies.study import Study
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.evaluate.tables import CAVEATS, Table


@dataclass(frozen=True)
class AblationResult:
    """A row, over all scenes and seeds."""

    ablation: Ablation
    scores: dict[int, list[SceneScore]]  # by seed, of each scene

    @property
    def scenes(self) -> list[SceneScore]:
        """The scenes of the first seed."""
        return next(iter(self.scores.values()))

    def means(self, value: Callable[[PairScore], float] = lambda pair: pair.iou) -> list[float]:
        """Return a value of each pair, its IoU by default, as means over seeds."""
        runs = [
            [value(pair) for scene in of_seed for pair in scene.pairs] for of_seed in self.scores.values()
        ]
        return [mean(of_pair) for of_pair in zip(*runs, strict=True)]

    def interval(self) -> Interval:
        """Return mIoU, each scene counting alike."""
        return pair_interval(self.scenes, self.means())

    def accuracy(self) -> float | None:
        """Return the accuracy of localisation; None in protocols without it."""
        if not all(scene.localizes for scene in self.scenes):
            return None
        return pair_interval(self.scenes, self.means(lambda pair: bool(pair.hit))).mean

    def by_seed(self) -> list[float]:
        """Return mIoU of each seed."""
        return [mean(scene.miou for scene in of_seed) for of_seed in self.scores.values()]


@dataclass(frozen=True)
class Ablations(Study[AblationResult]):
    """Rows of the ablation table, over codebook seeds; methods that know no seed are run once."""

    rows: Sequence[Ablation]
    rule: MaskRule  # the protocol's
    seeds: Sequence[int] = (0, 1, 2)  # of the codebook
    epochs: int = 4000  # of Adam

    stem: ClassVar[str] = "ablations"

    def results(self, scenes: Sequence[StudyScene], progress: Progress = no_progress) -> list[AblationResult]:
        """See ``Study``; scenes are rasterised once, and once more for each pixel stride."""
        scores: dict[str, dict[int, list[SceneScore]]] = {row.name: {} for row in self.rows}
        methods = list(dict.fromkeys(row.method for row in self.rows))
        total, done = len(scenes) * len(self.seeds) * len(methods), 0
        progress("ablations", 0, total)
        for scene in scenes:
            for seed in self.seeds:
                settings = MethodSettings(seed, BuildSettings(epochs=self.epochs), progress=progress)
                for method in methods:
                    if method.random or seed == self.seeds[0]:
                        fitted = method.fit(scene.rasterised, settings)
                        rules = {row.name: row.rule(self.rule) for row in self.rows if row.method is method}
                        for name, score in scene.scores(fitted, rules, progress).items():
                            scores[name].setdefault(seed, []).append(score)
                    done += 1
                    progress("ablations", done, total)
                scene.rasterised.forget_codes()  # those of the next seed are others
        return [AblationResult(row, scores[row.name]) for row in self.rows]

    def report(self, results: Sequence[AblationResult], protocol: str, described: dict[str, Any]) -> Report:
        pairs = pair_names(results[0].scenes)
        record = {"protocol": protocol, **described, "pairs": pairs, "rows": ablation_record(results)}
        return Report(self.stem, "Ablations", [ablation_table(results, protocol)], record)


def ablation_table(results: Sequence[AblationResult], protocol: str) -> Table:
    """Return mIoU with intervals, range over seeds, and the paired difference from the base."""
    base = next(result for result in results if result.ablation.is_base)
    localizes = base.accuracy() is not None
    headers = ["change", "group", "mIoU", "95 % interval", "least to most over seeds"]
    headers += (["localisation"] if localizes else []) + [
        "minus base",
        "paper on LERF-OVS, published: mIoU / localisation",
    ]
    rows = []
    for result in results:
        seeds = result.by_seed()
        cells = [result.ablation.name, result.ablation.group, *result.interval().percent()]
        cells.append(f"{100 * min(seeds):.1f} to {100 * max(seeds):.1f}" if len(seeds) > 1 else "-")
        if localizes:
            cells.append(f"{100 * (result.accuracy() or 0):.1f}")
        cells.append("-" if result is base else difference(result, base).signed())
        published = PUBLISHED.get(result.ablation.published)
        cells.append(
            "-" if published is None else " / ".join("-" if v != v else f"{v:.1f}" for v in published)
        )
        rows.append(tuple(cells))
    notes = (
        *CAVEATS,
        "Means over codebook seeds; differences are paired over queries, after that mean.",
        "The last column is the paper's, on other data: it says which way a change went there, nothing about this run.",
    )
    return Table(f"{protocol}: ablations", tuple(headers), tuple(rows), notes)


def difference(result: AblationResult, base: AblationResult) -> Interval:
    """Return mIoU of a row minus that of the base, paired over queries."""
    both = zip(result.means(), base.means(), strict=True)
    return pair_interval(result.scenes, (one - other for one, other in both))


def ablation_record(results: Sequence[AblationResult]) -> dict[str, Any]:
    """Return the record, for JSON."""
    record = {}
    base = next(result for result in results if result.ablation.is_base)
    for result in results:
        interval, minus_base = result.interval(), difference(result, base)
        record[result.ablation.name] = {
            "group": result.ablation.group,
            "iou": rounded_ious(result.means()),
            "minus_base": [minus_base.mean, *minus_base.ends],
            "miou": interval.mean,
            "miou_interval": interval.ends,
            "miou_by_seed": result.by_seed(),
            "accuracy": result.accuracy(),
            "seeds": list(result.scores),
        }
    return record
