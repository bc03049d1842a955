"""The process that reads damaged files, one after another, and reports on each; it may crash or hang."""

from __future__ import annotations

import ast
import ctypes
import gc
import importlib
import os
import resource
import shutil
import signal
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Literal

import torch

from benchmarks.hostile.containers import join_parts
from benchmarks.hostile.mutation import cut, damage
from benchmarks.hostile.readers import Reader
from scoup.base.errors import ScoupError, ScoupWarning

Outcome = Literal["accepted", "refused", "other error", "memory", "hang", "crash"]
_MMAP_THRESHOLD = -3  # of mallopt
_REFUSED_MEMORY = (
    "can't allocate memory",
    "not enough memory",
    "Cannot allocate memory",
    "failed to allocate",
)


VALID, BROKEN = -1, -2


@dataclass(frozen=True)
class Job:
    """The files that a process reads."""

    readers: str  # "module:table" of the readers
    name: str  # of the reader
    samples: Path  # folder of valid files; it is copied
    seed: int  # of the damage
    numbers: range  # of the damaged files
    seconds: float  # of the processor that one file may take

    @property
    def reader(self) -> Reader:
        module, table = self.readers.split(":")
        return getattr(importlib.import_module(module), table)[self.name]


@dataclass(frozen=True)
class Result:
    """The outcome of one file."""

    number: int  # of the file; ``VALID`` for the valid samples, ``BROKEN`` where this program itself failed
    size: int  # in bytes
    outcome: Outcome  # of its reading
    said: str = ""  # the error, in one line or as a traceback
    grown: int = 0  # most bytes by which the process grew while it read


class _Hung(BaseException):
    """The seconds of a file have passed."""


def damaged_file(job: Job, number: int) -> bytes:
    """Return the file of a number: always the same one."""
    random = Random(f"{job.seed} {job.name} {number}")
    reader = job.reader
    others = [(job.samples / name).read_bytes() for name in (reader.file, *reader.more)]
    data = random.choice(others)
    if random.random() < 0.1:
        return cut(random, data)
    if not reader.containers or random.random() < 0.35:
        return damage(random, data, others)
    container = random.choice(reader.containers)
    parts = container.split(data)
    for _ in range(random.choice((1, 1, 1, 2))):
        place = random.randrange(len(parts))
        parts[place] = damage(random, parts[place], parts)
    whole = join_parts(container, data, parts)
    return damage(random, whole, others) if random.random() < 0.05 else whole


def work(connection: Connection, job: Job) -> None:
    """Read all files of a job; a ``Result`` of each goes through the connection, first one of the valid samples."""
    try:
        _work(connection, job)
    except Exception:
        connection.send(Result(BROKEN, 0, "crash", traceback.format_exc()))


def _work(connection: Connection, job: Job) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    gc.freeze()  # objects of the modules need not be looked through again and again
    # What is given back goes back to the system at once: else memory from before would hide what a file takes.
    ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 1 << 16)
    torch.set_num_threads(1)
    with open(os.devnull, "w") as nowhere:  # libraries complain at length
        os.dup2(nowhere.fileno(), 2)
    signal.signal(signal.SIGPROF, _give_up)
    reader = job.reader
    with tempfile.TemporaryDirectory(prefix="hostile-") as name:
        folder = Path(name) / "files"
        shutil.copytree(job.samples, folder)
        valid = [(folder / sample).read_bytes() for sample in (reader.file, *reader.more)]
        result = Result(VALID, 0, "accepted")
        # Modules are loaded, and pools of memory grow, before anything counts.
        for content in [*valid, valid[0]]:
            result = _read(job, folder, VALID, content)
            if result.outcome != "accepted":
                break
        gc.freeze()  # what they have loaded, too
        connection.send(result)
        for number in job.numbers:
            connection.send(_read(job, folder, number, damaged_file(job, number)))


def _read(job: Job, folder: Path, number: int, content: bytes) -> Result:
    reader, path = job.reader, folder / job.reader.file
    path.write_bytes(content)
    size = len(content)
    outcome, said = "accepted", ""
    before = _forget_peak()
    allowed = reader.memory.bytes(size)
    try:
        with _limits(allowed if number >= 0 else 4 << 30, job.seconds), warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ScoupWarning)
            reader.read(folder)
    except ScoupError as error:
        outcome, said = _refusal(error, folder)
    except _Hung:
        outcome, said = "hang", traceback.format_exc()
    except BaseException as error:  # a panic of Rust is no Exception
        outcome = "memory" if _is_memory(error) else "other error"
        said = traceback.format_exc()
    grown = max(0, _peak() - before)
    if grown > allowed and outcome in ("accepted", "refused") and number >= 0:
        outcome, said = "memory", f"grew by {grown:,} bytes, of {allowed:,}; {said}"
    if outcome != "refused":
        gc.collect()
    return Result(number, size, outcome, said, grown)


def _refusal(error: ScoupError, folder: Path) -> tuple[Outcome, str]:
    """Return "refused", unless the memory had run out before or the message is not one line that names the file."""
    said = str(error)
    cause: BaseException | None = error
    while cause is not None:
        if _is_memory(cause):
            return "memory", "".join(traceback.format_exception(error))
        cause = cause.__cause__ or cause.__context__
    if "\n" in said or str(folder) not in said:
        return "other error", f"a message of several lines, or without the file: {said}"
    return "refused", said.replace(str(folder), "")


def _is_memory(error: BaseException) -> bool:
    """Return whether the system has refused memory. Python's own parser says the same of text that is nested
    too deeply."""
    frames = traceback.extract_tb(error.__traceback__)
    if frames and frames[-1].filename == ast.__file__:
        return False
    return isinstance(error, MemoryError) or any(words in str(error) for words in _REFUSED_MEMORY)


def _give_up(*_: object) -> None:
    raise _Hung


@contextmanager
def _limits(memory: int, seconds: float) -> Iterator[None]:
    """Limit the growth of the process in bytes and the seconds of the processor in this block."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + memory, before[1]))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, before)


def _forget_peak() -> int:
    """Return bytes of memory in use; from now on ``_peak`` counts again."""
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")
    return _kilobytes("VmRSS") * 1024


def _peak() -> int:
    """Return most bytes that were in use at once."""
    return _kilobytes("VmHWM") * 1024


def _kilobytes(name: str) -> int:
    with open("/proc/self/status") as stream:
        return next(int(line.split()[1]) for line in stream if line.startswith(name + ":"))
