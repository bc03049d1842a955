"""Which way of coding and voting answers best, on clean and on faulty regions: the table behind our defaults.

    python -m benchmarks.voting [--scenes kitchen table-0 shelves-0 ...] [--cases clean wrong20 noise60 ...]
        [--ways dense paper exact ... default] [--seeds 0 1 2 3 4] [--rows ROWS.json]
        [--out docs/benchmarks/voting.json]

Scenes are rasterised once, faults are put into their region sums (``scoup.synthetic.faults``), and every way
codes, votes and answers on the same sums, views and words. Masks and embeddings are simulated everywhere, geometry
and text vectors of kitchen (--data, as in benchmarks/kitchen.py) are real: figures compare ways with each other and
cannot be set against published ones. Faults are drawn once a case; seeds are those of the codebook.

OUT gets the means, intervals, seeds and commits that the table is made of. The scores of single pairs are kept with
--rows only, after every way of every scene and case. What is there is not run again: an interrupted run goes on, other
ways or scenes add to it, and a run with nothing left to do prints the table. It does not notice that the code has
changed: each entry names its commit; delete the file to start over.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import tyro

from benchmarks.data import data_folder
from benchmarks.voting_results import Entry, Results, summary, table
from benchmarks.voting_scenes import SceneSize, VotingScene, make_scene
from benchmarks.voting_scores import score
from benchmarks.voting_ways import WAYS, find_way
from scoup.baselines.method import Method, MethodSettings
from scoup.baselines.rasterised_scene import UpliftInputs
from scoup.io import write_text
from scoup.uplift.build_settings import BuildSettings

SCENES = ("kitchen", "table-0", "shelves-0", "hall-0", "yard-0")
CASES = ("clean", "wrong20", "noise60", "wrong20+noise60", "missing40", "rare")


@dataclass(frozen=True)
class Arguments:
    scenes: tuple[str, ...] = SCENES
    """kitchen, or a layout of benchmarks.scenes and its seed."""
    cases: tuple[str, ...] = CASES
    """Faults joined by "+", see scoup.synthetic.faults."""
    ways: tuple[str, ...] = tuple(WAYS)
    """Names from benchmarks.voting_ways."""
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    """Seeds of the codebook; scores are means over them."""
    epochs: int = 4000
    """Epochs of the adam solver."""
    draw: int = 0
    """Seed of the faults."""
    rows: Path | None = None
    """File in which the scores of single pairs are kept, and taken up again."""
    out: Path | None = None
    """Where the summary is written; replaced."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""
    size: SceneSize = field(default_factory=SceneSize)


def main(arguments: Arguments) -> Results:
    """Run what is missing, print the table and write the summary."""
    settings = {"draw": arguments.draw, "epochs": arguments.epochs, "size": asdict(arguments.size)}
    results = Results.open(arguments.rows, settings)
    ways = {name: find_way(name) for name in arguments.ways}
    methods = list(dict.fromkeys(way.method for way in ways.values()))
    for name in arguments.scenes:
        left = {
            case: [m for m in methods if not results.has(name, case, m.name, _seeds(m, arguments.seeds))]
            for case in arguments.cases
        }
        if not any(left.values()):
            continue
        started = time.perf_counter()
        scene = make_scene(name, arguments.data, arguments.size)
        regions = [len(level.embeddings) for level in scene.levels]
        print(
            f"{name}: {len(scene.gaussians)} Gaussians, {regions} regions, {len(scene.pairs)} pairs, "
            f"{time.perf_counter() - started:.1f} s",
            flush=True,
        )
        for case, missing in left.items():
            if not missing:
                continue
            inputs = scene.inputs(case, arguments.draw)
            for method, entry in run_case(scene, inputs, missing, arguments.seeds, arguments.epochs):
                results.put(name, case, method.name, scene.pairs, entry)
                print(
                    f"{name:10} {case:16} {method.name:27} peak {_mean(entry.peak):.3f} mask {_mean(entry.mask):.3f} "
                    f"best {_mean(entry.best):.3f} hit {_mean(entry.hit):.3f}  {entry.seconds:.1f} s",
                    flush=True,
                )
    found = summary(results, arguments.scenes, arguments.cases, ways)
    print(table(found))
    if arguments.out is not None:
        write_text(arguments.out, json.dumps(found, separators=(",", ":")) + "\n", overwrite=True)
    return results


def run_case(
    scene: VotingScene,
    inputs: UpliftInputs,
    methods: Sequence[Method],
    seeds: Sequence[int],
    epochs: int,
) -> Iterator[tuple[Method, Entry]]:
    """Every method on one scene with its faults; methods that differ in the vote only share their codes."""
    for method in methods:
        started = time.perf_counter()
        scores, size = [], 0.0
        for seed in _seeds(method, seeds):
            fitted = method.uplift(inputs, MethodSettings(seed, BuildSettings(epochs=epochs)))
            scores.append(score(scene, fitted))
            size = fitted.bytes_per_gaussian
        yield method, Entry.of(scores, _seeds(method, seeds), size, time.perf_counter() - started)


def _seeds(method: Method, seeds: Sequence[int]) -> list[int]:
    """Methods that know no seed are run once."""
    return list(seeds) if method.random else [0]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
