"""Valid files of every format, cut, flipped and spliced: a reader succeeds or says what is wrong."""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from benchmarks.hostile.readers import READERS, Reader
from benchmarks.hostile.samples import write_samples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scoup.base.errors import ScoupError, ScoupWarning
from support import examples

HUGE = [struct.pack("<Q", value) for value in (10**12, 2**32 - 1, 2**62, 2**63, 2**64 - 1)]
HUGE += [struct.pack("<I", value) for value in (2**31 - 1, 2**31, 2**32 - 1)]
HUGE += [struct.pack("<d", value) for value in (float("nan"), float("inf"), -1e308, 1e-300)]
WORDS = [
    b"1e400",
    b"-1",
    b"nan",
    b"999999999999999999999",
    b"null",
    b"[]",
    b"{}",
    b'"',
    b"\0",
    b"\xff",
    b"",
    b"\n",
]
MEMORY = 1 << 30  # bytes beyond what is in use already


TARGETS = {kind: reader for kind, reader in READERS.items() if reader.share == 1}
"""All that start no process for a file."""

NAMED = {"checkpoint": "ckpts", "scenesplat": "arrays"}
"""What messages name where it is not the file alone."""


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One valid file of every format."""
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder)
    return folder


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    """Taking much memory is a MemoryError here, which no reader may let through."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def check(kind: str, folder: Path, damaged: bytes) -> bool:
    """Whether the damaged file was read; it is put right again."""
    target: Reader = TARGETS[kind]
    path = folder / target.file
    valid = path.read_bytes()
    path.write_bytes(damaged)
    try:
        with warnings.catch_warnings(), little_memory():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ScoupWarning)
            try:
                target.read(folder)
            except ScoupError as error:
                message = str(error)
                assert path.stem.split("_")[0] in message or NAMED.get(kind, "\0") in message, message
                assert "\n" not in message
                return False
            return True
    finally:
        path.write_bytes(valid)


@st.composite
def damage(draw: st.DrawFn, valid: bytes) -> bytes:
    data = bytearray(valid)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(data)))
        match draw(st.sampled_from(["cut", "flip", "huge", "word", "remove", "repeat"])):
            case "cut":
                del data[place:]
            case "flip":
                data[place : place + 1] = bytes([draw(st.integers(0, 255))])
            case "huge":
                value = draw(st.sampled_from(HUGE))
                data[place : place + len(value)] = value
            case "word":
                data[place : place + draw(st.integers(0, 8))] = draw(st.sampled_from(WORDS))
            case "remove":
                del data[place : place + draw(st.integers(1, 40))]
            case _:
                data[place:place] = data[place : place + draw(st.integers(1, 40))]
    return bytes(data)


@pytest.mark.parametrize("kind", TARGETS)
def test_samples_are_valid(sample, kind):
    assert check(kind, sample, (sample / TARGETS[kind].file).read_bytes())


# An empty points3D.txt means that there are no points.
@pytest.mark.parametrize("kind", [kind for kind in TARGETS if kind != "points3D.txt"])
def test_empty_files(sample, kind):
    assert not check(kind, sample, b"")


@pytest.mark.parametrize("kind", TARGETS)
def test_missing_files(sample, kind):
    path = sample / TARGETS[kind].file
    valid = path.read_bytes()
    path.unlink()
    try:
        with warnings.catch_warnings(), contextlib.suppress(ScoupError):
            warnings.simplefilter("ignore", ScoupWarning)
            TARGETS[kind].read(sample)
    finally:
        path.write_bytes(valid)


@pytest.mark.parametrize("kind", TARGETS)
def test_cut_files(sample, kind):
    valid = (sample / TARGETS[kind].file).read_bytes()
    for length in range(0, len(valid), max(1, len(valid) // 60)):
        check(kind, sample, valid[:length])


@pytest.mark.parametrize("kind", TARGETS)
def test_huge_numbers_in_the_head(sample, kind):
    valid = (sample / TARGETS[kind].file).read_bytes()
    for place in range(0, min(len(valid), 32), 4):
        for value in HUGE:
            check(kind, sample, valid[:place] + value + valid[place + len(value) :])


@pytest.mark.parametrize("kind", TARGETS)
@settings(
    max_examples=examples(60),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_damaged_files(sample, kind, data):
    check(kind, sample, data.draw(damage((sample / TARGETS[kind].file).read_bytes())))


@pytest.mark.parametrize("kind", TARGETS)
def test_files_of_other_kinds(sample, kind):
    for other in TARGETS.values():
        check(kind, sample, (sample / other.file).read_bytes())
