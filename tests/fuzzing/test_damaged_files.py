"""A short run of the target of the fuzzers over every reader, with inputs that are always the same; and readers that
misbehave on purpose, which it must find."""

from __future__ import annotations

import builtins
import errno
import io
import os
import shutil
import sys
import warnings
from collections.abc import Callable
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.fuzzing.containers import join_parts
from tests.fuzzing.mutation import damage
from tests.fuzzing.readers import READERS, Memory, Reader
from tests.fuzzing.samples import OTHER_SPLATS, write_samples
from tests.fuzzing.target import Misbehaviour, file_of, pack_parts, seeds_of, target_of, unpack_parts

from scoup.base import FileFormatError, ScoupWarning
from support import examples

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits are those of Linux")
COUNT, SEED = examples(120), 7
OPENED_BY_OTHERS = {"regions", "region sums", "scene of region sums", "words.safetensors", "scan of an archive",
                    "spz, unpacked", *(ending[1:] for ending in OTHER_SPLATS)}  # fmt: skip
"""Files that Python does not open, or only tests do."""
NOT_SHARED = {"spz, unpacked", "config.yml", "cfg.yml", "archive.json"}  # by Git LFS


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("valid")
    write_samples(folder)
    return folder


def damaged(random: Random, reader: Reader, seeds: list[bytes]) -> bytes:
    """An input that makes a damaged file: damaged as a whole, or in a part of a container."""
    seed = random.choice(seeds)
    if not seed[0]:
        return seed[:1] + damage(random, seed[1:])
    parts, rest = [], seed[2:]
    while rest:
        parts += unpack_parts(rest, 1)
        rest = rest[4 + len(parts[-1]) :]
    place = random.randrange(len(parts))
    parts[place] = damage(random, parts[place])
    return seed[:2] + pack_parts(parts)


@pytest.mark.parametrize("name", READERS)
def test_no_reader_misbehaves(samples: Path, tmp_path: Path, name: str) -> None:
    """It reads what the seeds make, whole and part by part, and accepts or refuses what damaged seeds make."""
    reader, folder = READERS[name], tmp_path / "files"
    shutil.copytree(samples, folder)
    read, seeds = target_of(reader, folder), seeds_of(reader, samples)
    valid = [(samples / file).read_bytes() for file in (reader.file, *reader.more)]
    assert [file_of(reader, valid, seed) for seed in seeds[: len(valid)]] == valid
    assert file_of(reader, valid, b"") == file_of(reader, valid, b"\0") == b""
    if reader.share == 1:
        assert all(read(seed) for seed in seeds)
    random, accepted = Random(f"{SEED} {name}"), []
    for number in range(max(10, int(COUNT * reader.share))):
        content = damaged(random, reader, seeds)
        try:
            accepted.append(read(content))
        except Misbehaviour as error:
            raise AssertionError(f"{name}, file {number}, kept as {folder / reader.file}") from error
    assert not all(accepted)
    if name not in NOT_SHARED:
        (folder / reader.file).write_bytes(
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
        )
        with pytest.raises(FileFormatError, match="pointer of Git LFS"):
            reader.read(folder)


@pytest.mark.parametrize("name", [name for name, reader in READERS.items() if reader.containers])
def test_containers_are_put_together_as_they_were(samples: Path, name: str) -> None:
    """What is taken apart and joined again is taken apart alike, and damage inside changes the whole."""
    reader = READERS[name]
    for file, container in product((reader.file, *reader.more), reader.containers):
        whole = (samples / file).read_bytes()
        parts = container.split(whole)
        again = join_parts(container, whole, parts)
        assert [part.rstrip() for part in container.split(again)] == [part.rstrip() for part in parts]
        last = max(range(len(parts)), key=lambda place: len(parts[place]))
        parts[last] = parts[last][1:]
        assert join_parts(container, whole, parts) != again


@pytest.mark.parametrize("name", [name for name in READERS if name not in OPENED_BY_OTHERS])
def test_a_disk_that_fails_is_named(samples: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    reader, own, reason = READERS[name], io.open, os.strerror(errno.EIO)
    file = samples / reader.file

    def failing(path: Any, *arguments: Any, **options: Any) -> Any:
        if isinstance(path, (str, os.PathLike)) and Path(path) == file:
            raise OSError(errno.EIO, reason, str(path))
        return own(path, *arguments, **options)

    for module in (io, builtins):
        monkeypatch.setattr(module, "open", failing)
    with pytest.raises(FileFormatError) as refused:
        reader.read(samples)
    problem = f"cannot be read ({reason}); check its disk or network drive, and retry"
    assert str(refused.value) == f"{file}: {problem}"


def test_parts_are_packed_and_cut_short() -> None:
    packed = pack_parts([b"one", b"", b"three"])
    assert unpack_parts(packed, 3) == [b"one", b"", b"three"]
    assert unpack_parts(packed[:-2], 4) == [b"one", b"", b"thr", b""]


FILE, VALID = "a.planted", b"fine"


def loop(path: Path) -> None:
    while True:
        pass


def take(size: int) -> None:
    np.ones(size, np.uint8)


def take_and_hide(path: Path) -> None:
    try:
        take(1 << 30)
    except MemoryError as error:
        raise FileFormatError(path, "is damaged") from error


def refuse(path: Path) -> None:
    warnings.warn("said beforehand", ScoupWarning, stacklevel=2)
    raise FileFormatError(path, "is damaged")


def refuse_namelessly(path: Path) -> None:
    raise FileFormatError("somewhere", "is damaged")


def warn(path: Path) -> None:
    _ = np.float32(1e30) * np.float32(1e30)


def fail(path: Path) -> None:
    raise ValueError("no refusal")


def planted(misbehave: Callable[[Path], object], folder: Path) -> Callable[[bytes], bool]:
    """The target of a reader that accepts the valid sample alone."""

    def read(place: Path) -> None:
        if (place / FILE).read_bytes() != VALID:
            misbehave(place / FILE)

    (folder / FILE).write_bytes(VALID)
    return target_of(Reader(FILE, read, memory=Memory(64, 64)), folder, seconds=0.5)


@linux
@pytest.mark.parametrize(
    ("misbehave", "said"),
    [
        *((each, "no ScoupError") for each in (loop, lambda path: take(1 << 30), fail, warn)),
        (lambda path: np.empty(1 << 34, np.uint8), "no ScoupError"),
        (take_and_hide, "memory had run out"), (refuse_namelessly, "without the file"),
    ],
)  # fmt: skip
def test_what_readers_do_is_found(tmp_path: Path, misbehave: Callable[[Path], object], said: str) -> None:
    read = planted(misbehave, tmp_path)
    assert read(b"\0" + VALID)
    with pytest.raises(Misbehaviour, match=said):
        read(b"\0damaged")


def test_what_readers_may_do_is_counted(tmp_path: Path) -> None:
    assert not planted(refuse, tmp_path)(b"\0damaged")
    assert planted(lambda path: take(40 << 20), tmp_path)(b"\0damaged")


def test_a_sample_that_is_not_valid_is_an_error(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"other")
    with pytest.raises(ValueError, match="no refusal"):
        target_of(Reader(FILE, fail), tmp_path)
