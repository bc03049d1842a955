"""Lists of scenes, YAML or JSON: what a verb makes of each when it is given ``--manifest``."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from scoup.base.errors import FileFormatError, nearest_names
from scoup.io.reading import existing_file, read_json, read_text

if TYPE_CHECKING:
    import yaml

WHAT = "a list of scenes"
MOST_BYTES = 4_000_000
MOST_SCENES = 100_000
_DEEPEST = 8  # of what is nested; four are needed
_NAME = re.compile(r"\w[\w.-]{0,63}")  # names of scenes become names of files
_PARTS = ("defaults", "scenes")

Value: TypeAlias = str | int | float | bool | tuple[str, ...] | None
"""Of an option; None is as if it were not there."""


@dataclass(frozen=True)
class Wanted:
    """What a verb understands.

    Attributes:
        verb: its name on the command line, such as "build" or "eval lerf-ovs".
        options: names of its options without dashes before them, such as "n-atoms", and of its argument, "scene".
        lists: those of them that take several values.
        verbs: names of all verbs that are given lists of scenes; sections of these names are for them alone.
    """

    verb: str
    options: Collection[str]
    lists: Collection[str]
    verbs: Collection[str]


@dataclass(frozen=True)
class ListedScene:
    """One scene of a list.

    Attributes:
        name: no other scene of the list has it, in capitals or not; a plain file name.
        options: those of the verb for this scene, by name; the defaults of the list are among them.
    """

    name: str
    options: Mapping[str, Value]


def read_scene_list(path: str | Path, wanted: Wanted) -> list[ListedScene]:
    """The scenes of a list, in its order.

    The file is a mapping: ``scenes`` is a list of mappings, each with ``name`` and options of the verb by their names
    on the command line; ``defaults``, which may be missing, has options for all of them. What an option means is not
    checked.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is too large, not such a list, has aliases, or a scene has no name, that of another, or an
            option that the verb has not. The message names file, scene and option.
    """
    path = existing_file(path, WHAT)
    if path.stat().st_size > MOST_BYTES:
        raise FileFormatError(
            path, f"is larger than {MOST_BYTES // 1_000_000} MB", f"is it {WHAT}? Divide it, if so"
        )
    content = read_json(path, WHAT) if path.suffix.lower() == ".json" else _read_yaml(path)
    _check_mapping(path, content, "it")
    for key in content:
        if key not in _PARTS:
            raise FileFormatError(path, f"has {_shown(key)}, expected {' and '.join(_PARTS)} only")
    defaults = _options(path, "defaults", content.get("defaults") or {}, wanted)
    listed = content.get("scenes")
    if not isinstance(listed, list) or not listed:
        raise FileFormatError(path, "has no scenes", "list them under scenes:, each with its name")
    if len(listed) > MOST_SCENES:
        raise FileFormatError(
            path, f"lists {len(listed):,} scenes", f"divide it: {MOST_SCENES:,} are the most"
        )
    return list(_scenes(path, listed, defaults, wanted))


def _scenes(
    path: Path, listed: list[Any], defaults: Mapping[str, Value], wanted: Wanted
) -> Iterator[ListedScene]:
    seen: dict[str, str] = {}
    for number, entry in enumerate(listed, start=1):
        _check_mapping(path, entry, f"scene {number}")
        name = entry.get("name")
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            problem = "has no name" if name is None else f"has the name {_shown(name)}"
            remedy = (
                "names are texts of at most 64 letters, digits, _, - and ., in quotes if they are numbers"
            )
            raise FileFormatError(path, f"scene {number} {problem}", remedy)
        # Some file systems take capitals for small letters.
        if name.casefold() in seen:
            raise FileFormatError(
                path, f"two scenes are named {seen[name.casefold()]!r}", "rename one of them"
            )
        seen[name.casefold()] = name
        options = {key: value for key, value in entry.items() if key != "name"}
        yield ListedScene(name, {**defaults, **_options(path, f"scene {name!r}", options, wanted)})


def _options(path: Path, where: str, entry: Any, wanted: Wanted) -> dict[str, Value]:
    """Options of a mapping, and over them those of its section for the verb."""
    _check_mapping(path, entry, where)
    found: dict[str, Value] = {}
    for key, value in entry.items():
        if key in wanted.verbs:
            _check_mapping(path, value, f"{key} of {where}")
            continue
        name = key.replace("_", "-")
        if name not in wanted.options:
            near = ", ".join(nearest_names(name, wanted.options, 3))
            raise FileFormatError(
                path, f"{where}: scoup {wanted.verb} has no option {_shown(key)} here", f"nearest: {near}"
            )
        if name in found:
            raise FileFormatError(path, f"{where}: {name} is given twice", "leave one of them out")
        found[name] = _value(path, f"{where}: {name}", value, name in wanted.lists)
    section = entry.get(wanted.verb)
    if section is None:
        return found
    alone = Wanted(wanted.verb, wanted.options, wanted.lists, ())
    return {**found, **_options(path, f"{wanted.verb} of {where}", section, alone)}


def _value(path: Path, what: str, value: Any, several: bool) -> Value:
    if several and isinstance(value, list):
        return tuple(str(_value(path, what, item, False)) for item in value)
    good = value is None or isinstance(value, (str, int, float))
    if isinstance(value, float) and not math.isfinite(value):
        good = False
    if isinstance(value, str) and (not value or not value.isprintable()):
        good = False
    if not good:
        expected = "a list, a text or a number" if several else "a text, a number, true or false"
        raise FileFormatError(path, f"{what} is {_shown(value)}, expected {expected}", "put texts in quotes")
    return (str(value),) if several and value is not None else value


def _check_mapping(path: Path, value: Any, what: str) -> None:
    if not isinstance(value, dict):
        raise FileFormatError(path, f"{what} is {_shown(value)}, expected names with values (name: value)")
    for key in value:
        if not isinstance(key, str):
            raise FileFormatError(
                path, f"{what} has the name {_shown(key)}, expected a text", "put it in quotes"
            )


def _read_yaml(path: Path) -> Any:
    """The contents of a YAML file.

    Raises:
        FileFormatError: it is not YAML, or has aliases, what is nested too deeply, or a name twice in a mapping.
    """
    import yaml

    text = read_text(path)
    try:
        _check_events(path, text)
        return yaml.load(text, _loader())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" (line {mark.line + 1})" if mark is not None else ""
        problem = getattr(error, "problem", None) or "it has letters that YAML does not allow"
        raise FileFormatError(
            path, f"is not valid YAML{place}: {problem}", f"it should hold {WHAT}"
        ) from error
    except (ValueError, RecursionError, OverflowError) as error:  # such as the 31st of February
        raise FileFormatError(path, f"is not valid YAML ({error})", "put texts in quotes") from error


def _check_events(path: Path, text: str) -> None:
    """Refuse what a few bytes can make large or deep, before anything is made of it."""
    import yaml

    depth = 0
    for event in yaml.parse(text, _base_loader()):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 0
            raise FileFormatError(
                path, f"has an alias (*{event.anchor}, line {line})", "write out what it stands for"
            )
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > _DEEPEST:
            raise FileFormatError(path, "is nested too deeply", f"is it {WHAT}?")


def _base_loader() -> Any:
    """PyYAML's safe loader; libyaml's, many times faster, where PyYAML was built with it."""
    import yaml

    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _loader() -> type:
    """The same, which refuses a name given twice in one mapping."""
    import yaml

    class Loader(_base_loader()):
        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            seen = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode) and key.value in seen:
                    problem = f"{_shown(key.value)} is given twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add(key.value if isinstance(key, yaml.ScalarNode) else key)
            return super().construct_mapping(node, deep)

    return Loader


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    text = "missing" if value is None else ascii(value)
    return text if len(text) <= 40 else text[:37] + "..."
