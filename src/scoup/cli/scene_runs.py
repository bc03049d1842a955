"""A verb run on one scene of a list: in a process of its own, tried again if it fails, its log and result kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, Literal, get_args

from scoup.base.atomic import folder_made, write_text
from scoup.base.errors import ScoupError, WriteError
from scoup.base.locks import locked_file
from scoup.base.records import record_text

Ending = Literal["made", "there already", "failed"]

# Not -m: that would look for modules in the folder of the list first.
PROGRAM = "import sys; sys.path[:] = filter(None, sys.path); from scoup.cli.scene_runs import entry; entry()"
MISTAKE = 2  # the exit code for bad input: another attempt ends alike
SECONDS_TO_END = 30.0  # for a process that was asked to
TAIL = 65_536  # bytes of a log in which the error is looked for
LONGEST_MESSAGE = 500
_OF_TORCHRUN = {"RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT", "ROLE_NAME"}
_OF_TORCHRUN |= {f"{group}_{what}" for group in ("LOCAL", "GROUP", "ROLE") for what in ("RANK", "WORLD_SIZE")}


@dataclass(frozen=True)
class SceneRun:
    """What is run for one scene.

    Attributes:
        name: of the scene.
        verb: and the words before it, such as "eval", "lerf-ovs".
        options: what follows; without --overwrite.
        device: for ``--device``, if it is not among the options.
        folder: the current one of the process.
        output: what is made.
        logs: folder for log and record.
    """

    name: str
    verb: tuple[str, ...]
    options: tuple[str, ...]
    device: str
    folder: Path
    output: Path
    logs: Path

    @property
    def log(self) -> Path:
        """What the process prints."""
        return self.logs / f"{self.name}.log"

    @property
    def record(self) -> Path:
        """How the scene ended."""
        return self.logs / f"{self.name}.json"


@dataclass(frozen=True)
class SceneResult:
    """How a scene ended.

    Attributes:
        name: of the scene.
        result: made, there already, or failed.
        seconds: of all attempts together.
        attempts: how often the verb was run.
        message: the last error where it failed; or what is to be known of what is there.
    """

    name: str
    result: Ending
    seconds: float = 0.0
    attempts: int = 0
    message: str = ""


def run_scene(run: SceneRun, retries: int, overwrite: bool) -> SceneResult:
    """Run the verb for a scene unless its output is there already, and keep how that ended.

    Args:
        retries: attempts after a first one that failed, unless that was for bad input.
        overwrite: make what is there again.
    """
    try:
        with locked_file(run.record, overwrite=True):
            earlier = read_record(run)
            result = None if overwrite else _there(run, earlier)
            if result is None:
                result = _attempts(run, retries, overwrite)
            if result.result != "there already" or earlier is None or earlier["result"] == "failed":
                _write_record(run, result)
            return result
    except ScoupError as error:  # such as a log that cannot be written: the other scenes may have more luck
        return SceneResult(run.name, "failed", message=str(error))


def read_result(run: SceneRun) -> SceneResult | None:
    """How a scene ended that this or another process has run; None if that is not known."""
    found = read_record(run)
    if found is None:
        return None
    return SceneResult(**{field.name: found[field.name] for field in fields(SceneResult)})


def read_record(run: SceneRun) -> dict[str, Any] | None:
    """The record of a scene; None if there is none that makes sense."""
    try:
        found = json.loads(run.record.read_bytes())
        sound = found["name"] == run.name and found["result"] in get_args(Ending)
        numbers = (float(found["seconds"]), int(found["attempts"]))
        return found if sound and min(numbers) >= 0 and isinstance(found["message"], str) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _write_record(run: SceneRun, result: SceneResult) -> None:
    record = {**asdict(result), "verb": " ".join(run.verb), "options": list(run.options)}
    write_text(run.record, record_text({**record, "output": str(run.output)}) + "\n", overwrite=True)


def _there(run: SceneRun, earlier: dict[str, Any] | None) -> SceneResult | None:
    """The result for an output that is there; None where there is none, or it may be unfinished.

    A file appears when it is whole. A folder is known to be so from the record of the run that has made it.
    """
    same = earlier is not None and earlier.get("options") == list(run.options)
    if run.output.is_file():
        other = "" if same or earlier is None else "made with other options; --overwrite makes it anew"
        return SceneResult(run.name, "there already", message=other)
    if run.output.is_dir() and same and earlier is not None and earlier["result"] != "failed":
        return SceneResult(run.name, "there already")
    return None


def _attempts(run: SceneRun, retries: int, overwrite: bool) -> SceneResult:
    """Run the verb until it succeeds, has no more retries, or was given bad input."""
    started = time.perf_counter()
    attempt, code, message = 0, 1, ""
    with folder_made(run.logs, run.log):
        while attempt <= retries and code not in (0, MISTAKE):
            attempt += 1
            code, message = _attempt(run, attempt, overwrite)
    seconds = round(time.perf_counter() - started, 2)
    return SceneResult(run.name, "made" if code == 0 else "failed", seconds, attempt, message)


def _attempt(run: SceneRun, number: int, overwrite: bool) -> tuple[int, str]:
    """Exit code and, unless that is 0, the error."""
    arguments = [*run.verb, *run.options, *(["--overwrite"] if overwrite else [])]
    if run.device:
        arguments.append(f"--device={run.device}")
    try:
        with run.log.open("ab" if number > 1 else "wb") as log:
            log.write(f"attempt {number}: scoup {' '.join(arguments)}\n".encode("utf-8", "backslashreplace"))
            log.flush()
            start = log.tell()
            code = _run(arguments, run.folder, log)
    except OSError as error:
        raise WriteError.of(run.log, error) from error
    return code, "" if code == 0 else _error_of(code, run.log, start)


def _run(arguments: Sequence[str], folder: Path, log: BinaryIO) -> int:
    """Run scoup in a process of its own, which ends with this one's work; its exit code."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        cwd=folder,
        env=_environment(),
        stdin=subprocess.PIPE,  # nothing is written to it: it ends when this process does
        stdout=log,
        stderr=subprocess.STDOUT,
        # Ctrl-C reaches this process only, which asks the other to end: two signals would cut its cleaning up short.
        start_new_session=True,
    ) as process:
        try:
            return process.wait()
        except BaseException:
            _end(process)
            raise


def entry() -> None:
    """The program for one scene: scoup, which is terminated when the process that has started it is no more."""
    from scoup.cli.app import entry

    threading.Thread(target=_end_with_parent, daemon=True).start()
    entry()


def _end_with_parent() -> None:
    os.read(0, 1)  # standard input; not by sys.stdin, whose lock Python wants at its end
    os.kill(os.getpid(), signal.SIGTERM)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ask a process to end; kill it, and those that it has started, if it does not or there is no time."""
    try:
        process.terminate()
        process.wait(SECONDS_TO_END)
    except BaseException:
        with suppress(ProcessLookupError):
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        process.wait()


def _environment() -> dict[str, str]:
    """Ours, but the process is alone at its scene, and its current folder is another."""
    found = {
        name: value
        for name, value in os.environ.items()
        if name not in _OF_TORCHRUN and not name.startswith("TORCHELASTIC_")
    }
    paths = [os.path.abspath(path) for path in found.get("PYTHONPATH", "").split(os.pathsep) if path]
    if paths:
        found["PYTHONPATH"] = os.pathsep.join(paths)
    return {**found, "PYTHONUNBUFFERED": "1"}


def _error_of(code: int, log: Path, start: int) -> str:
    """Why a process ended so, in a sentence: the last error in its log, or the signal that has killed it.

    Args:
        start: where in the log its own part begins.
    """
    if code < 0:
        names = {number.value: number.name for number in signal.Signals}
        memory = "; perhaps for lack of memory" if names.get(-code) == "SIGKILL" else ""
        return f"killed by {names.get(-code, f'signal {-code}')}{memory}"
    with log.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(start, size - TAIL))
        lines = [line.strip() for line in stream.read().decode("utf-8", "replace").splitlines()]
    errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    said = (errors or [line for line in lines if line] or [f"exit code {code}"])[-1]
    return "".join(char if char.isprintable() else " " for char in said)[:LONGEST_MESSAGE]
