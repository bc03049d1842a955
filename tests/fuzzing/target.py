"""The target of the fuzzers: an input becomes a file, which a reader accepts or refuses.

An input is a byte that says how, and what the file is made of:

    0  the file
    n  the byte of a valid sample and its parts, in the n-th container of the reader: each the length (4 bytes, little
       endian) and the content. They are put together again with lengths and checksums that fit.
"""

from __future__ import annotations

import ast
import ctypes
import os
import signal
import struct
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.fuzzing.containers import join_parts
from tests.fuzzing.readers import Reader

from scoup.base import ScoupError, ScoupWarning

SECONDS = 10.0
"""Of the processor that one file may take."""
_REFUSED_MEMORY = "can't allocate memory", "not enough memory", "Cannot allocate memory", "failed to allocate"


class Misbehaviour(Exception):
    """What no reader may do: fail other than by a ``ScoupError`` of one line with the file in it, or take too much."""


def pack_parts(parts: Sequence[bytes]) -> bytes:
    """Return parts as inputs have them."""
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def unpack_parts(packed: bytes, count: int) -> list[bytes]:
    """Return so many parts; what is cut short stays so."""
    parts = []
    for _ in range(count):
        end = 4 + int.from_bytes(packed[:4], "little")
        parts.append(packed[4:end])
        packed = packed[end:]
    return parts


def seeds_of(reader: Reader, samples: Path) -> list[bytes]:
    """Return inputs that make the valid files of a reader, whole and part by part."""
    valid = [(samples / name).read_bytes() for name in (reader.file, *reader.more)]
    return [b"\0" + content for content in valid] + [
        bytes([number, place]) + pack_parts(container.split(content))
        for number, container in enumerate(reader.containers, 1)
        for place, content in enumerate(valid)
    ]


def file_of(reader: Reader, valid: Sequence[bytes], content: bytes) -> bytes:
    """Return the file that an input makes.

    Args:
        valid: the valid samples of the reader.
        content: the input, of any bytes.
    """
    number = content[0] % (1 + len(reader.containers)) if content else 0
    if not number or len(content) < 2:
        return content[1:]
    whole, container = valid[content[1] % len(valid)], reader.containers[number - 1]
    parts = unpack_parts(content[2:], len(container.split(whole)))
    return join_parts(container, whole, parts)


def target_of(reader: Reader, folder: Path, seconds: float = SECONDS) -> Callable[[bytes], bool]:
    """Return a function that reads what an input makes: whether it was accepted.

    Args:
        reader: it reads each of its valid samples first, which must be accepted.
        folder: a copy of the samples, in which files are written.
        seconds: of the processor that one file may take.
    """
    valid = [(folder / name).read_bytes() for name in (reader.file, *reader.more)]
    for content in valid:  # modules are loaded, and pools of memory grow, before anything counts
        (folder / reader.file).write_bytes(content)
        reader.read(folder)

    def read(content: bytes) -> bool:
        file = file_of(reader, valid, content)
        (folder / reader.file).write_bytes(file)
        try:
            with _limits(reader.memory.bytes(len(file)), seconds), warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", ScoupWarning)
                reader.read(folder)
        except ScoupError as error:
            _check_refusal(error, folder)
            return False
        except BaseException as error:  # a panic of Rust is no Exception
            raise Misbehaviour("no ScoupError") from error
        return True

    return read


def _check_refusal(error: ScoupError, folder: Path) -> None:
    cause: BaseException | None = error
    while cause is not None:
        if _is_memory(cause):
            raise Misbehaviour("it was refused when the memory had run out") from error
        cause = cause.__cause__ or cause.__context__
    if "\n" in str(error) or str(folder) not in str(error):
        raise Misbehaviour(f"a message of several lines, or without the file: {error}") from error


def _is_memory(error: BaseException) -> bool:
    """Return whether the system has refused memory. Python's own parser says the same of text that is nested
    too deeply."""
    frames = traceback.extract_tb(error.__traceback__)
    if frames and frames[-1].filename == ast.__file__:
        return False
    return isinstance(error, MemoryError) or any(words in str(error) for words in _REFUSED_MEMORY)


@contextmanager
def _limits(memory: int, seconds: float) -> Iterator[None]:
    """Limit the growth of the process in bytes and the seconds of the processor in this block, on Linux."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    ctypes.CDLL(None).malloc_trim(0)  # else memory from before would hide what a file takes
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    limits, handler = resource.getrlimit(resource.RLIMIT_AS), signal.signal(signal.SIGPROF, _give_up)
    resource.setrlimit(resource.RLIMIT_AS, (size + memory, limits[1]))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, handler)
        resource.setrlimit(resource.RLIMIT_AS, limits)


def _give_up(*_: object) -> None:
    raise Misbehaviour("it takes too long")
