"""From a list of scenes and a command line to what is run for each scene."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from scoup.base.counts import listed
from scoup.base.errors import InputError
from scoup.base.processes import device_of_process
from scoup.cli.manifest_options import ManifestOptions
from scoup.cli.option_groups import NO_ARGUMENT
from scoup.cli.parsing import in_one_line, option_name, parse_verb
from scoup.cli.scene_runs import SceneRun
from scoup.io.scene_list import Wanted, read_scene_list

if TYPE_CHECKING:
    from scoup.io.scene_list import ListedScene

OF_THE_RUN = ("manifest", "retries", "shard", "json", "quiet", "overwrite")
"""Options about the whole list: no scene has them."""
SHARING = ("extract", "build")
"""Verbs that may share a list: what is for one of them alone stands in a section of its name."""
_WITH_VALUE = ("manifest", "retries", "shard")
_NEVER_REFUSED = (Path, Path | None, str, str | None)


@dataclass(frozen=True)
class Call:
    """How a verb was called.

    Attributes:
        verb: its name, and the words before it.
        arguments: what follows.
    """

    verb: tuple[str, ...]
    arguments: tuple[str, ...]

    @property
    def for_scenes(self) -> tuple[str, ...]:
        """Those arguments that each scene is given too."""
        passed: list[str] = []
        rest = iter(self.arguments)
        for text in rest:
            name = option_name(text)
            if name not in OF_THE_RUN:
                passed.append(text)
            elif name in _WITH_VALUE and "=" not in text:
                next(rest, None)
        return tuple(passed)


def scene_runs(verb: ManifestOptions, manifest: Path, call: Call) -> list[SceneRun]:
    """What is to be run for each scene of a list.

    Args:
        verb: with the options of the command line.
        manifest: the list; relative paths of its scenes count from its folder.
        call: the same options as they were given.

    Raises:
        InputError: the list is wrong, a scene has an option that its verb refuses, or two scenes have one output.
            Names file, scene and option.
    """
    kind, name = type(verb), " ".join(call.verb)
    if any(getattr(verb, field.name) != NO_ARGUMENT for field in _required(kind)):
        names = listed([field.name.upper() for field in _required(kind)])
        raise InputError(f"--manifest and {names} do not go together: the list names the scenes")
    options = {_option(field): field for field in fields(kind) if _option(field) not in OF_THE_RUN}
    several = [option for option, field in options.items() if isinstance(field.default, tuple)]
    scenes = read_scene_list(manifest, Wanted(name, options.keys(), several, {*SHARING, name}))
    reader = _Reader(kind, manifest, call)
    runs = [reader.run_of(scene) for scene in scenes]
    outputs: dict[str, str] = {}
    for run in runs:
        place = os.path.realpath(run.output)
        if place in outputs:
            raise InputError(
                f"{manifest}: scenes {outputs[place]!r} and {run.name!r} have one output, {run.output}; give each its "
                "out"
            )
        outputs[place] = run.name
    return runs


class _Reader:
    """Makes runs of the scenes of a list.

    The parser takes tens of milliseconds. It is given the options that it may refuse, once for all scenes in which
    they are the same; names and paths differ in all of them, and are put in afterwards.
    """

    def __init__(self, kind: type[ManifestOptions], manifest: Path, call: Call) -> None:
        self._kind, self._manifest, self._call = kind, manifest, call
        self._folder = manifest.absolute().parent
        self._logs = self._folder / f"{manifest.name}.logs" / "-".join(call.verb)
        self._given = {option_name(text) for text in call.for_scenes}
        self._types = get_type_hints(kind)
        self._parsed: dict[tuple[str, ...], ManifestOptions] = {}

    def run_of(self, scene: ListedScene) -> SceneRun:
        """What is run for a scene."""
        where = f"{self._manifest}: scene {scene.name!r}"
        free: dict[str, Any] = {}
        refusable: list[str] = []
        arguments: list[str] = []
        for field, texts in self._arguments(scene.options, where):
            arguments += texts
            if self._types[field.name] in _NEVER_REFUSED:
                text = texts[-1].partition("=")[2] if field.default is not MISSING else texts[-1]
                free[field.name] = text if self._types[field.name] in (str, str | None) else Path(text)
            else:
                refusable += texts
        parsed: Any = replace(self._parse((*refusable, *self._call.for_scenes), where), **free)
        device = device_of_process(parsed.device)
        return SceneRun(
            name=scene.name,
            verb=self._call.verb,
            options=(*arguments, *self._call.for_scenes),
            device="" if device == parsed.device else device,
            folder=self._folder,
            output=parsed.output(self._folder),
            logs=self._logs,
        )

    def _arguments(
        self, options: Mapping[str, Any], where: str
    ) -> Iterator[tuple[Field[Any], tuple[str, ...]]]:
        """Options of a scene as they stand on the command line, but for those that are given there already."""
        for field in fields(self._kind):
            name = _option(field)
            value = options.get(name)
            if field.default is MISSING:
                if not isinstance(value, str):
                    raise InputError(f"{where}: has no {name}; name its file or folder")
                yield field, (str(self._folder / value),)
                continue
            if value is None or name in self._given:
                continue
            if isinstance(field.default, bool) != isinstance(value, bool):
                expected = "true or false" if isinstance(field.default, bool) else "a text or a number"
                raise InputError(f"{where}: {name} is {str(value)!r}, expected {expected}")
            if isinstance(value, bool):
                yield field, (f"--{name}",) * value
            else:
                values = value if isinstance(value, tuple) else (value,)
                yield field, tuple(f"--{name}={item}" for item in values)

    def _parse(self, arguments: tuple[str, ...], where: str) -> ManifestOptions:
        if arguments not in self._parsed:
            refusal = io.StringIO()
            program = f"scoup {' '.join(self._call.verb)}"
            places = [str(self._folder)] * len(_required(self._kind))
            try:
                with contextlib.redirect_stderr(refusal):
                    self._parsed[arguments] = parse_verb(self._kind, program, [*places, *arguments])
            except SystemExit as stop:
                raise InputError(f"{where}: {in_one_line(refusal.getvalue())}") from stop
        return self._parsed[arguments]


def _required(kind: type[ManifestOptions]) -> list[Field[Any]]:
    """The arguments of a verb that are no options."""
    return [field for field in fields(kind) if field.default is MISSING]


def _option(field: Field[Any]) -> str:
    return "json" if field.name == "as_json" else field.name.replace("_", "-")
