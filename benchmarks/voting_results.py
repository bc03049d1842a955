"""Results of benchmarks/voting.py: the rows of single pairs, their summary, and the table made of it."""

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

VERSION = 2
ALL = "all cases"


@dataclass(frozen=True)
class Entry:
    """One method on one scene and case.

    Attributes:
        seeds: of the codebook.
        bytes_per_gaussian: what it keeps.
        seconds: it took, all seeds; codes that an earlier method had learned are not counted again.
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
    """Entries by scene, case and method, and the file they are kept in.

    Attributes:
        path: the file, if they are kept.
        content: as written there, with the environment of the last run that added to it.
    """

    def __init__(self, path: Path | None, content: dict[str, Any]) -> None:
        self.path = path
        self.content = content
        self._environment = describe_environment()

    @classmethod
    def open(cls, path: Path | None, settings: dict[str, Any]) -> Results:
        """Take up a file of the same settings, or start one; None keeps nothing.

        Raises:
            InputError: the file holds results of other settings.
        """
        if path is None or not path.exists():
            return cls(path, {"version": VERSION, "settings": settings, "scenes": {}})
        content = json.loads(path.read_text())
        if (content.get("version"), content.get("settings")) != (VERSION, settings):
            raise InputError(
                f"{path}: holds results of {content.get('settings')}, this run has {settings}; name another --rows"
            )
        return cls(path, content)

    def has(self, scene: str, case: str, method: str, seeds: list[int]) -> bool:
        """Whether this need not be run."""
        found = self._entries(scene, case).get(method)
        return found is not None and found["seeds"] == seeds

    def get(self, scene: str, case: str, method: str) -> Entry | None:
        """An entry, if it is there."""
        found = self._entries(scene, case).get(method)
        return None if found is None else Entry(**found)

    def pairs(self, scene: str) -> list[list[str]]:
        """[frame, label] in the order of the scores."""
        return self.content["scenes"][scene]["pairs"]

    def put(self, scene: str, case: str, method: str, pairs: Sequence[tuple[str, str]], entry: Entry) -> None:
        """Keep an entry and write the file."""
        of_scene = self.content["scenes"].setdefault(
            scene, {"pairs": [list(pair) for pair in pairs], "cases": {}}
        )
        entry = replace(entry, commit=str(self._environment["commit"]))
        of_scene["cases"].setdefault(case, {})[method] = asdict(entry)
        self.content["environment"] = self._environment
        if self.path is not None:
            write_text(self.path, json.dumps(self.content, separators=(",", ":")), overwrite=True)

    def _entries(self, scene: str, case: str) -> dict[str, Any]:
        return self.content["scenes"].get(scene, {}).get("cases", {}).get(case, {})


def summary(
    results: Results, scenes: Sequence[str], cases: Sequence[str], ways: Mapping[str, Way]
) -> dict[str, Any]:
    """Everything the table says, without the rows of single pairs: for each way and case the means over scenes, then
    paired comparisons. A case that was not run on all scenes is left out: its mean would be another figure.
    """
    found: dict[str, Any] = {
        "what": "benchmarks.voting: mIoU, localisation accuracy, and paired differences of mIoU with 95 % intervals",
        "environment": results.content.get("environment"),
        "settings": results.content["settings"],
        "pairs": {scene: len(results.pairs(scene)) for scene in scenes},
        "cases": list(cases),
        "commits": [],
        "ways": {},
        "differences": {},
    }
    commits: set[str] = set()
    for name, way in ways.items():
        of_cases = {}
        for case in cases:
            entries = [results.get(scene, case, way.method.name) for scene in scenes]
            known = [entry for entry in entries if entry is not None]
            commits |= {entry.commit for entry in known if entry.commit}
            if known and len(known) == len(entries):
                of_cases[case] = _means(known, way)
                found["ways"][name] = {
                    "bytes_per_gaussian": known[0].bytes_per_gaussian, "seeds": known[0].seeds, "cases": of_cases,
                }  # fmt: skip
    found["commits"] = sorted(commits)
    sets = {case: [case] for case in cases} | ({ALL: list(cases)} if len(cases) > 1 else {})
    for name, (first, second) in COMPARISONS.items():
        if first in ways and second in ways:
            intervals = {
                key: compare(results, scenes, each, ways[first], ways[second]) for key, each in sets.items()
            }
            known = {key: _rounded(interval) for key, interval in intervals.items() if interval is not None}
            found["differences"] |= {name: known} if known else {}
    return found


def _means(entries: Sequence[Entry], way: Way) -> dict[str, Any]:
    """Means over scenes; ``scenes``: the mIoU of each."""
    ious = [mean(getattr(entry, way.level_choice)) for entry in entries]
    accuracy = mean(mean(entry.hit) for entry in entries)
    return {
        "miou": round(mean(ious), 6), "accuracy": round(accuracy, 6), "scenes": [round(iou, 4) for iou in ious],
    }  # fmt: skip


def _rounded(interval: Interval) -> list[float]:
    return [round(value, 6) for value in (interval.mean, interval.low, interval.high)]


def table(found: dict[str, Any]) -> str:
    """Markdown of a ``summary``."""
    cases = found["cases"]
    lines = [
        "",
        f"mIoU / localisation accuracy, means over {', '.join(found['pairs'])}",
        "",
        f"| way | bytes a Gaussian | {' | '.join(cases)} |",
        "|---" * (len(cases) + 2) + "|",
    ]
    for name, way in found["ways"].items():
        known = [way["cases"].get(case) for case in cases]
        cells = ["-" if cell is None else f"{cell['miou']:.3f} / {cell['accuracy']:.3f}" for cell in known]
        lines.append(f"| {name} | {way['bytes_per_gaussian']:.0f} | {' | '.join(cells)} |")
    lines += ["", f"Code: {', '.join(found['commits'])}"] if found["commits"] else []
    if found["differences"]:
        headings = [*cases, *([ALL] if len(cases) > 1 else [])]
        lines += ["", "mIoU, first minus second, 95 % interval over queries, each scene counting alike", ""]
        lines += [f"| difference | {' | '.join(headings)} |", "|---" * (len(headings) + 1) + "|"]
        for name, known in found["differences"].items():
            cells = [
                "{:+.3f} [{:+.3f}, {:+.3f}]".format(*known[key]) if key in known else "-" for key in headings
            ]
            lines.append(f"| {name} | {' | '.join(cells)} |")
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
            pair = [results.get(scene, case, way.method.name) for way in (first, second)]
            if pair[0] is None or pair[1] is None:
                return None
            ious = getattr(pair[0], first.level_choice), getattr(pair[1], second.level_choice)
            of_cases.append([a - b for a, b in zip(*ious, strict=True)])
        differences += [mean(of_pair) for of_pair in zip(*of_cases, strict=True)]
        groups += [label for _, label in results.pairs(scene)]
        kinds += [scene] * len(results.pairs(scene))
    return bootstrap_interval(differences, groups, scenes=kinds)
