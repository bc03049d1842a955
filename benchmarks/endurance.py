"""Verbs that are killed at random moments and run again: same bytes, little done twice, nothing left."""

from __future__ import annotations

import functools
import random
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.endurance_runs import Run, snapshot
from benchmarks.endurance_verbs import VERBS, Scene, Verb, make_scene
from benchmarks.study import Record, Study
from scoup_lab.bench import markdown

AGAIN = 0.4
"""Share of the kills after which the run that continues is killed, too."""
MOST_RUNS = 6
"""Of one trial, before the last."""
EARLY = 1.05
"""Kills from outside come within this much of the time of an undisturbed run."""


@dataclass(frozen=True, kw_only=True)
class Endurance(Study):
    """Kill verbs at random moments and run them again: same bytes, little done twice, nothing left.

    Each verb runs as a process of its own (`benchmarks/endurance_child.py`) on a small synthetic scene. Half of the
    kills come from outside, after a random part of the time that an undisturbed run takes; half come at a random point:
    before one of the changes of files, within a file of region sums, around a view. After some kills the run that
    continues is killed again. Then the same command runs to its end, and the folder is compared with that of an
    undisturbed run. "begun again" counts the views that a killed run had begun to rasterise or extract and had not
    kept.
    """

    kills: int = 100
    """Kills that hit, shared out among the verbs."""
    seed: int = 0
    """Of the moments of the kills."""
    views: int = 12
    """Of the scene."""
    width: int = 240
    """Of its photographs, in pixels."""
    outside: float = 0.5
    """Share of the kills that come from outside, after some time; the others come at a point of the work."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        with tempfile.TemporaryDirectory(prefix="scoup-endurance-") as folder:
            scene = make_scene(Path(folder) / "scene", self.views, self.width)
            for number, name in enumerate(VERBS):
                if name not in known:
                    share = len(range(number, self.kills, len(VERBS)))
                    yield (
                        name,
                        figures(endure(VERBS[name], scene, share, self.seed, self.outside), VERBS[name]),
                    )

    def record(self, rows: dict[str, Any]) -> Record:
        return {"verbs": rows}

    @staticmethod
    def table(record: Record) -> str:
        """Return one line per verb."""
        heads = ["verb", "kills", "same bytes", "consistent", "begun again, most", "orphans", "passed"]
        rows = []
        for name, of in record["verbs"].items():
            count = of["trials"]
            rows.append([name, str(of["kills"]), f"{of['same_bytes']} of {count}",
                         f"{of['consistent']} of {of['kills']}",
                         f"{of['most_begun_again']} (at most {of['may_begin_again']})", str(len(of["orphans"])),
                         f"{of['passed']} of {count}"])  # fmt: skip
        return markdown(heads, rows)


@dataclass(frozen=True)
class Plain:
    """An undisturbed run of a verb."""

    seconds: float  # that it takes
    notes: tuple[str, ...]  # of the points that it passes
    files: dict[str, bytes]  # what is in the folder afterwards
    before: dict[str, bytes]  # what was there


@dataclass(frozen=True)
class Kill:
    """A kill that hit."""

    begun_again: int  # views that were begun and not kept
    consistent: bool  # the verb's outputs were all of before or all new, or the lock says how to go on


@dataclass(frozen=True)
class Trial:
    """A verb that was killed once or several times, and then run to its end."""

    kills: tuple[Kill, ...]  # that hit
    code: int  # of the last run
    said: str  # by the last run, where it was refused
    ended_well: bool  # it did its work, or was refused because the work is done
    same_bytes: bool  # of every file that an undisturbed run makes
    orphans: tuple[str, ...]  # files that an undisturbed run does not leave
    most_begun: int  # views that the last run had begun, beyond those that were not kept

    @property
    def passed(self) -> bool:
        """Return whether everything is as it should be, but for the number of views done again, which a verb
        bounds."""
        consistent = all(kill.consistent for kill in self.kills)
        return self.ended_well and self.same_bytes and not self.orphans and not self.most_begun and consistent


def endure(verb: Verb, scene: Scene, kills: int, seed: int, outside: float = 0.5) -> list[Trial]:
    """Try a verb until so many kills have hit.

    ``outside``: see ``Endurance``.
    """
    dice = random.Random(f"{verb.name} {seed}")
    plain = run_undisturbed(verb, scene)
    trials: list[Trial] = []
    for _ in range(3 * kills):
        left = kills - sum(len(trial.kills) for trial in trials)
        if left <= 0:
            break
        trials.append(trial(verb, scene, plain, dice, left, outside))
    return trials


@functools.cache
def run_undisturbed(verb: Verb, scene: Scene) -> Plain:
    """Return a run that nobody kills."""
    verb.prepare(scene)
    before = snapshot(scene.work)
    found = verb.run(scene)
    if found.code != 0:
        raise SystemExit(f"{verb.name} ended with {found.code}: {found.said}")
    return Plain(found.seconds, found.notes, snapshot(scene.work), before)


def trial(verb: Verb, scene: Scene, plain: Plain, dice: random.Random, most: int, outside: float) -> Trial:
    """Return one trial; at most so many kills that hit."""
    verb.prepare(scene)
    kills: list[Kill] = []
    kept = verb.n_kept(scene)
    for _ in range(MOST_RUNS):
        found = run_and_kill(verb, scene, plain, dice, outside)
        if found.code != Run.KILLED:  # it came after the end
            break
        kills.append(judge_kill(verb, scene, plain, found, kept))
        kept = verb.n_kept(scene)
        if len(kills) == most or dice.random() >= AGAIN:
            break
    last = verb.run(scene)
    files = snapshot(scene.work)
    wanted = 0 if verb.is_finished(last) else verb.n_views(scene) - kept
    return Trial(
        tuple(kills),
        last.code,
        last.said,
        last.code == 0 or verb.is_finished(last),
        all(files.get(name) == content for name, content in plain.files.items()),
        tuple(sorted(set(files) - set(plain.files))),
        max(0, last.begun - wanted),
    )


def run_and_kill(verb: Verb, scene: Scene, plain: Plain, dice: random.Random, outside: float) -> Run:
    """Run a verb and kill it at a random moment, if it is not over before."""
    moment, point = dice.random(), dice.randint(1, len(plain.notes))
    if dice.random() < outside:
        return verb.run(scene, after=moment * EARLY * plain.seconds)
    return verb.run(scene, point=point)


def judge_kill(verb: Verb, scene: Scene, plain: Plain, found: Run, kept_before: int) -> Kill:
    """Return what a kill has left."""
    files = snapshot(scene.work)
    finished = verb.is_new(files, plain.files)
    kept = found.begun if finished else verb.n_kept(scene) - kept_before
    consistent = finished or verb.is_as_before(files, plain.before) or verb.says_how_to_go_on(files)
    return Kill(max(0, found.begun - kept), consistent)


def figures(trials: list[Trial], verb: Verb) -> dict[str, Any]:
    """Return the figures of a verb's trials, for JSON."""
    kills = [kill for trial in trials for kill in trial.kills]
    return {
        "trials": len(trials),
        "kills": len(kills),
        "same_bytes": sum(trial.same_bytes for trial in trials),
        "consistent": sum(kill.consistent for kill in kills),
        "most_begun_again": max((kill.begun_again for kill in kills), default=0),
        "may_begin_again": verb.may_begin_again,
        "orphans": sorted({name for trial in trials for name in trial.orphans}),
        "passed": sum(trial.passed for trial in trials),
        "failed": [f"{trial.code} {trial.said}" for trial in trials if not trial.passed],
    }
