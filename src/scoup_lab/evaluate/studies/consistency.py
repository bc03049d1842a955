"""Multi-view consistency: how alike the features of one point are in two views, raw, after the autoencoder, and after
sparse coding (the last appendix figure of the method's paper).

Only what lies in 2D is compared: nothing is lifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from statistics import mean
from typing import Any, ClassVar

import numpy as np
import torch

from scoup.base import InputError, Progress, no_progress
from scoup.coding import fit_codes
from scoup.scene import Cameras, Regions
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import LANGSPLAT, AutoencoderSettings, fit_autoencoder
from scoup_lab.evaluate.metrics import Interval, bootstrap_interval
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.studies.matches import Matches, Observation, matched_points
from scoup_lab.evaluate.studies.study import Study
from scoup_lab.evaluate.studies.study_scene import StudyScene
from scoup_lab.evaluate.tables import Table

RAW = "raw"  # the features that others are compared with
MOST_PAIRS = 40_000  # of matched observations, drawn at random beyond


@dataclass(frozen=True)
class ConsistencyResult:
    """Cosine between matched observations of the points of a scene, at one level."""

    scene: str
    level: str
    features: str
    cosines: tuple[float, ...]  # [P] mean over the pairs of each point
    pairs: int  # how many in all
    unmatched: float  # mean cosine when the second of each pair is that of another pair drawn at random
    unmatched_cosines: tuple[float, ...]  # [P] the same, as a mean over the pairs of each point
    source: str = ""  # by what the points were matched

    def gaps(self) -> np.ndarray:
        """Return [P] what matters: by how much each point's observations are more alike than those of
        different points."""
        return np.subtract(self.cosines, self.unmatched_cosines)

    def interval(self) -> Interval:
        """Return the mean cosine over points."""
        return bootstrap_interval(self.cosines, [str(number) for number in range(len(self.cosines))])


def consistency(
    scene: str,
    matches: Matches,
    cameras: Cameras,
    regions: Regions,
    settings: BuildSettings,
    autoencoder: AutoencoderSettings = LANGSPLAT,
    seed: int = 0,
) -> list[ConsistencyResult]:
    """Compare raw, autoencoder-decoded and sparse-decoded features of matched observations, at each level.

    Observations without a region are left out. All three features are of the same pairs.
    """
    first, second, point_of_pair = _pairs(matches, seed)
    if not len(first):
        raise InputError(f"{scene}: no point is seen in two views; consistency needs views that overlap")
    embeddings = {level: regions.embeddings(level) for level in regions.levels}
    network = fit_autoencoder(torch.cat([rows for rows, _ in embeddings.values()]), autoencoder, seed)
    results = []
    for level, (rows, of_views) in embeddings.items():
        one, other = np.split(_labels_of(first + second, cameras, regions, level, of_views), 2)
        both = (one >= 0) & (other >= 0)
        if not both.any():
            continue
        book = fit_codes(rows, **replace(settings, seed=seed).of_fit)
        unit = torch.nn.functional.normalize(rows, dim=1)
        sparse = torch.nn.functional.normalize(book.codes.to_dense() @ book.atoms, dim=1)
        features = {RAW: unit, "autoencoder": network.decode(network.encode(rows)), "sparse codes": sparse}
        for name, values in features.items():
            a, b = values[torch.from_numpy(one[both])], values[torch.from_numpy(other[both])]
            cosines = (a * b).sum(1).double().numpy()
            shuffled = torch.from_numpy(np.random.default_rng(seed).permutation(len(b)))
            unmatched = (a * b[shuffled]).sum(1).double().numpy()
            means, others = (_means_by_point(values, point_of_pair[both]) for values in (cosines, unmatched))
            pairs, mean_unmatched = int(both.sum()), float(unmatched.mean())
            results.append(
                ConsistencyResult(scene, level, name, means, pairs, mean_unmatched, others, matches.source)
            )
    return results


def _means_by_point(values: np.ndarray, points: np.ndarray) -> tuple[float, ...]:
    members = np.unique(points, return_inverse=True)[1]
    return tuple((np.bincount(members, values) / np.bincount(members)).tolist())


@dataclass(frozen=True)
class Consistency(Study[ConsistencyResult]):
    """``consistency`` of several scenes. Features that are all alike have a high cosine between matched observations
    too, and say nothing: what counts is the difference from unmatched ones."""

    settings: BuildSettings  # of the sparse codes
    autoencoder: AutoencoderSettings = LANGSPLAT
    seed: int = 0

    stem: ClassVar[str] = "consistency"

    def results(
        self, scenes: Sequence[StudyScene], progress: Progress = no_progress
    ) -> list[ConsistencyResult]:
        results = []
        for done, scene in enumerate(scenes):
            progress("consistency", done, len(scenes))
            cameras, regions = scene.rasterised.cameras, scene.rasterised.regions
            of_scene = (scene.name, matched_points(scene), cameras, regions)
            results += consistency(*of_scene, self.settings, self.autoencoder, self.seed)
        progress("consistency", len(scenes), len(scenes))
        return results

    def report(
        self, results: Sequence[ConsistencyResult], protocol: str, described: dict[str, Any]
    ) -> Report:
        """See ``Study``; what lies in 2D is compared, whatever the protocol."""
        record = {**described, **consistency_record(results)}
        return Report(self.stem, "Multi-view consistency", [consistency_table(results)], record)


def _pairs(matches: Matches, seed: int) -> tuple[list[Observation], list[Observation], np.ndarray]:
    """Return pairs of observations of one point, and its number."""
    pairs = [(a, b, number) for number, point in enumerate(matches.points) for a, b in combinations(point, 2)]
    if len(pairs) > MOST_PAIRS:
        drawn = np.sort(np.random.default_rng(seed).choice(len(pairs), MOST_PAIRS, replace=False))
        pairs = [pairs[index] for index in drawn]
    first, second = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return first, second, np.array([pair[2] for pair in pairs], np.int64)


def _labels_of(
    observations: Sequence[Observation],
    cameras: Cameras,
    regions: Regions,
    level: str,
    of_views: dict[str, slice],
) -> np.ndarray:
    """Return the row of the stacked embeddings of each observation; -1 where there is no region."""
    maps = {}
    for view in {view for view, _ in observations} & of_views.keys():
        camera = cameras[view]
        labels = regions.load(view, level).resized(camera.width, camera.height).labels.flatten()
        maps[view] = torch.where(labels >= 0, labels + of_views[view].start, -1).tolist()
    return np.array([maps[view][pixel] if view in maps else -1 for view, pixel in observations], np.int64)


def consistency_table(results: Sequence[ConsistencyResult]) -> Table:
    """Return mean cosines by scene, level and feature, with intervals over points; then means over all scenes and
    levels, each counting alike."""
    rows = []
    means: dict[str, list[tuple[float, float]]] = {}
    gains = {row[:3]: row[3] for row in gap_differences(results)}
    for result in results:
        gain = gains.get((result.scene, result.level, result.features))
        interval = result.interval()
        cells = (
            f"{interval.mean:.3f}",
            f"{interval.low:.3f} to {interval.high:.3f}",
            f"{result.unmatched:.3f}",
            f"{interval.mean - result.unmatched:.3f}",
            "-" if gain is None else f"{gain.mean:+.3f} [{gain.low:+.3f}, {gain.high:+.3f}]",
        )
        rows.append((result.features, result.scene, result.level, str(len(result.cosines)), *cells))
        means.setdefault(result.features, []).append((interval.mean, result.unmatched))
    for features, pairs in means.items():
        cosine, unmatched = (mean(values) for values in zip(*pairs, strict=True))
        cells = (f"{cosine:.3f}", "-", f"{unmatched:.3f}", f"{cosine - unmatched:.3f}", "-")
        rows.append((features, "all", "all", "-", *cells))
    notes = tuple(f"{scene}: matched by {source}." for scene, source in sources_of(results).items())
    return Table(
        "Multi-view consistency: cosine between matched observations",
        (
            "features",
            "scene",
            "level",
            "points",
            "cosine",
            "95 % interval over points",
            "unmatched",
            "difference",
            "minus raw",
        ),
        tuple(rows),
        (
            *notes,
            "Minus raw: the difference less that of the raw embeddings, paired over points.",
            "Unmatched: observations of different points, drawn at random. Features that are all alike are "
            "consistent too.",
            "Codes and network are learned from all regions of the scene, as for a build.",
        ),
    )


def gap_differences(results: Sequence[ConsistencyResult]) -> list[tuple[str, str, str, Interval]]:
    """Return how much compression widens or narrows the gap between matched and unmatched observations.

    Returns scene, level, features, and the mean over points of their gap less that of the raw embeddings,
    with an interval over points: paired, since all features are of the same pairs.
    """
    raw = {(item.scene, item.level): item.gaps() for item in results if item.features == RAW}
    rows = []
    for item in results:
        if item.features != RAW:
            differences = (item.gaps() - raw[item.scene, item.level]).tolist()
            numbers = [str(number) for number in range(len(differences))]
            rows.append((item.scene, item.level, item.features, bootstrap_interval(differences, numbers)))
    return rows


def sources_of(results: Sequence[ConsistencyResult]) -> dict[str, str]:
    """Return by what the points of each scene were matched."""
    return {result.scene: result.source for result in results}


def consistency_record(results: Sequence[ConsistencyResult]) -> dict[str, Any]:
    """Return the record, for JSON."""
    rows = [
        {
            "scene": result.scene,
            "level": result.level,
            "features": result.features,
            "points": len(result.cosines),
            "pairs": result.pairs,
            "cosine": float(np.mean(result.cosines)),
            "unmatched": result.unmatched,
        }
        for result in results
    ]
    return {"matched_by": sources_of(results), "results": rows}
