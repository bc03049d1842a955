"""Several methods on the same scenes: accuracy, time, memory, storage."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any

from scoup import raster
from scoup.base.progress import Progress, no_progress
from scoup.baselines.channels import ChannelField
from scoup.baselines.methods import DEFAULTS, Method, MethodSettings
from scoup.evaluate.metrics import Interval, bootstrap_interval
from scoup.evaluate.protocols.selection import VALA_3D
from scoup.evaluate.protocols.selection import score_scene as score_selection
from scoup.evaluate.scores import SceneScore, overall
from scoup.evaluate.scoring import map_size
from scoup.evaluate.studies.cost import Cost, Meter
from scoup.evaluate.studies.rasterised import PreparedScene, Rule
from scoup.evaluate.tables import CAVEATS, Table, accuracy_interval, miou_interval
from scoup.query.neighbours import Neighbourhood
from scoup.query.presets import QueryPreset
from scoup.query.select import select_by_relevancy


@dataclass(frozen=True)
class MethodResult:
    """A method on a scene.

    Attributes:
        method: its name.
        score: by the 2D protocol.
        selected: by the 3D-selection protocol; None if it was not asked for.
        gather_seconds: rasterising all views, which methods that count the same weights share.
        make: cost of everything after that.
        ask_seconds: mean over labelled frames, all labels of a frame at once, one view looked at before.
        bytes_per_gaussian, shared_bytes: kept.
    """

    method: str
    score: SceneScore
    selected: SceneScore | None
    gather_seconds: float
    make: Cost
    ask_seconds: float
    bytes_per_gaussian: float
    shared_bytes: float


def compare(
    scenes: Sequence[PreparedScene],
    methods: Sequence[Method],
    preset: QueryPreset,
    settings: MethodSettings = DEFAULTS,
    selection: bool = False,
    progress: Progress = no_progress,
) -> list[MethodResult]:
    """Run every method on every scene.

    Args:
        scenes: rasterised once for each way of gathering.
        methods: see ``scoup.baselines.methods``.
        preset: how maps become masks and points, for all of them.
        settings: for all of them.
        selection: score the 3D-selection protocol too.
        progress: told after each method and scene.
    """
    results = []
    total = len(scenes) * len(methods)
    progress("compare", 0, total)
    for scene in scenes:
        embeddings = scene.embeddings()
        for method in methods:
            sums = scene.gathered(method.gather)
            with Meter() as meter:
                made = method.make(sums, embeddings, settings)
            score = scene.scores(made, {"all": Rule(preset)})["all"]
            results.append(
                MethodResult(
                    method.name,
                    score,
                    _selected(scene, made) if selection else None,
                    scene.seconds[method.gather],
                    meter.cost,
                    _ask_seconds(scene, made),
                    made.bytes_per_gaussian,
                    made.shared_bytes,
                )
            )
            del made  # features may be large
            progress("compare", len(results), total)
    return results


def _ask_seconds(scene: PreparedScene, made: ChannelField) -> float:
    seconds = []
    for frame, camera in scene.scene.frames:
        view = raster.project(scene.gaussians, camera, scene.raster_preset)
        queries = scene.asked.of(frame.labels)
        size = map_size(scene.data_set, frame, camera)
        started = time.perf_counter()
        made.relevancy(view, queries, scene.asked.canonical, size)
        seconds.append(time.perf_counter() - started)
    return mean(seconds)


def _selected(scene: PreparedScene, made: ChannelField) -> SceneScore:
    coded = made.coded()
    around = Neighbourhood.of(scene.gaussians.means, coded.any(0), VALA_3D.neighbours or 0)
    chosen = {}
    for label, query in scene.asked.vectors.items():
        own = made.gaussian_relevancy(query[None], scene.asked.canonical)[:, 0]
        chosen[label] = select_by_relevancy(own, coded, around, VALA_3D.threshold).mask
    return score_selection(scene.name, scene.gaussians, scene.scene.frames, chosen, scene.raster_preset)


def comparison_table(results: Sequence[MethodResult], title: str) -> Table:
    """One row a method: means over scenes, each counting alike."""
    localizes = all(result.score.localizes for result in results)
    headers = ["method", "mIoU", "95 % interval", *(["localisation"] if localizes else [])]
    headers += [
        "rasterise, s",
        "make, s",
        "ask a frame, ms",
        "bytes a Gaussian",
        "shared, kB",
        "peak memory, MB",
    ]
    rows = []
    for name, own in by_method(results).items():
        interval = miou_interval([result.score for result in own])
        cells = [name, f"{100 * interval.mean:.1f}", f"{100 * interval.low:.1f} to {100 * interval.high:.1f}"]
        if localizes:
            found = accuracy_interval([result.score for result in own])
            cells.append("-" if found is None else f"{100 * found.mean:.1f}")
        peaks = [result.make.peak_bytes for result in own if result.make.peak_bytes is not None]
        cells += [
            f"{mean(result.gather_seconds for result in own):.2f}",
            f"{mean(result.make.seconds for result in own):.2f}",
            f"{1e3 * mean(result.ask_seconds for result in own):.0f}",
            f"{mean(result.bytes_per_gaussian for result in own):.0f}",
            f"{mean(result.shared_bytes for result in own) / 1e3:.0f}",
            f"{mean(peaks) / 1e6:.0f}" if peaks else "-",
        ]
        rows.append(tuple(cells))
    notes = (
        *CAVEATS,
        "Methods are written here from the papers' descriptions, on the same regions, rasteriser and queries; see "
        "docs/evaluation.md for what each follows and where it departs. None of these is a figure of a "
        "system's own code.",
        "Rasterising is shared by methods that count the same weights. Peak memory: beyond what the "
        "process held before the method was made.",
    )
    return Table(title, tuple(headers), tuple(rows), notes)


def difference_table(results: Sequence[MethodResult], first: str, title: str) -> Table:
    """mIoU of one method minus each other's, paired over queries."""
    grouped = by_method(results)
    rows = []
    for name, own in grouped.items():
        if name != first and first in grouped:
            interval = paired_difference([r.score for r in grouped[first]], [r.score for r in own])
            rows.append((f"{first} - {name}", signed(interval)))
    return Table(title, ("difference of mIoU", "mean and 95 % interval"), tuple(rows))


def selection_table(results: Sequence[MethodResult], title: str) -> Table | None:
    """Scores of the 3D-selection protocol; None if it was not asked for."""
    rows = []
    for name, own in by_method(results).items():
        selected = [result.selected for result in own if result.selected is not None]
        if selected:
            interval = miou_interval(selected)
            low, high = 100 * interval.low, 100 * interval.high
            rows.append((name, f"{100 * interval.mean:.1f}", f"{low:.1f} to {high:.1f}"))
    if not rows:
        return None
    note = "Another protocol than the 2D ones: never set the two side by side."
    return Table(title, ("method", "mIoU", "95 % interval"), tuple(rows), (note,))


def paired_difference(first: Sequence[SceneScore], second: Sequence[SceneScore]) -> Interval:
    """mIoU of the first minus the second, over the same pairs of the same scenes in the same order."""
    differences, groups, kinds = [], [], []
    for a, b in zip(first, second, strict=True):
        for one, other in zip(a.pairs, b.pairs, strict=True):
            differences.append(one.iou - other.iou)
            groups.append(one.label)
            kinds.append(a.scene)
    return bootstrap_interval(differences, groups, scenes=kinds)


def signed(interval: Interval) -> str:
    """In percent points, with signs."""
    return f"{100 * interval.mean:+.1f} [{100 * interval.low:+.1f}, {100 * interval.high:+.1f}]"


def by_method(results: Sequence[MethodResult]) -> dict[str, list[MethodResult]]:
    """Results of each method, scenes in order."""
    grouped: dict[str, list[MethodResult]] = {}
    for result in results:
        grouped.setdefault(result.method, []).append(result)
    return grouped


def comparison_record(results: Sequence[MethodResult]) -> dict[str, Any]:
    """For JSON."""
    record = {}
    for name, own in by_method(results).items():
        miou, accuracy = overall([result.score for result in own])
        interval = miou_interval([result.score for result in own])
        selected = [result.selected for result in own if result.selected is not None]
        record[name] = {
            "miou": miou,
            "miou_interval": [interval.low, interval.high],
            "accuracy": accuracy,
            "selection_miou": overall(selected)[0] if selected else None,
            "scenes": {result.score.scene: result.score.miou for result in own},
            "rasterise_seconds": mean(result.gather_seconds for result in own),
            "make_seconds": mean(result.make.seconds for result in own),
            "peak_bytes": [result.make.peak_bytes for result in own],
            "ask_seconds": mean(result.ask_seconds for result in own),
            "bytes_per_gaussian": mean(result.bytes_per_gaussian for result in own),
            "shared_bytes": mean(result.shared_bytes for result in own),
        }
    return record
