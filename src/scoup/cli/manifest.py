"""A verb on many scenes: those of a list, dealt out to processes, and one table at the end."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, asdict, dataclass, fields
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base.counts import counted, listed
from scoup.base.errors import InputError
from scoup.cli.console import Console
from scoup.cli.manifest_options import ManifestOptions
from scoup.cli.option_groups import NO_ARGUMENT

if TYPE_CHECKING:
    from rich.table import Table

    from scoup.base.processes import Processes
    from scoup.cli.scene_runs import SceneResult, SceneRun
    from scoup.io.scene_list import ListedScene, Value

OF_THE_RUN = ("manifest", "retries", "shard", "json", "quiet", "overwrite")
"""Options about the whole list: no scene has them."""
_WITH_VALUE = ("manifest", "retries", "shard")
_PATIENCE = timedelta(days=365)  # with processes whose scenes take longer
VERBS = ("extract", "build")
"""Verbs that may share a list, with sections of their names."""


@dataclass(frozen=True)
class Call:
    """How a verb was called.

    Attributes:
        verb: its name and the words before it.
        arguments: what follows.
    """

    verb: tuple[str, ...]
    arguments: tuple[str, ...]

    @property
    def for_scenes(self) -> list[str]:
        """Those arguments that each scene is given too."""
        from scoup.cli.parsing import option_name

        passed: list[str] = []
        rest = iter(self.arguments)
        for text in rest:
            name = option_name(text)
            if name not in OF_THE_RUN:
                passed.append(text)
            elif name in _WITH_VALUE and "=" not in text:
                next(rest, None)
        return passed


def run_one_or_many(console: Console, verb: Any, call: Call) -> int | None:
    """Run a verb on its scene, or on those of the list it is given; the exit code, None for 0."""
    if verb.manifest is None:
        verb.check_without_manifest()
        return verb.run(console)
    return run_many(console, verb, call)


def run_many(console: Console, verb: ManifestOptions, call: Call) -> int:
    """Run a verb on the scenes of a list, or on this process's share of them, and print what became of all.

    Returns:
        0, or 1 if a scene failed.

    Raises:
        InputError: list or options cannot be used; nothing was run.
        ProcessLostError: under torchrun, another process has ended before its scenes were done.
    """
    from scoup.base.processes import of_environment, process_group, shard

    retries = 1 if verb.retries is None else verb.retries
    if retries < 0:
        raise InputError(f"--retries must not be negative, got {retries}")
    share = None if verb.shard is None else shard(verb.shard)
    if share is not None and of_environment().world > 1:
        raise InputError("--shard and torchrun do not go together: torchrun deals the scenes out by itself")
    runs = scene_runs(verb, call)
    with process_group("cpu", _PATIENCE) as together:
        own = _run_share(console, runs, share or together, retries, verb.overwrite)
        together.wait_for_all()  # however long the scenes of others take
        results = {result.name: result for part in together.gather(own) for result in part}
        code = _report(console, runs, results, verb) if together.first else 0
        # torchrun ends all processes when one ends with an error.
        together.wait_for_all()
    return code


def scene_runs(verb: ManifestOptions, call: Call) -> list[SceneRun]:
    """What is to be run for each scene of the list.

    Raises:
        InputError: the list is wrong, or two scenes have one output. Names file, scene and option.
    """
    from scoup.io.scene_list import Wanted, read_scene_list

    assert verb.manifest is not None
    if any(getattr(verb, field.name) != NO_ARGUMENT for field in _required(type(verb))):
        names = listed([field.name.upper() for field in _required(type(verb))])
        raise InputError(f"--manifest and {names} do not go together: the list names the scenes")
    options = {_option(field): field for field in fields(verb) if _option(field) not in OF_THE_RUN}
    several = [name for name, field in options.items() if isinstance(field.default, tuple)]
    name = " ".join(call.verb)
    scenes = read_scene_list(verb.manifest, Wanted(name, options.keys(), several, {*VERBS, name}))
    runs = [_scene_run(verb, call, scene) for scene in scenes]
    outputs: dict[str, str] = {}
    for run in runs:
        place = os.path.realpath(run.output)
        if place in outputs:
            raise InputError(
                f"{verb.manifest}: scenes {outputs[place]!r} and {run.name!r} have one output, {run.output}; give "
                "each its out"
            )
        outputs[place] = run.name
    return runs


def _scene_run(verb: ManifestOptions, call: Call, scene: ListedScene) -> SceneRun:
    from scoup.base.processes import device_of_process
    from scoup.cli.parsing import in_one_line, option_name, parse_verb
    from scoup.cli.scene_runs import SceneRun

    assert verb.manifest is not None
    where = f"{verb.manifest}: scene {scene.name!r}"
    folder = verb.manifest.absolute().parent
    given = {option_name(text) for text in call.for_scenes}
    arguments = list(_arguments(type(verb), scene.options, given, folder, where)) + call.for_scenes
    refusal = io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            parsed = parse_verb(type(verb), f"scoup {' '.join(call.verb)}", arguments)
    except SystemExit as stop:
        raise InputError(f"{where}: {in_one_line(refusal.getvalue())}") from stop
    device = device_of_process(parsed.device)
    logs = folder / f"{verb.manifest.name}.logs" / "-".join(call.verb)
    return SceneRun(
        scene.name,
        call.verb,
        tuple(arguments),
        "" if device == parsed.device else device,
        folder,
        parsed.output(folder),
        logs,
    )


def _arguments(
    kind: type, options: Mapping[str, Value], given: set[str], folder: Path, where: str
) -> Iterator[str]:
    """Options of a scene as they stand on the command line, but for those that are given there already."""
    for field in _required(kind):
        place = options.get(_option(field))
        if not isinstance(place, str):
            raise InputError(f"{where}: has no {_option(field)}; name its file or folder")
        yield str(folder / place)
    for field in fields(kind):
        name = _option(field)
        value = options.get(name)
        if value is None or name in given or field.default is MISSING:
            continue
        if isinstance(field.default, bool) != isinstance(value, bool):
            expected = "true or false" if isinstance(field.default, bool) else "a text or a number"
            raise InputError(f"{where}: {name} is {str(value)!r}, expected {expected}")
        if isinstance(value, bool):
            yield from [f"--{name}"] if value else []
        else:
            yield from (f"--{name}={item}" for item in (value if isinstance(value, tuple) else (value,)))


def _required(kind: type) -> list[Field[Any]]:
    """The arguments of a verb that are no options."""
    return [field for field in fields(kind) if field.default is MISSING]


def _option(field: Field[Any]) -> str:
    return "json" if field.name == "as_json" else field.name.replace("_", "-")


def _run_share(
    console: Console, runs: Sequence[SceneRun], processes: Processes, retries: int, overwrite: bool
) -> list[SceneResult]:
    """Run this process's share of the scenes, and say how each ends."""
    from scoup.cli.scene_runs import run_scene

    share = processes.share(runs)
    results: list[SceneResult] = []
    console.kept = lambda: (
        f"{len(results)} of {counted(len(share), 'scene')} are done, run the same command again to continue"
    )
    of = f", process {processes.rank + 1} of {processes.world}" if processes.world > 1 else ""
    with console.progress() as progress:
        for run in share:
            progress("scenes", len(results), len(share))
            result = run_scene(run, retries, overwrite)
            results.append(result)
            console.say(f"{run.name} ({len(results)} of {len(share)}{of}): {_sentence(result)}")
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
