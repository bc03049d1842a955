"""A verb on many scenes: those of a list, dealt out to processes, and one table at the end."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from scoup.base.counts import counted, listed
from scoup.base.errors import InputError
from scoup.cli.console import Console
from scoup.cli.manifest_options import ManifestOptions

if TYPE_CHECKING:
    from rich.table import Table

    from scoup.base.processes import Processes
    from scoup.cli.scene_arguments import Call
    from scoup.cli.scene_runs import SceneResult, SceneRun


def run_one_or_many(
    console: Console, verb: Any, words: Sequence[str], arguments: Sequence[str]
) -> int | None:
    """Run a verb on its scene, or on those of the list it is given.

    Args:
        words: the verb's name, and those before it.
        arguments: what followed them on the command line.

    Returns:
        The exit code; None for 0.
    """
    if verb.manifest is None:
        verb.check_without_manifest()
        return verb.run(console)
    from scoup.cli.scene_arguments import Call

    return run_many(console, verb, Call(tuple(words), tuple(arguments)))


def run_many(console: Console, verb: ManifestOptions, call: Call) -> int:
    """Run a verb on the scenes of a list, or on this process's share of them, and print what became of all.

    Returns:
        0, or 1 if a scene failed.

    Raises:
        InputError: list or options cannot be used; nothing was run.
        ProcessLostError: under torchrun, another process has ended before its scenes were done.
    """
    from scoup.base.processes import of_environment, process_group, shard, signs_of_life
    from scoup.cli.scene_arguments import scene_runs

    assert verb.manifest is not None
    retries = 1 if verb.retries is None else verb.retries
    if retries < 0:
        raise InputError(f"--retries must not be negative, got {retries}")
    share = None if verb.shard is None else shard(verb.shard)
    if share is not None and of_environment().world > 1:
        raise InputError("--shard and torchrun do not go together: torchrun deals the scenes out by itself")
    runs = scene_runs(verb, verb.manifest, call)
    with process_group("cpu") as together:
        with signs_of_life(together) as wait_for_all:
            own = _run_share(console, runs, share or together, retries, verb.overwrite)
            wait_for_all()
        results = {result.name: result for part in together.gather(own) for result in part}
        code = _report(console, runs, results, verb) if together.first else 0
        together.gather(
            None
        )  # torchrun ends all processes when one ends with an error: nobody before the table
    return code


def _run_share(
    console: Console, runs: Sequence[SceneRun], processes: Processes, retries: int, overwrite: bool
) -> list[SceneResult]:
    """Run this process's share of the scenes, and say how each ends."""
    from scoup.cli.scene_runs import run_scene

    share = processes.share(runs)
    results: list[SceneResult] = []
    again = "run the same command again to continue"
    console.kept = lambda: f"{len(results)} of {len(share)} scenes are done, {again}"
    of = f", process {processes.rank + 1} of {processes.world}" if processes.world > 1 else ""
    with console.progress() as progress:
        for run in share:
            progress("scenes", len(results), len(share))
            result = run_scene(run, retries, overwrite)
            results.append(result)
            console.say(f"{run.name} ({len(results)} of {len(share)}{of}): {_sentence(result)}")
            sys.stdout.flush()  # the log of a job is to say how far it is
        progress("scenes", len(results), len(share))
    return results


def _sentence(result: SceneResult) -> str:
    how = f" after {counted(result.attempts, 'attempt')}" if result.attempts > 1 else ""
    seconds = f" in {result.seconds:.0f} s" if result.attempts else ""
    return f"{result.result}{how}{seconds}" + (f": {result.message}" if result.message else "")


def _report(
    console: Console, runs: Sequence[SceneRun], done: dict[str, SceneResult], verb: ManifestOptions
) -> int:
    """Print the table of all scenes, those of other shards by their records; the exit code."""
    from scoup.cli.scene_runs import read_result

    results = {run.name: done.get(run.name) or read_result(run) for run in runs}
    console.say(_table(results))
    failed = [name for name, result in done.items() if result.result == "failed"]
    rows = [
        asdict(result) if result else {"name": name, "result": "not run yet"}
        for name, result in results.items()
    ]
    record = {"manifest": verb.manifest, "logs": runs[0].logs, "scenes": rows}
    if not failed:
        console.result(record)
        return 0
    return console.fail(
        f"{len(failed)} of {counted(len(done), 'scene')} failed ({listed(failed)}); what they printed is in "
        f"{runs[0].logs}; the same command tries them again",
        1,
        record=record,
    )


def _table(results: dict[str, SceneResult | None]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table("scene", "result", "seconds", "attempts", "")
    for column in table.columns[2:4]:
        column.justify = "right"
    for name, result in results.items():
        if result is None:
            table.add_row(name, "not run yet")
            continue
        seconds, attempts = (f"{result.seconds:.1f}", str(result.attempts)) if result.attempts else ("", "")
        table.add_row(name, result.result, seconds, attempts, Text(result.message))
    return table
