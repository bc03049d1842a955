"""Files of our own formats, as kept in tests/frozen/formats, are read and written as they were."""

from __future__ import annotations

import json
import shutil
import zlib
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest
import torch
from safetensors import safe_open
from tests.fuzzing.containers import split_parquet

import frozen_formats
from cli_support import run
from frozen_formats import CODES, FORMATS, answers, gaussians_of_formats
from messages import refuses
from scoup.archive import Archive
from scoup.base import FileFormatError, SealedFile
from scoup.base.errors import FieldVersionError
from scoup.base.sealed_file import KEY as METADATA_KEY
from scoup.io import PlyTable
from scoup.query import LanguageField
from scoup.uplift import RegionSums
from scoup.uplift.storage.array_file import read_arrays
from scoup.uplift.stored_sums import VERSION

FIELDS = sorted(FORMATS.glob("*.scoup"))
ALLOWED = 1e-2  # votes of other processors and backends differ in the last bit of some float16 weights


@pytest.fixture(scope="module")
def made_now(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the present code writes."""
    folder = tmp_path_factory.mktemp("formats")
    frozen_formats.main(folder)
    return folder


def contents(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    with safe_open(path, framework="numpy") as stream:
        tensors = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
        return json.loads(stream.metadata()[METADATA_KEY]), tensors


@pytest.mark.parametrize("path", FIELDS, ids=lambda path: path.stem)
def test_a_field_answers_as_it_did(path: Path) -> None:
    field, kept = LanguageField.load(path), np.load(path.with_suffix(".npz"))
    if path.stem == "field":
        assert field.has_geometry
    now = answers(field)
    for part in ("relevancy", "gaussian_relevancy"):
        assert np.abs(now[part] - kept[part]).max() < 1e-5, part
    assert kept["relevancy"].std() > 0.1  # there is something to be compared
    asked = LanguageField.load(path, gaussians_of_formats())
    assert asked.thing_table is not None
    assert asked.at("view_00.png").answer("kettle").heat.shape == (24, 32)  # by the table that it names


@pytest.mark.parametrize("path", FIELDS, ids=lambda path: path.stem)
def test_a_field_of_another_form_needs_a_version_of_its_own(path: Path, made_now: Path) -> None:
    (now, tensors), (then, kept) = contents(made_now / path.name), contents(path)
    assert now.keys() == then.keys()
    assert {name: (each.dtype, each.ndim) for name, each in tensors.items()} == {
        name: (each.dtype, each.ndim) for name, each in kept.items()
    }


def test_an_archive_answers_as_its_field() -> None:
    found = Archive(FORMATS / "archive").find("kettle", where="floor = 2")
    things = LanguageField.load(FORMATS / "field.scoup").things("kettle")
    assert (
        {(each.scan, each.thing) for each in found} == {("field", thing.number) for thing in things} != set()
    )


def test_an_archive_of_another_form_needs_a_version_of_its_own(made_now: Path) -> None:
    now, then = (parquet_form(folder / "archive" / "field.parquet") for folder in (made_now, FORMATS))
    assert now == then
    (now,), (then,) = (Archive(folder / "archive").scans().values() for folder in (made_now, FORMATS))
    assert now.arrays.keys() == then.arrays.keys()
    for name, array in now.arrays.items():  # these depend on rules
        torch.testing.assert_close(array, then.arrays[name], rtol=0.01, atol=0.01)
    about, kept = (folder / "archive" / "archive.json" for folder in (made_now, FORMATS))
    assert about.read_text() == kept.read_text()


def parquet_form(path: Path) -> tuple[list[tuple[str, str]], set[str]]:
    """Names and types of the columns, and the keys of the metadata."""
    rows = duckdb.connect().read_parquet(str(path))
    return [*zip(rows.columns, map(str, rows.types), strict=True)], {
        *json.loads(split_parquet(path.read_bytes())[0])
    }


def test_sums_give_the_field_that_they_gave(tmp_path: Path) -> None:
    scene, out = FORMATS / "scene", tmp_path / "built.scoup"
    code, _, error = run("build", scene, "--sums", FORMATS / "sums", "--out", out, *CODES)
    assert code == 0, error
    now, kept = answers(LanguageField.load(out)), np.load(FORMATS / "field.npz")
    for part in ("relevancy", "gaussian_relevancy"):
        assert np.abs(now[part] - kept[part]).max() < ALLOWED, part


def test_a_scene_is_written_as_it_was(made_now: Path) -> None:
    """Labels are compared inflated, for zlib's versions pack differently; processors round Gaussians differently."""
    now, then = made_now / "scene", FORMATS / "scene"
    mine, kept = (PlyTable.read(scene / "point_cloud.ply") for scene in (now, then))
    assert (mine.rows.dtype, mine.comments) == (kept.rows.dtype, kept.comments)
    for name in kept.names:
        assert mine.rows[name] == pytest.approx(kept.rows[name], rel=1e-5, abs=1e-6), name
    kept.write(made_now / "again.ply")
    assert (made_now / "again.ply").read_bytes() == (then / "point_cloud.ply").read_bytes()
    with np.load(now / "words.npz") as mine, np.load(then / "words.npz") as kept:
        assert mine["names"].tolist() == kept["names"].tolist()
        assert np.array_equal(mine["vectors"], kept["vectors"])
    regions = sorted(path.relative_to(then) for path in (then / "language_features").glob("*.regions"))
    assert len(regions) == 3
    for name in regions:
        (mine, tensors), (kept, stored) = contents(now / name), contents(then / name)
        assert mine.pop("checksums").keys() == kept.pop("checksums").keys() == tensors.keys() == stored.keys()
        assert mine | {"checksum": ""} == kept | {"checksum": ""}  # checksums are of what zlib packs
        for part, array in tensors.items():
            both = {array.tobytes(), stored[part].tobytes()}
            assert len({zlib.decompress(each) for each in both} if part.startswith("labels.") else both) == 1
    manifest = Path("language_features") / "regions.json"
    assert (now / manifest).read_text() == (then / manifest).read_text()


@pytest.mark.parametrize("version", [VERSION + 1, 0, "2", None, True])
def test_versions_of_sums_that_are_not_known_are_refused(tmp_path: Path, version: object) -> None:
    path = Path(shutil.copytree(FORMATS / "sums", tmp_path / "a.sums"))
    stored = read_arrays(path / "scene.safetensors")
    header = {**stored.header, "version": version}
    SealedFile.write(path / "scene.safetensors", header, stored.arrays, overwrite=True)
    with refuses(FieldVersionError if version == VERSION + 1 else FileFormatError):
        RegionSums.open(path)
