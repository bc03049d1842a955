"""Files of region sums whose checksums agree and whose contents are invalid."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.fuzzing.containers import SUMS

from messages import refuses
from scoup.base import FileFormatError
from scoup.base.native import missing_reason
from scoup.scene import SparseCodes
from scoup.uplift.rasterise import region_sums
from scoup.uplift.storage.array_file import read_arrays, view_file, write_arrays
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.voting import vote
from support import small_scene

Arrays = dict[str, NDArray[Any]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The sums of one view."""
    gaussians, cameras, regions = small_scene(count=300, views=1, width=16, height=12)
    region_sums(gaussians, cameras, regions, path=tmp_path / "a.sums")
    return tmp_path / "a.sums"


def changed(path: Path, change: Callable[[Arrays], None]) -> Path:
    """A copy with other arrays in the file of its view."""
    copy = Path(shutil.copytree(path, path.with_name("b.sums"), dirs_exist_ok=True))
    file = copy / view_file("view_00.png")
    stored = read_arrays(file)
    arrays = {name: array.copy() for name, array in stored.arrays.items()}
    change(arrays)
    write_arrays(file, stored.header, arrays, overwrite=True)
    return copy


def assert_vote_refuses(sums: RegionSums, backend: str) -> None:
    rows = [{name: slice(0, 16) for name in sums.views} for _ in sums.levels]
    codes = [SparseCodes(torch.zeros(16, 1, dtype=torch.uint8), torch.ones(16, 1), 2) for _ in sums.levels]
    with refuses():
        vote(sums.select(sums.views, rows), codes, torch.ones(3, 2, 4), keep=1, backend=backend)


def test_entries_that_point_outside_are_refused_where_they_are_used(path: Path) -> None:
    """As ``test_vote.damaged`` has them, also by matrices."""

    def beyond(arrays: Arrays) -> None:
        arrays["combinations.0"][-1] = len(arrays["table.0"])

    sums = RegionSums.open(changed(path, beyond))
    with refuses():
        sums.triplets("view_00.png", 0)
    assert_vote_refuses(sums, "reference")


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.pop("places.0"),
        lambda arrays: arrays.update({"weights.0": arrays["weights.0"].astype(np.float16)}),
        lambda arrays: arrays.update({"starts.0": arrays["starts.0"][:-1]}),
    ],
    ids=["none", "types", "shapes"],
)
def test_entries_that_are_none_are_refused_at_once(path: Path, change) -> None:
    with refuses(FileFormatError):
        RegionSums.open(changed(path, change))


@pytest.mark.filterwarnings("error")
def test_weights_that_are_no_numbers_or_too_large_together(path: Path) -> None:
    def signalling(arrays: Arrays) -> None:
        arrays["weights.0"].view(np.uint32)[:] = 0x7FA00000

    def large(arrays: Arrays) -> None:
        arrays["weights.0"][:] = np.finfo(np.float32).max
        arrays["table.0"][:] = 0

    for change, shows in ((signalling, np.isnan), (large, np.isinf)):
        sums = RegionSums.open(changed(path, change))
        assert shows(sums.triplets("view_00.png", 0)[2]).any()


@pytest.mark.parametrize("backend", ["reference", "native"])
def test_regions_that_have_no_code(path: Path, backend: str) -> None:
    if backend == "native" and missing_reason() is not None:
        pytest.skip("needs the compiled core")

    def beyond(arrays: Arrays) -> None:
        arrays["table.0"][0, 0] = 2**31 - 1

    assert_vote_refuses(RegionSums.open(changed(path, beyond)), backend)


@pytest.mark.parametrize(("old", "new"), [
    (r"\"version\": 1", r"\"version\": Infinity"),
    ('"order"', '"deep": ' + "[" * 100_000 + ', "order"'),
    ('"shape": [300]', '"shape": [1099511627776, 0]'),
    ('"shape": [300]', '"shape": [301]'),
    ('"shape": [300]', '"shape": [1e308, 1e308]'),
    ("4800]", "4804]"), ('"I32"', '"BOOL"'),
])  # fmt: skip
def test_headers_that_make_no_sense(path: Path, old: str, new: str) -> None:
    file = path / "scene.safetensors"
    whole = file.read_bytes()
    parts = SUMS.split(whole)
    assert old.encode() in parts[0]
    parts[0] = parts[0].replace(old.encode(), new.encode(), 1)
    file.write_bytes(SUMS.join(whole, parts))
    # Reasons of json are worded by Python.
    said = r"scene.safetensors: (is invalid|has an invalid format version)"
    with pytest.raises(FileFormatError, match=said):
        RegionSums.open(path)


def test_a_file_of_another_view(path: Path) -> None:
    (path / view_file("view_00.png")).rename(path / view_file("view_01.png"))
    with refuses(FileFormatError):
        RegionSums.open(path)
