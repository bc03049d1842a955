"""Region sums that earlier code has kept are read, and give the fields that they gave (tests/frozen_versions.py)."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli_support import refused, run
from frozen_versions import CODES, REMOVED, VERSIONS, answers
from scoup.base.errors import FieldVersionError, FileFormatError
from scoup.field.language_field import LanguageField
from scoup.uplift.region_sums import VERSION, RegionSums
from scoup.uplift.storage.record_file import RecordFile

KEPT = sorted(VERSIONS.glob("*/kept.scoup.sums"))
SHARDS = {path.parent.name: path.parent for path in sorted(VERSIONS.glob("*/*.1-of-2.sums"))}
WITHOUT_SCENE = "efd7d73"


def first_header(path: Path) -> dict:
    """Of a file of region sums, without the code that reads them."""
    with path.open("rb") as stream:
        stream.seek(24)
        return json.loads(stream.read(int.from_bytes(stream.read(8), "little")))["header"]


@pytest.fixture
def versions(tmp_path: Path) -> Path:
    """A copy of all kept files, which may be changed."""
    return Path(shutil.copytree(VERSIONS, tmp_path / "versions"))


ALLOWED = 1e-2  # votes of other processors and backends differ in the last bit of some float16 weights


def check_same(field: Path, then: Path) -> None:
    """A field answers as one of the same name did."""
    now, kept = answers(LanguageField.load(field)), np.load(then)
    for name in ("relevancy", "gaussian_relevancy"):
        assert np.abs(now[name] - kept[name]).max() < ALLOWED, name


def test_there_is_a_file_of_every_version() -> None:
    assert {first_header(path)["version"] for path in KEPT} == set(range(1, VERSION + 1))
    buckets = {path.parent.name: "buckets.0" in RecordFile.open(path).records[-1].arrays for path in KEPT}
    assert set(buckets.values()) == {True, False}  # version 2 has two forms


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.parent.name)
def test_an_update_gives_what_it_gave(path: Path, versions: Path) -> None:
    folder = versions / path.parent.name
    with_sums, out = folder / "kept.scoup", folder / "updated.scoup"
    code, _, error = run("update", with_sums, "--remove", REMOVED, "--out", out)
    assert code == 0, error
    check_same(out, path.with_name("updated.npz"))
    before, after = np.load(path.with_name("kept.npz")), np.load(path.with_name("updated.npz"))
    assert (
        np.abs(before["relevancy"] - after["relevancy"]).max() > 10 * ALLOWED
    )  # the view that went has counted


def test_shards_give_what_shards_of_today_give(versions: Path) -> None:
    """All are of one scene, whose region sums have not changed; what is made of them may."""
    newest = "304e48f"
    read = [name for name in SHARDS if name != WITHOUT_SCENE]
    assert read
    for name in read:
        folder = versions / name
        out = folder / "merged.scoup"
        splat = versions / "scene" / "point_cloud.ply"
        shards = sorted(folder.glob("*-of-2.sums"))
        code, _, error = run("merge", *shards, "--gaussians", splat, "--out", out, *CODES)
        assert code == 0, error
        check_same(out, VERSIONS / newest / "merged.npz")


def test_shards_that_do_not_name_their_scene_are_refused_in_one_sentence(versions: Path) -> None:
    folder = versions / WITHOUT_SCENE
    shards = sorted(folder.glob("*-of-2.sums"))
    message = refused("merge", *shards, "--out", folder / "merged.scoup", folder=folder)
    assert message == (
        f"{shards[0]}: is a shard of an older form, which does not name its scene; "
        "make it again with scoup build --shard"
    )


@pytest.mark.parametrize("version", [VERSION + 1, 0, "2", None, True])
def test_versions_that_are_not_known_are_refused(tmp_path: Path, version: object) -> None:
    path, file = tmp_path / "a.sums", RecordFile.create(tmp_path / "a.sums")
    file.append(
        "region sums", {**first_header(KEPT[-1]), "version": version}, {"order": np.arange(3, dtype=np.int32)}
    )
    file.close()
    with pytest.raises(FileFormatError) as caught:
        RegionSums.open(path)
    if version == VERSION + 1:
        assert isinstance(caught.value, FieldVersionError)
        assert str(caught.value) == (
            f"{path}: was written by a newer SCOUP (format version {VERSION + 1}, this one reads up to {VERSION}); "
            "update it: pip install -U scoup"
        )
    else:
        assert (
            str(caught.value) == f"{path}: makes no sense (its format version is {version!r}); make it again"
        )
