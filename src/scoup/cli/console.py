"""Output of verbs for people or machines, progress, warnings, errors as one line."""

from __future__ import annotations

import errno
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from scoup.base import (
    InputError,
    Progress,
    ScoupError,
    ScoupWarning,
    WriteError,
    as_json,
    no_progress,
    printable,
)
from scoup.cli.options import Common
from scoup.cli.stop import exit_code

_ARGUMENT = re.compile("`([a-z_]+)(?:=([^`]+))?`")
"""An argument in messages of the library, alone or with a value."""
_OPTIONS = {"count": "--views", "distorted": "--undistort", "encoder": "--text", "words": "--text"}
"""Arguments -> their options, where names differ."""
_OUT_OF_MEMORY = "not enough memory; use fewer or smaller views, or a machine with more"
_LOADING = "loading ..."
"""On a terminal until the first line of a verb, whose imports and files take seconds."""
_SIGNS_OF_MEMORY = ("allocate", "out of memory", "failed to map segment")


class Console:
    """The standard streams of one run of a verb.

    Text goes to standard output unless quiet or JSON is wanted; warnings and errors go to standard error.

    Attributes:
        kept: says what an interruption at this moment leaves; a verb that resumes its work sets it.
    """

    def __init__(self, common: Common) -> None:
        self.common = common
        self.warnings: list[str] = []
        self.kept: Callable[[], str] = lambda: "nothing was written"
        self._loading = False

    @property
    def _has_terminal(self) -> bool:
        """Whether somebody watches the verb work."""
        return not (self.common.quiet or self.common.as_json) and sys.stderr.isatty()

    def start(self) -> None:
        """Show on a terminal that the verb has begun, until something else is printed there."""
        if self._has_terminal:
            self._loading = True
            with _printing(sys.stderr):
                print(_LOADING, end="\r", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take away what ``start`` shows."""
        if self._loading:
            self._loading = False
            with _printing(sys.stderr):
                print(" " * len(_LOADING), end="\r", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """Print a line for people."""
        if self.common.quiet or self.common.as_json:
            return
        self.clear()
        with _printing():
            # Not by rich: file names and texts may contain what it takes for markup. At once, also into a pipe: a
            # server goes on for hours.
            print(printable(text), flush=True)

    def result(self, record: dict[str, Any]) -> None:
        """Print the machine-readable result, if asked for."""
        if self.common.as_json:
            if self.warnings:
                record = {**record, "warnings": self.warnings}
            with _printing():
                print(as_json(record), flush=True)

    def warn(self, message: str) -> None:
        """Print a warning the first time it comes, and keep it for the JSON result."""
        message = with_options(message)
        if message not in self.warnings:
            self.warnings.append(message)
            self.clear()
            with _printing(sys.stderr):
                print(f"warning: {printable(message)}", file=sys.stderr, flush=True)

    def fail(self, message: str, code: int) -> int:
        """Print an error as one line, and in the JSON result; returns the exit code."""
        message = printable(" ".join(with_options(message).splitlines()))
        self.clear()
        with _printing(sys.stderr):
            print(f"error: {message}", file=sys.stderr, flush=True)
        self.result({"error": message})
        return code

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Yield a progress callback that draws bars on a terminal and is silent elsewhere."""
        if not self._has_terminal:
            yield no_progress
            return
        self.clear()
        from rich.console import Console as RichConsole
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        columns = (
            TextColumn("{task.description:<14}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        # Over half an hour: a photograph of `scoup extract` can take minutes.
        with Bars(
            *columns,
            console=RichConsole(stderr=True),
            speed_estimate_period=1800,
            redirect_stdout=sys.stdout.isatty(),
        ) as bars:
            tasks: dict[str, Any] = {}

            def report(stage: str, done: int, total: int) -> None:
                if stage not in tasks:
                    tasks[stage] = bars.add_task(printable(stage), total=total)
                bars.update(tasks[stage], completed=done, total=total)

            yield report


def run_verb(common: Common, run: Callable[[Console], int | None]) -> int:
    """Run a verb; print errors that the user can correct as one line.

    Returns:
        Exit code: the verb's, or 0 done, 2 bad input, 130 interrupted, 143 terminated.
        Faults of the program itself raise (exit code 1).
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
            console.start()
            check_device(getattr(common, "device", "cpu"))
            code = run(console) or 0
            console.clear()
            with _printing():
                sys.stdout.flush()
            return code
        except ScoupError as error:
            return console.fail(str(error), 2)
        except KeyboardInterrupt as stop:
            code = exit_code(stop)
            word = "interrupted" if code == 130 else "terminated"
            return console.fail(f"{word}; {console.kept()}", code)
        except MemoryError:
            return console.fail(_OUT_OF_MEMORY, 2)
        except OSError as error:  # such as a full disk: no fault of the program
            if error.errno == errno.ENOMEM:
                return console.fail(_OUT_OF_MEMORY, 2)
            where, refused = f"{error.filename}: " if error.filename else "", WriteError.of("", error)
            remedy = refused.remedy or "remove the cause and try again"
            return console.fail(f"{where}the system refused ({refused.reason}); {remedy}", 2)
        except (RuntimeError, ImportError) as error:  # as torch reports it, and the loader of its libraries
            if not any(sign in str(error) for sign in _SIGNS_OF_MEMORY):
                raise
            return console.fail(_OUT_OF_MEMORY, 2)


def kept(views: str) -> str:
    """Return in words that an interruption leaves these views."""
    return f"{views} are kept, run the same command again to continue"


def detector_command(field: object, *texts: str) -> str:
    """Return the command that lets a detector decide, and what it costs."""
    return f"{command('query', field, *texts, '--refine', 'owlv2')} (12 photographs: minutes on a CPU)"


def command(*words: object) -> str:
    """Return a command of scoup as a shell takes it, to be suggested in a message."""
    return shlex.join(["scoup", *map(str, words)])


def with_options(message: str) -> str:
    """Return the message with options in place of arguments: `check_fit=False` becomes --no-check-fit."""
    return _ARGUMENT.sub(_option, message)


def _option(argument: re.Match[str]) -> str:
    name, value = argument.groups()
    dashed = name.replace("_", "-")
    if name in _OPTIONS:
        return _OPTIONS[name]
    if value in ("True", "False"):
        return f"--{dashed}" if value == "True" else f"--no-{dashed}"
    return f"--{dashed}" if value is None else f"--{dashed} {value.strip(chr(39))}"


def silence(stream: TextIO) -> None:
    """Write no more to a standard stream: what waits there cannot be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def _printing(stream: TextIO | None = None) -> Iterator[None]:
    """Print to a standard stream, by default standard output; a reader who has gone, such as ``head``, ends nothing.

    Raises:
        WriteError: standard output cannot be written, such as a file on a full disk.
    """
    printed = sys.stdout if stream is None else stream
    try:
        yield
    except BrokenPipeError:
        silence(printed)
    except OSError as error:
        silence(printed)
        if printed is sys.stdout:
            raise WriteError.of("standard output", error) from error


def check_device(device: str) -> None:
    """Refuse a device this torch does not have."""
    if device == "cpu":
        return
    import torch

    try:
        wanted = torch.device(device)
        usable = wanted.type == "cuda" and (wanted.index or 0) < torch.cuda.device_count()
    except RuntimeError:
        usable = False
    if not usable:
        raise InputError(f"--device {device}: this torch ({torch.__version__}) has no such device; use cpu")
