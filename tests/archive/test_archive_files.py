"""Files of archives: read once, replaced whole and never trusted, whoever reads and writes meanwhile."""

from __future__ import annotations

import base64
import json
import os
import sys
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch
from safetensors.torch import load, save

import scoup
from messages import refuses
from query import planted_room as planted
from query.planted_room import planted_room
from scoup.archive import archive as archive_module
from scoup.archive import kept_scans, list_scans, scan_files, scan_header
from scoup.archive.kept_scans import MATRIX, KeptScans
from scoup.archive.scan_files import Scan, read_scans
from scoup.base import FileFormatError, UnknownNameError
from scoup.models import TextEncoder
from scoup.query import LanguageField

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")

Fields = dict[str, LanguageField]


def test_a_scan_is_replaced_and_removed(archive: scoup.Archive, fields: Fields, tmp_path: Path) -> None:
    before = archive.find("mug")
    archive.add(fields["office"], floor=7)
    assert archive.scans()["office"].columns == {"floor": 7, "city": "Graz"}
    assert [each.thing for each in archive.find("mug")] == [each.thing for each in before]
    archive.remove("office")
    assert {each.scan for each in archive.find("mug")} == {each.scan for each in before} - {"office"}
    names = {path.name for path in archive.folder.iterdir()}
    assert names == {"archive.json", "hall.parquet", "kitchen.parquet", MATRIX}
    with refuses(UnknownNameError):
        archive.remove("ofice")
    copy = tmp_path / "hall.scoup"
    fields["hall"].save(copy)
    fields["hall"].path = archive.scans()["hall"].field_path
    with refuses():
        archive.add(copy)


def test_an_archive_that_disappears_is_named(archive: scoup.Archive) -> None:
    assert archive.find("mug")
    archive.folder.rename(archive.folder.with_name("elsewhere"))
    with refuses():
        archive.find("mug")


def test_what_has_not_changed_is_read_once(archive: scoup.Archive, fields: Fields, monkeypatch) -> None:
    read: list[list[str]] = []

    def reading(files: Sequence[Path], connection: Any) -> list[Scan]:
        if files:
            read.append([file.stem for file in files])
            time.sleep(0.1)  # other threads wait
        return read_scans(files, connection)

    archive = scoup.Archive(archive.folder)
    monkeypatch.setattr(kept_scans, "read_scans", reading)
    run_threads([partial(archive.find, "mug", where) for where in (None, "floor = 1", None)])
    archive.add(fields["hall"], floor=7)
    archive.find("mug")
    archive.remove("kitchen")
    archive.find("mug")
    assert read == [["hall", "kitchen", "office"], ["hall"]]


def rows_of(archive: scoup.Archive) -> dict[str, range]:
    return {name: range(scan.row, scan.row + len(scan)) for name, scan in archive.scans().items()}


def test_rows_of_scans_that_left_are_used_again(archive: scoup.Archive, fields: Fields) -> None:
    matrix = archive.folder / MATRIX
    wanted, before, size = found_by(archive), rows_of(archive), matrix.stat().st_size
    assert size == 2 * planted.DIM * sum(map(len, before.values()))
    archive.remove("office")
    archive.add(fields["hall"])  # does not fit before the end, nor over its own rows
    assert rows_of(archive)["hall"] == before["office"][: len(before["hall"])]
    archive.add(fields["office"], floor=0, city="Graz")
    archive.add(fields["hall"], floor=2)
    every = [row for rows in rows_of(archive).values() for row in rows]
    assert len({*every}) == len(every)
    assert matrix.stat().st_size <= 2 * size
    assert found_by(archive) == found_by(scoup.Archive(archive.folder)) == wanted


def found_by(archive: scoup.Archive) -> list[dict[str, Any]]:
    return [each.to_dict() for each in archive.find("mug")]


def test_a_killed_writer_leaves_an_archive(archive: scoup.Archive, fields: Fields, monkeypatch) -> None:
    wanted = found_by(archive)
    for place, step in ((KeptScans, "write_vectors"), (archive_module, "write_scan")):
        with monkeypatch.context() as patch:
            patch.setattr(place, step, Mock(side_effect=KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                archive.add(fields["office"], floor=9)
        assert found_by(archive) == found_by(scoup.Archive(archive.folder)) == wanted
    archive.add(fields["office"], floor=9)
    assert {each["columns"]["floor"] for each in found_by(archive) if each["scan"] == "office"} == {9}


@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_a_damaged_matrix_is_named(archive: scoup.Archive, fields: Fields, damage: str) -> None:
    wanted, matrix = found_by(archive), archive.folder / MATRIX
    data = bytearray(matrix.read_bytes())
    data[len(data) // 2] ^= 1
    matrix.write_bytes(data if damage == "flip" else data[: len(data) // 2])
    if damage == "remove":
        matrix.unlink()
    assert found_by(archive) == wanted  # it has read the vectors
    with refuses(FileFormatError):
        scoup.Archive(archive.folder).find("mug")
    assert set(scoup.Archive(archive.folder).scans()) == set(fields)
    for floor, name in enumerate(fields):
        archive.add(fields[name], floor=floor, city="Graz")
    assert found_by(scoup.Archive(archive.folder)) == wanted


def test_a_matrix_with_nan_and_the_right_checksum_is_named(archive: scoup.Archive) -> None:
    matrix, scan = archive.folder / MATRIX, archive.scans()["office"]
    data = bytearray(matrix.read_bytes())
    start, end = (2 * planted.DIM * row for row in (scan.row, scan.row + len(scan)))
    data[start : start + 2] = b"\xff\x7f"
    matrix.write_bytes(data)

    def seal(header: dict[str, Any]) -> None:
        header["vectors_checksum"] = zlib.crc32(data[start:end])
        header["checksum"] = scan_header.checksum(header)

    rewrite(scan.file, seal)
    with pytest.raises(FileFormatError, match="not finite, in the vectors of the scan office"):
        scoup.Archive(archive.folder).find("mug")


def run_threads(calls: Sequence[Callable[[], Any]]) -> None:
    with ThreadPoolExecutor(len(calls)) as pool:
        for call in [pool.submit(call) for call in calls]:
            call.result()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that is open")
def test_threads_ask_while_scans_are_removed_and_replaced(archive: scoup.Archive, fields: Fields) -> None:
    files = sorted(archive.folder.glob("*.parquet"))[:2]
    contents = [file.read_bytes() for file in files]
    done = threading.Event()

    def ask() -> None:
        while not done.is_set():
            for found in (archive.find("lamp"), archive.find("lamp", "floor < 9"), archive.scans()):
                assert found

    def replace_files() -> None:
        try:
            for file, content in [*zip(files, contents, strict=True)] * 100:
                file.unlink()
                time.sleep(0.003)
                new = archive.folder / ".new"
                new.write_bytes(content)
                new.replace(file)
                time.sleep(0.003)
        finally:
            done.set()

    run_threads([ask] * 4 + [replace_files])
    assert {each.scan for each in archive.find("lamp")} == set(fields)


def test_scans_are_listed_again_if_one_has_gone(archive: scoup.Archive, monkeypatch) -> None:
    gone = ["office"]

    def reading(files: Sequence[Path], connection: Any) -> list[Scan]:
        while gone:
            (archive.folder / f"{gone.pop()}.parquet").unlink()
        return read_scans(files, connection)

    archive = scoup.Archive(archive.folder)
    monkeypatch.setattr(kept_scans, "read_scans", reading)
    assert set(archive.scans()) == {"hall", "kitchen"}
    gone.append("hall")
    assert {each.scan for each in archive.find("mug")} == {"kitchen"}


@pytest.mark.parametrize("is_before", [True, False])
def test_things_are_of_the_files_of_a_condition(archive, fields: Fields, monkeypatch, is_before) -> None:
    floors, asked, matching = [7], list[list[str]](), scoup.Archive._wanted

    def replace_office() -> None:
        while floors:
            archive.add(fields["office"], floor=floors.pop())

    def matching_meanwhile(self: scoup.Archive, where: str, scans: dict[str, Scan]) -> Any:
        if is_before:
            replace_office()
        asked.append([*scans])
        found = matching(self, where, scans)
        replace_office()
        return found

    archive.find("lamp")
    monkeypatch.setattr(scoup.Archive, "_wanted", matching_meanwhile)
    found = archive.find("lamp", "floor != 1")
    assert {each.scan: each.columns["floor"] for each in found} == {"office": 7, "hall": 2}
    assert asked == [["hall", "kitchen", "office"]] * 2
    floors.append(1)
    assert {each.scan for each in archive.find("lamp", "floor != 1")} == {"hall"}


def test_two_writers_lose_nothing(fields: Fields, tmp_path: Path) -> None:
    paths = [str(field.path) for field in fields.values()] * 2
    run_threads([lambda path=path: scoup.Archive(tmp_path / "a").add(path) for path in paths])
    assert set(scoup.Archive(tmp_path / "a").scans()) == set(fields)


def test_what_does_not_fit_is_refused(archive: scoup.Archive, fields: Fields, tmp_path: Path) -> None:
    field = planted_room()
    with refuses():
        archive.add(field)
    field.info = replace(field.info, embedding_model="other/model")
    field.save(tmp_path / "new.scoup")
    with refuses():
        archive.add(field)
    new = scoup.Archive(tmp_path / "new")
    columns = ("thing", 1), ("Floor", 1), ("x; drop", 1), ("floor", [1]), ("floor", 2**63), ("city", "\ud800")
    for name, value in columns:
        with refuses():
            new.add(fields["hall"], **{name: value})  # pyright: ignore[reportArgumentType]
    assert not new.folder.exists()
    bare = planted_room(has_things=False)
    bare.save(tmp_path / "bare.scoup")
    with refuses():
        archive.add(bare)
    other = scoup.Archive(archive.folder, TextEncoder.open({"mug": torch.ones(5)}))
    for asked, top in ((archive, 0), (other, 10), (scoup.Archive(tmp_path / "nothing"), 10)):
        with refuses():
            asked.find("mug", top=top)


def rewrite(path: Path, change: Callable[[dict[str, Any]], Any] = len, column: str = "") -> None:
    """Rewrite a scan with a header that is changed, or with a column that is."""
    import duckdb

    connection = duckdb.connect()
    (metadata,) = connection.execute(f"SELECT value FROM parquet_kv_metadata('{path}')").fetchone() or (b"",)
    header = json.loads(metadata)
    change(header)
    connection.execute(f"CREATE TABLE t AS SELECT * {column} FROM read_parquet('{path}')")
    text = json.dumps(header).replace("'", "''")
    connection.execute(f"COPY t TO '{path}' (FORMAT parquet, KV_METADATA {{scoup: '{text}'}})")


BYTES: list[Callable[[bytes], bytes]] = [
    lambda data: b"",
    lambda data: data[: len(data) // 2],
    lambda data: data.replace(b'"levels": ["m"]', b'"levels": ["z"]'),
    lambda data: data.replace(b'"scoup scan"', b'"scoup scar"'),
    lambda data: data.replace(b'"version": 1', b'"version": 9'),
]
HEADERS: list[Callable[[dict[str, Any]], Any]] = [
    lambda header: header.pop("arrays"), lambda header: header.update(arrays=header["arrays"][:-8]),
    lambda header: header.update(arrays=header["arrays"].replace("A", "B")), lambda header: header.update(levels=[]),
    lambda header: header.update(texts=["mug"]), lambda header: header.update(columns={"Floor": 1}),
]  # fmt: skip


def with_array(name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[dict[str, Any]], Any]:
    """Return a change of one array of a scan, with the checksum it then has."""

    def changed(header: dict[str, Any]) -> None:
        arrays = load(base64.b64decode(header["arrays"]))
        arrays[name] = change(arrays[name]).contiguous()
        header["arrays"] = base64.b64encode(save(arrays)).decode()
        header["checksum"] = scan_header.checksum(header)

    return changed


SEALED = [
    *(with_array(name, lambda array: array[:-1]) for name in scan_files._PER_THING),
    *(with_array(name, lambda array: array[..., :-1]) for name in ("ends", "others", "gaussians", "best_fits")),
    *(with_array(name, lambda array: array * torch.nan)
      for name in ("counts", "mass", "doubt", "spread", "hubs", "gaussians", "best_fits")),
    *(with_array(name, lambda array: array.double()) for name in ("counts", "levels", "usable", "others")),
    *(with_array(name, lambda array: array + 100) for name in ("others", "ends", "levels")),
    with_array("others", torch.neg),
    with_array("ends", lambda array: array.flip(0)),
]  # fmt: skip
COLUMNS = [
    "EXCLUDE (position)", "REPLACE ([1.0, 2.0] AS position)", "REPLACE (NULL AS box_axes)",
    "REPLACE ('text' AS box_extent)", "REPLACE (thing + 100 AS thing)",
]  # fmt: skip


@pytest.mark.parametrize("damages", [
    [lambda path, change=change: path.write_bytes(change(path.read_bytes())) for change in BYTES],
    [partial(rewrite, change=change) for change in HEADERS],
    [partial(rewrite, change=change) for change in SEALED],
    [partial(rewrite, column=column) for column in COLUMNS],
], ids=["bytes", "header", "arrays", "columns"])  # fmt: skip
def test_a_damaged_scan_is_named_and_can_be_added_again(
    archive: scoup.Archive, fields: Fields, damages: list[Callable[[Path], Any]]
) -> None:
    path = archive.folder / "office.parquet"
    whole = path.read_bytes()
    for damage in damages:
        path.write_bytes(whole)
        damage(path)
        with pytest.raises(FileFormatError, match=r"office\.parquet: .*; (add its field again|update it)"):
            scoup.Archive(archive.folder).find("mug")
    archive.add(fields["office"])
    assert "office" in {each.scan for each in archive.find("mug")}


def test_a_damaged_description_is_named(archive: scoup.Archive) -> None:
    path = archive.folder / "archive.json"
    for text in ("{}", "[1]", '{"format": "x"}'):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=r"archive\.json: does not describe an archive"):
            scoup.Archive(archive.folder)
    path.unlink()
    with refuses(FileFormatError):
        scoup.Archive(archive.folder)


@pytest.mark.skipif(sys.platform != "linux", reason="file names are of bytes")
def test_a_folder_named_in_another_encoding_is_refused_and_its_scans_are_not_called_damaged(
    archive: scoup.Archive,
) -> None:
    folder = archive.folder.rename(archive.folder.parent / os.fsdecode(b"\xe9t\xe9"))
    for use in (scoup.Archive, list_scans):
        with pytest.raises(FileFormatError, match="its path is not in UTF-8; rename the folder"):
            use(folder)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such pipes")
@pytest.mark.parametrize("name", ["archive.json", "office.parquet"])
def test_pipes_in_place_of_files_are_refused(archive: scoup.Archive, name: str) -> None:
    (archive.folder / name).unlink()
    os.mkfifo(archive.folder / name)
    with pytest.raises(FileFormatError, match=rf"{name}: is a named pipe \(FIFO\)"):
        scoup.Archive(archive.folder).find("mug")
