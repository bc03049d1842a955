"""Results of benchmarks/voting.py: the file that keeps them, the table, and paired comparisons."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.voting_scores import Scores
from benchmarks.voting_ways import COMPARISONS, Way
from scoup.base.errors import InputError
from scoup.bench.environment import describe_environment
from scoup.evaluate.metrics import Interval, bootstrap_interval
from scoup.io import write_text

VERSION = 1


@dataclass(frozen=True)
class Entry:
    """One recipe on one scene and case.

    Attributes:
        seeds: of the codebook.
        bytes_per_gaussian: what it keeps.
        seconds: it took, all seeds; codes that an earlier recipe had learned are not counted again.
        peak_by_seed, mask_by_seed: mIoU.
        peak, mask, best, hit: per pair, means over seeds (see ``Scores``).
        commit: of the code that ran; a file may hold entries of several.
    """

    seeds: list[int]
    bytes_per_gaussian: float
    seconds: float
    peak_by_seed: list[float]
    mask_by_seed: list[float]
    peak: list[float]
    mask: list[float]
    best: list[float]
    hit: list[float]
    commit: str | None = None

    @classmethod
    def of(
        cls, scores: Sequence[Scores], seeds: list[int], bytes_per_gaussian: float, seconds: float
    ) -> Entry:
        """From the scores of each seed."""
        peak, mask, best, hit = (
            [round(mean(of_pair), 4) for of_pair in zip(*(getattr(s, name) for s in scores), strict=True)]
            for name in ("peak", "mask", "best", "hit")
        )
        return cls(
            seeds,
            bytes_per_gaussian,
            round(seconds, 1),
            [round(mean(each.peak), 4) for each in scores],
            [round(mean(each.mask), 4) for each in scores],
            peak,
            mask,
            best,
            hit,
        )


class Results:
    """Entries by scene, case and recipe, and the file they are in.

    Attributes:
        path: the file.
        content: as written there, with the environment of the last run that added to it.
    """

    def __init__(self, path: Path, content: dict[str, Any]) -> None:
        self.path = path
        self.content = content
        self._environment = describe_environment()

    @classmethod
    def open(cls, path: Path, settings: dict[str, Any]) -> Results:
        """Take up a file of the same settings, or start one.

        Raises:
            InputError: the file holds results of other settings.
        """
        if not path.exists():
            return cls(path, {"version": VERSION, "settings": settings, "scenes": {}})
        content = json.loads(path.read_text())
        if (content.get("version"), content.get("settings")) != (VERSION, settings):
            raise InputError(
                f"{path}: holds results of {content.get('settings')}, this run has {settings}; name another --out"
            )
        return cls(path, content)

    def has(self, scene: str, case: str, recipe: str, seeds: list[int]) -> bool:
        """Whether this need not be run."""
        found = self._entries(scene, case).get(recipe)
        return found is not None and found["seeds"] == seeds

    def get(self, scene: str, case: str, recipe: str) -> Entry | None:
        """An entry, if it is there."""
        found = self._entries(scene, case).get(recipe)
        return None if found is None else Entry(**found)

    def pairs(self, scene: str) -> list[list[str]]:
        """[frame, label] in the order of the scores."""
        return self.content["scenes"][scene]["pairs"]

    def put(self, scene: str, case: str, recipe: str, pairs: Sequence[tuple[str, str]], entry: Entry) -> None:
        """Keep an entry and write the file."""
        of_scene = self.content["scenes"].setdefault(
            scene, {"pairs": [list(pair) for pair in pairs], "cases": {}}
        )
        entry = replace(entry, commit=str(self._environment["commit"]))
        of_scene["cases"].setdefault(case, {})[recipe] = asdict(entry)
        self.content["environment"] = self._environment
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path, json.dumps(self.content, separators=(",", ":")), overwrite=True)

    def _entries(self, scene: str, case: str) -> dict[str, Any]:
        return self.content["scenes"].get(scene, {}).get("cases", {}).get(case, {})


def table(results: Results, scenes: Sequence[str], cases: Sequence[str], ways: Mapping[str, Way]) -> str:
    """Markdown: mIoU and accuracy of each way and case as means over scenes, then paired comparisons."""
    lines = [
        "",
        f"mIoU / localisation accuracy, means over {', '.join(scenes)}",
        "",
        f"| way | bytes a Gaussian | {' | '.join(cases)} |",
        "|---" * (len(cases) + 2) + "|",
    ]
    for name, way in ways.items():
        sizes = [entry.bytes_per_gaussian for entry in _of_way(results, scenes, cases, way)]
        if sizes:
            cells = [_cell(results, scenes, case, way) for case in cases]
            lines.append(f"| {name} | {sizes[0]:.0f} | {' | '.join(cells)} |")
    commits = {
        entry.commit
        for way in ways.values()
        for entry in _of_way(results, scenes, cases, way)
        if entry.commit
    }
    lines += ["", f"Code: {', '.join(sorted(commits))}"] if commits else []
    rows = []
    for name, (first, second) in COMPARISONS.items():
        if first in ways and second in ways:
            sets = [[case] for case in cases] + ([list(cases)] if len(cases) > 1 else [])
            cells = [compare(results, scenes, each, ways[first], ways[second]) for each in sets]
            if any(cells):
                rows.append(f"| {name} | {' | '.join('-' if c is None else _signed(c) for c in cells)} |")
    if rows:
        headings = [*cases, "all cases"] if len(cases) > 1 else list(cases)
        lines += ["", "mIoU, first minus second, 95 % interval over queries, each scene counting alike", ""]
        lines += [f"| difference | {' | '.join(headings)} |", "|---" * (len(headings) + 1) + "|", *rows]
    return "\n".join(lines)


def compare(
    results: Results, scenes: Sequence[str], cases: Sequence[str], first: Way, second: Way
) -> Interval | None:
    """First minus second, paired over queries: means over seeds, then over cases, then queries are drawn. None where
    a result is missing."""
    differences, groups, kinds = [], [], []
    for scene in scenes:
        of_cases = []
        for case in cases:
            pair = [results.get(scene, case, way.recipe.key) for way in (first, second)]
            if pair[0] is None or pair[1] is None:
                return None
            ious = getattr(pair[0], first.level_choice), getattr(pair[1], second.level_choice)
            of_cases.append([a - b for a, b in zip(*ious, strict=True)])
        differences += [mean(of_pair) for of_pair in zip(*of_cases, strict=True)]
        groups += [label for _, label in results.pairs(scene)]
        kinds += [scene] * len(results.pairs(scene))
    return bootstrap_interval(differences, groups, scenes=kinds)


def _of_way(results: Results, scenes: Sequence[str], cases: Sequence[str], way: Way) -> list[Entry]:
    found = [results.get(scene, case, way.recipe.key) for scene in scenes for case in cases]
    return [entry for entry in found if entry is not None]


def _cell(results: Results, scenes: Sequence[str], case: str, way: Way) -> str:
    entries = _of_way(results, scenes, [case], way)
    if len(entries) < len(scenes):
        return "-"  # a mean over fewer scenes would be another figure
    iou = mean(mean(getattr(entry, way.level_choice)) for entry in entries)
    return f"{iou:.3f} / {mean(mean(entry.hit) for entry in entries):.3f}"


def _signed(interval: Interval) -> str:
    return f"{interval.mean:+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"
