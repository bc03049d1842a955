"""Files of archives: read once, replaced whole and never trusted, whoever reads and writes meanwhile."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

import scoup
from query.planted_room import planted_room
from scoup.archive import kept_scans
from scoup.archive.read_scans import ScanBlock, read_block, read_records
from scoup.archive.scan_files import ScanRecord
from scoup.base.errors import FileFormatError, InputError, UnknownNameError
from scoup.models.text import TextEncoder
from scoup.query.language_field import LanguageField

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")


def test_a_scan_is_replaced_and_removed(
    archive: scoup.Archive, fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    before = archive.find("mug")
    archive.add(fields["office"], floor=7)
    assert archive.scans()["office"].columns == {"floor": 7, "city": "Graz"}
    assert [each.thing for each in archive.find("mug")] == [each.thing for each in before]
    archive.remove("office")
    assert {each.scan for each in archive.find("mug")} == {each.scan for each in before} - {"office"}
    assert sorted(path.name for path in archive.folder.iterdir()) == [
        "archive.json",
        "hall.parquet",
        "kitchen.parquet",
    ]
    with pytest.raises(UnknownNameError, match="no scan named 'ofice'"):
        archive.remove("ofice")
    copy = tmp_path / "hall.scoup"
    fields["hall"].save(copy)
    fields["hall"].path = archive.scans()["hall"].field_path
    with pytest.raises(InputError, match=r"is of .*rename one"):
        archive.add(copy)


def test_what_has_not_changed_is_read_once(
    archive: scoup.Archive, fields: dict[str, LanguageField], monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[list[str]] = []

    def reading(records: Sequence[ScanRecord], connection: Any) -> ScanBlock:
        read.append([record.name for record in records])
        time.sleep(0.1)  # other threads wait
        return read_block(records, connection)

    monkeypatch.setattr(kept_scans, "read_block", reading)
    run_threads([partial(archive.find, "mug", where) for where in (None, "floor = 1", None)])
    archive.add(fields["hall"], floor=7)
    archive.find("mug")
    archive.remove("kitchen")
    archive.find("mug")
    assert read == [["hall", "kitchen", "office"], ["hall"]]


def test_what_was_read_of_many_scans_is_kept(
    archive: scoup.Archive, fields: dict[str, LanguageField], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_scans, "LEAST_KEPT", 1)
    kept, wanted = archive.folder / kept_scans.KEPT, [each.to_dict() for each in archive.find("mug")]
    read: list[int] = []
    monkeypatch.setattr(
        kept_scans, "read_block", lambda *given: read.append(len(given[0])) or read_block(*given)
    )

    def found() -> list[dict[str, Any]]:
        return [each.to_dict() for each in scoup.Archive(archive.folder).find("mug")]

    assert (found(), read) == (wanted, [])
    for damage in (lambda: flipped(kept, 5000), lambda: flipped(kept, 9), lambda: kept.write_bytes(b"")):
        damage()
        assert (found(), read.pop()) == (wanted, 3)
        assert (found(), read) == (wanted, [])
    monkeypatch.setattr(kept_scans, "VERSION", 9)
    assert (found(), read.pop()) == (wanted, 3)
    size = kept.stat().st_size
    archive.remove("hall")
    assert found() == [each for each in wanted if each["scan"] != "hall"]
    assert kept.stat().st_size < size
    archive.add(fields["office"], floor=9)
    assert {each["columns"]["floor"] for each in found()} == {1, 9}
    assert (read, kept.stat().st_size < size) == ([1], True)
    warm = scoup.Archive(archive.folder)
    assert warm.find("mug")
    kept.unlink()
    kept.mkdir()  # cannot be written
    assert ({each["scan"] for each in found()}, read) == ({"kitchen", "office"}, [1, 2])
    for name in ("kitchen", "office"):
        archive.remove(name)
    assert (warm.find("mug"), found()) == ([], [])


def run_threads(calls: Sequence[Callable[[], Any]]) -> None:
    threads = [threading.Thread(target=call, daemon=True) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def flipped(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that is open")
def test_threads_ask_while_scans_are_removed_and_replaced(
    archive: scoup.Archive, fields: dict[str, LanguageField], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_scans, "LEAST_KEPT", 1)
    files = sorted(archive.folder.glob("*.parquet"))[:2]
    contents = [file.read_bytes() for file in files]
    done, errors = threading.Event(), list[Exception]()

    def ask() -> None:
        try:
            while not done.is_set():
                for found in (archive.find("lamp"), archive.find("lamp", "floor < 9"), archive.scans()):
                    assert found
        except Exception as error:
            errors.append(error)

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
    assert errors == []
    assert {each.scan for each in archive.find("lamp")} == set(fields)


def test_scans_are_listed_again_if_one_has_gone(
    archive: scoup.Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = ["office"]

    def reading(files: Sequence[Path], connection: Any) -> list[ScanRecord]:
        while gone:
            (archive.folder / f"{gone.pop()}.parquet").unlink()
        return read_records(files, connection)

    monkeypatch.setattr(kept_scans, "read_records", reading)
    assert set(archive.scans()) == {"hall", "kitchen"}
    gone.append("hall")
    assert {each.scan for each in archive.find("mug")} == {"kitchen"}


@pytest.mark.parametrize("is_before", [True, False])
def test_things_are_of_the_files_that_a_condition_holds_for(
    archive: scoup.Archive,
    fields: dict[str, LanguageField],
    monkeypatch: pytest.MonkeyPatch,
    is_before: bool,
) -> None:
    floors, asked, matching = [7], list[list[str]](), scoup.Archive._matching

    def replace_office() -> None:
        while floors:
            archive.add(fields["office"], floor=floors.pop())

    def matching_meanwhile(self: scoup.Archive, where: str, names: list[str]) -> dict[str, set[int]]:
        if is_before:
            replace_office()
        asked.append(names)
        found = matching(self, where, names)
        replace_office()
        return found

    archive.find("lamp")
    monkeypatch.setattr(scoup.Archive, "_matching", matching_meanwhile)
    found = archive.find("lamp", "floor != 1")
    assert {each.scan: each.columns["floor"] for each in found} == {"office": 7, "hall": 2}
    assert asked == [["hall", "kitchen", "office"], ["office"]]
    floors.append(1)
    assert {each.scan for each in archive.find("lamp", "floor != 1")} == {"hall"}


def test_two_writers_lose_nothing(fields: dict[str, LanguageField], tmp_path: Path) -> None:
    paths = [str(field.path) for field in fields.values()] * 2
    run_threads([lambda path=path: scoup.Archive(tmp_path / "a").add(path) for path in paths])
    assert set(scoup.Archive(tmp_path / "a").scans()) == set(fields)


def test_what_does_not_fit_is_refused(
    archive: scoup.Archive, fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    field = planted_room()
    with pytest.raises(InputError, match="is not saved"):
        archive.add(field)
    for change, said in (
        ({"embedding_model": "other/model"}, "other/model .*some/model .*archive per embedding model"),
        ({"embedding_model": "some/model"}, ""),
    ):
        field.info = replace(field.info, **change)
        field.save(tmp_path / "new.scoup", overwrite=True)
        if said:
            with pytest.raises(InputError, match=said):
                archive.add(field)
        else:
            archive.add(field)
    new = scoup.Archive(tmp_path / "new")
    for columns in (
        {"thing": 1}, {"Floor": 1}, {"x; drop": 1}, {"floor": [1]}, {"floor": 2**63}, {"city": "\ud800"},
    ):  # fmt: skip
        with pytest.raises(InputError, match="column"):
            new.add(fields["hall"], **columns)  # pyright: ignore[reportArgumentType]
    assert not new.folder.exists()
    bare = planted_room(has_things=False)
    bare.save(tmp_path / "bare.scoup")
    with pytest.raises(InputError, match="has no things"):
        archive.add(bare)
    with pytest.raises(InputError, match="`top`"):
        archive.find("mug", top=0)
    with pytest.raises(InputError, match="dimensions"):
        scoup.Archive(archive.folder, TextEncoder.open({"mug": torch.ones(5)})).find("mug")
    with pytest.raises(InputError, match="there is no such archive"):
        scoup.Archive(tmp_path / "nothing").find("mug")


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def other_parquet(column: str) -> Callable[[Path], None]:
    """Rewrite a scan with a column changed, and its metadata as they were."""

    def change(path: Path) -> None:
        import duckdb

        connection = duckdb.connect()
        (metadata,) = connection.execute(f"SELECT value FROM parquet_kv_metadata('{path}')").fetchone() or (
            b"",
        )
        connection.execute(f"CREATE TABLE t AS SELECT * {column} FROM read_parquet('{path}')")
        text = metadata.decode().replace("'", "''")
        connection.execute(f"COPY t TO '{path}' (FORMAT parquet, KV_METADATA {{scoup: '{text}'}})")

    return change


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(cut(path.read_bytes())),
        lambda path: path.write_bytes(path.read_bytes().replace(b'"levels": ["m"]', b'"levels": ["z"]')),
        lambda path: path.write_bytes(path.read_bytes().replace(b'"scoup scan"', b'"scoup scar"')),
        lambda path: path.write_bytes(path.read_bytes().replace(b'"version": 1', b'"version": 9')),
        other_parquet("EXCLUDE (vector)"),
        other_parquet("REPLACE (vector[:5] AS vector)"),
        other_parquet("REPLACE ([NULL] AS vector)"),
        other_parquet("REPLACE (thing + 1 AS thing)"),
        other_parquet("REPLACE (999 AS parent)"),
        other_parquet("REPLACE ('NaN'::FLOAT AS hub)"),
        other_parquet("REPLACE (-1 AS gaussians)"),
        other_parquet("REPLACE (NULL AS gaussians)"),
        other_parquet("REPLACE ('text' AS stability)"),
        other_parquet("REPLACE ([1.0, 2.0] AS position)"),
        other_parquet("REPLACE ([{'thing': 99999, 'gaussians': 1}] AS shares)"),
    ],
)
def test_a_damaged_scan_is_named_and_replaced(
    archive: scoup.Archive, fields: dict[str, LanguageField], damage: Callable[[Path], Any]
) -> None:
    damage(archive.folder / "office.parquet")
    with pytest.raises(FileFormatError, match=r"office\.parquet: .*; (add its field again|update it)"):
        scoup.Archive(archive.folder).find("mug")
    archive.add(fields["office"])
    assert "office" in {each.scan for each in archive.find("mug")}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "does not describe"),
        ("[1]", "does not describe"),
        ('{"format": "x"}', "does not describe"),
        (None, "no such file"),
    ],
)
def test_a_damaged_description_is_named(archive: scoup.Archive, text: str | None, said: str) -> None:
    path = archive.folder / "archive.json"
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(FileFormatError, match=rf"archive\.json: .*{said}"):
        scoup.Archive(archive.folder)
