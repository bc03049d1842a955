"""What all verbs share: output for people or machines, progress, warnings, one sentence for every error."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from scoup.errors import ScoupError, ScoupWarning
from scoup.progress import Progress, no_progress


@dataclass(frozen=True)
class Common:
    """Options every verb takes."""

    device: str = "cpu"
    """Where tensors live: cpu, or cuda where torch has a GPU."""
    quiet: bool = False
    """Print nothing but warnings and errors."""
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object on standard output instead of text, for other programs."""


@dataclass(frozen=True)
class WritesCommon(Common):
    """Options of verbs that write files."""

    overwrite: bool = False
    """Replace outputs that are already there."""


class Console:
    """The standard streams of one run of a verb.

    Text goes to standard output unless quiet or JSON is wanted; warnings and errors go to standard error.
    """

    def __init__(self, common: Common) -> None:
        self.common = common
        self.warnings: list[str] = []

    def say(self, *parts: Any) -> None:
        """Print a line, or a rich table, for people."""
        if not self.common.quiet and not self.common.as_json:
            self._rich().print(*parts, highlight=False, soft_wrap=True)

    def result(self, record: dict[str, Any]) -> None:
        """Print the machine-readable result, if asked for."""
        if self.common.as_json:
            if self.warnings:
                record = {**record, "warnings": self.warnings}
            print(json.dumps(record, indent=2, default=_plain))

    def warn(self, message: str) -> None:
        self.warnings.append(message)
        print(f"warning: {message}", file=sys.stderr)

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """A progress callback that draws bars on a terminal and is silent elsewhere."""
        if self.common.quiet or self.common.as_json or not sys.stderr.isatty():
            yield no_progress
            return
        from rich.console import Console as RichConsole
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        columns = (TextColumn("{task.description:<14}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Bars(*columns, console=RichConsole(stderr=True)) as bars:
            tasks: dict[str, Any] = {}

            def report(stage: str, done: int, total: int) -> None:
                if stage not in tasks:
                    tasks[stage] = bars.add_task(stage, total=total)
                bars.update(tasks[stage], completed=done, total=total)

            yield report

    def _rich(self) -> Any:
        from rich.console import Console as RichConsole

        return RichConsole()


def run_verb(verb: Any, common: Common, run: Callable[[Console], None]) -> int:
    """Run a verb; print errors a user can mend as one line.

    Returns:
        Exit code: 0 done, 2 bad input, 130 interrupted. Faults of the program itself raise (exit code 1).
    """
    console = Console(common)

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if issubclass(category, ScoupWarning):
            console.warn(str(message))
        else:
            original(message, category, *rest, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ScoupWarning)
        original, warnings.showwarning = warnings.showwarning, show
        try:
            check_device(common.device)
            run(console)
            return 0
        except ScoupError as error:
            return _fail(console, str(error), 2)
        except KeyboardInterrupt:
            return _fail(console, "interrupted", 130)
        except MemoryError:
            return _fail(console, "not enough memory; use fewer or smaller views, or a machine with more", 2)


def check_device(device: str) -> None:
    """Refuse a device this torch does not have."""
    if device == "cpu":
        return
    import torch

    from scoup.errors import InputError

    try:
        usable = torch.device(device).type == "cuda" and torch.cuda.is_available()
    except RuntimeError:
        usable = False
    if not usable:
        raise InputError(f"--device {device}: this torch ({torch.__version__}) has no such device; use cpu")


def slug(text: str) -> str:
    """A file name for a text: letters, digits and dashes."""
    kept = "".join(char if char.isalnum() else "-" for char in text.lower()).strip("-")
    while "--" in kept:
        kept = kept.replace("--", "-")
    return kept[:60] or "text"


def unique_slugs(texts: list[str]) -> list[str]:
    """Slugs that differ even where the texts' letters do not."""
    seen: dict[str, int] = {}
    names = []
    for text in texts:
        name = slug(text)
        seen[name] = seen.get(name, 0) + 1
        names.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return names


def _fail(console: Console, message: str, code: int) -> int:
    print(f"error: {message}", file=sys.stderr)
    console.result({"error": message})
    return code


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
