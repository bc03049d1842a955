"""Archives: what answers in each scan is what its field answers, and files are replaced whole and never trusted."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
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
from PIL import Image

import scoup
from cli_support import refused, run, run_json
from mask_samples import smooth_image
from query import planted_room as planted
from query.planted_room import ABSENT, ROOM, Box, planted_room
from query.test_named import BALL, LAMP, LAPTOP, MUG, names_of
from scoup.archive import kept_scans
from scoup.archive.agent_tool import archive_tool
from scoup.archive.archive import FoundThing
from scoup.archive.read_scans import ScanBlock, read_block, read_records
from scoup.archive.results_page import results_page
from scoup.archive.scan_files import ScanRecord
from scoup.archive.search import ImageSearch, Search
from scoup.base.errors import FileFormatError, InputError, ScoupWarning, UnknownNameError
from scoup.extract.plain_colors import PlainColors
from scoup.field.language_field import LanguageField
from scoup.models.image import open_image_model
from scoup.models.text import TextEncoder
from scoup.models.word_table import save_table
from scoup.query.presence import LIKELY
from scoup.scene.names import NameTable
from support import unit

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")
MODEL = "some/model"


@pytest.fixture(scope="module")
def fields(tmp_path_factory: pytest.TempPathFactory) -> dict[str, LanguageField]:
    """Saved fields of three rooms, of other things each: one has three mugs, one no mug and no laptop."""
    folder = tmp_path_factory.mktemp("fields")
    rooms = {
        "office": ROOM,
        "kitchen": (*ROOM, Box("mug", (-1, 0.7, 1.1), (0.2, 0.2, 0.2))),
        "hall": tuple(box for box in ROOM if box.name not in ("mug", "laptop")),
    }
    # Words of one table, as embeddings of one model have.
    encoder = planted_room().text_encoder()
    assert encoder.names is not None
    save_table(folder / "words.npz", encoder.names, encoder.encode(encoder.names).numpy())
    made = {}
    for name, room in rooms.items():
        made[name] = field = planted_room(room)
        assert field.thing_table is not None
        names = [box.name for box in room] + [f"clutter {number}" for number in range(6)]
        field.thing_table = replace(field.thing_table, embeddings=encoder.encode(names).half())
        field.info = replace(field.info, embedding_model=MODEL, words=folder / "words.npz")
        field.text_encoder(encoder)
        field.save(folder / f"{name}.scoup")
    return made


@pytest.fixture
def archive(fields: dict[str, LanguageField], tmp_path: Path) -> scoup.Archive:
    made = scoup.Archive(tmp_path / "sc[an]*s")
    for floor, field in enumerate(fields.values()):
        made.add(field, floor=floor, city="Graz")
    return made


@pytest.mark.parametrize(
    "question",
    [
        "mug",
        "lamp",
        ABSENT,
        "mug or ball",
        "how many mugs",
        "mug left of the laptop",
        "largest mug",
        "pen or mug on the table",
    ],
)
def test_answers_are_those_of_the_fields(
    archive: scoup.Archive, fields: dict[str, LanguageField], question: str
) -> None:
    found = archive.find(question, top=1000)
    assert_answers_are_those_of(found, fields, question)
    for top in (1, 2):
        assert [(each.scan, each.thing) for each in archive.find(question, top=top)] == [
            (each.scan, each.thing) for each in found[:top]
        ]
    assert bool(found) == (question != ABSENT)
    encoder = archive.text_encoder()
    search = Search.of(question, encoder, encoder.encode, False, None)
    ranks = {}
    for bound, asked in archive._ranked(search, None):
        mine = {(asked.scan.record.name, thing): asked.rank(thing, text)[1] for thing, text in asked.things()}
        assert all(rank < bound for rank in mine.values())
        ranks |= mine
    ordered = [ranks[each.scan, each.thing] for each in found]
    assert ordered == sorted(ordered, reverse=True)


def assert_answers_are_those_of(
    found: list[FoundThing], fields: dict[str, LanguageField], question: str
) -> None:
    for name, field in fields.items():
        mine = {each.thing: each for each in found if each.scan == name}
        things = field.things(question)
        assert set(mine) == {thing.number for thing in things}
        for thing in things:
            assert thing.number is not None
            one = mine[thing.number]
            kept = [(each.text, each.score, each.level, each.n_gaussians) for each in (one, thing)]
            assert kept[0] == kept[1]
            assert torch.equal(one.position, thing.position)
            assert torch.equal(one.box.corners(), thing.box.corners())
            assert one.to_dict()["box"] == thing.to_dict()["box"]


def test_things_are_counted_as_in_the_fields(
    archive: scoup.Archive, fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    places = torch.arange(len(fields["office"].gaussians))
    few = fields["office"][(places < 1000) | (places % 30 == 0)]  # later things keep less than ten Gaussians
    few.save(tmp_path / "few.scoup")
    archive.add(few)
    counts = {name: len(field.things()) for name, field in {**fields, "few": few}.items()}
    assert archive.counts() == counts
    assert few.thing_table is not None
    assert 0 < counts["few"] < len(few.thing_table)


def test_names_that_a_model_gave_answer_as_in_the_field(
    fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    encoder = fields["office"].text_encoder()
    assert encoder.names is not None
    table = dict(zip(encoder.names, encoder.encode(encoder.names), strict=True))
    table["beaker"] = unit(table["mug"] + 0.1 * table["ball"])  # near to a name
    votes = {"mug": {MUG: 0.6, BALL: 0.5}, "lamp": {BALL: 0.3}, ABSENT: {}, "pen": {LAPTOP: 0.3}}
    presence = {"mug": 0.9, "lamp": 0.9 * LIKELY, ABSENT: 0.05, "pen": 0.05}
    archive, field = scoup.Archive(tmp_path / "a", table), planted_room()
    archive.add(fields["hall"])
    assert field.thing_table is not None
    things = replace(fields["office"].thing_table or field.thing_table, names=names_of(votes, presence))
    field.thing_table, field.info = things, replace(field.info, embedding_model=MODEL)
    field.text_encoder(table)
    field.save(tmp_path / "named.scoup")
    archive.add(field)
    asked = {
        "mug": {MUG},  # without the names, the other, too
        "beaker": {MUG},
        "lamp": {LAMP},
        ABSENT: set(),
        "pen": set(),
    }
    for question in (*asked, "how many mugs", "mug left of the laptop", "pen or lamp"):
        found = archive.find(question)
        assert_answers_are_those_of(found, {"named": field}, question)
        if question in asked:
            assert {each.thing for each in found if each.scan == "named"} == asked[question]
    assert archive.find("mug")[0].score == pytest.approx(field.answer("mug").score)
    field.thing_table = replace(things, names=names_of({"mug": {BALL: 0.6}}, {"mug": 0.9}))
    field.save(tmp_path / "named.scoup", overwrite=True)
    with pytest.warns(ScoupWarning, match="has changed since"):
        archive.find("mug left of the laptop")
    none = torch.zeros(0, dtype=torch.int32)
    in_vain = NameTable(("mug",), torch.tensor([0.1]), none, none, none.float())
    field.thing_table = replace(things, names=in_vain)
    field.save(tmp_path / "named.scoup", overwrite=True)
    archive.add(field)
    assert_answers_are_those_of(archive.find("lamp"), {"named": field}, "lamp")


def test_scans_and_things_are_chosen_by_their_columns(archive: scoup.Archive) -> None:
    found = archive.find("lamp", where="floor >= 1 and city = 'Graz'")
    assert {each.scan for each in found} == {"kitchen", "hall"}
    assert found[0].columns == {"floor": int(found[0].scan == "hall") + 1, "city": "Graz"}
    assert archive.find("lamp", where="gaussians > 1000") == []
    assert {each.scan for each in archive.find("mug", at_least=3)} == {"kitchen"}
    assert [each.scan for each in archive.find("mug", at_least=2)] == ["kitchen"] * 3 + ["office"] * 2
    assert len(archive.find("mug", at_least=2, top=1)) == 3
    assert archive.find("mug", at_least=4) == []
    both = archive.find("mug and lamp", at_least=1)
    assert {(each.scan, each.thing) for each in both} == {
        (each.scan, each.thing) for each in archive.find("how many mugs and lamps", top=1000)
    }
    assert {each.text for each in both} == {"mug", "lamp"}
    assert len(found[0].field()) == len(LanguageField.load(found[0].field_path))


@pytest.mark.parametrize(
    "where",
    ["storey = 2", "true; DROP TABLE things", "(SELECT count(*) FROM read_text('/etc/hostname')) > 0", ""],
)
def test_a_condition_reads_this_folder_and_nothing_else(archive: scoup.Archive, where: str) -> None:
    with pytest.raises(InputError, match="condition"):
        archive.find("mug", where=where)


def test_a_scan_is_replaced_and_removed(
    archive: scoup.Archive, fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    before = archive.find("mug")
    archive.add(fields["office"], floor=7)
    assert archive.scans()["office"].columns == {"floor": 7}
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
        ({"embedding_model": MODEL}, ""),
    ):
        field.info = replace(field.info, **change)
        field.save(tmp_path / "new.scoup", overwrite=True)
        if said:
            with pytest.raises(InputError, match=said):
                archive.add(field)
        else:
            archive.add(field)
    for columns in ({"thing": 1}, {"Floor": 1}, {"x; drop": 1}, {"floor": [1]}):
        with pytest.raises(InputError, match="column"):
            archive.add(fields["hall"], **columns)  # pyright: ignore[reportArgumentType]
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


def test_a_field_that_left_or_changed_answers_no_phrase(
    fields: dict[str, LanguageField], tmp_path: Path
) -> None:
    archive, path = scoup.Archive(tmp_path / "a"), tmp_path / "moved.scoup"
    field = planted_room()
    field.info = replace(field.info, embedding_model=MODEL, words=fields["office"].info.words)
    field.save(path)
    archive.add(path)
    assert archive.find("mug left of the laptop")
    assert field.thing_table is not None
    field.thing_table = replace(field.thing_table, embeddings=field.thing_table.embeddings.flip(0))
    field.save(path, overwrite=True)
    with pytest.warns(ScoupWarning, match="has changed since"):
        assert archive.find("mug left of the laptop") == []
    path.unlink()
    with pytest.warns(ScoupWarning, match=r"moved\.scoup: cannot be asked"):
        assert archive.find("mug left of the laptop") == []
    assert archive.find("mug")


def test_a_page_has_no_pictures_of_what_is_gone(fields: dict[str, LanguageField], tmp_path: Path) -> None:
    path = Path(shutil.copy(str(fields["office"].path), tmp_path / "moved.scoup"))
    archive = scoup.Archive(tmp_path / "a", fields["office"].text_encoder())
    archive.add(path)
    found = archive.find("mug")
    moved = [replace(found[0], position=found[0].position + 1), replace(found[1], thing=999)]
    with pytest.warns(ScoupWarning, match="has changed"):
        assert "<img" not in results_page("mug", moved, tmp_path / "page.html")
    path.unlink()
    with pytest.warns(ScoupWarning, match=r"no pictures of the scan moved: .*moved\.scoup"):
        page = results_page("<mug>", found, tmp_path / "page.html")
    assert ("<img" not in page, page.count("<li>"), "<h1>&lt;mug&gt;</h1>" in page) == (True, 2, True)


def test_an_image_finds_what_looks_like_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("transformers", reason="transformers is not installed")
    from tiny_models import saved, tiny_clip

    model = str(saved(tiny_clip(), tmp_path / "model"))
    embedder = open_image_model(model)
    monkeypatch.setattr(planted, "DIM", embedder.dim)
    monkeypatch.chdir(tmp_path)
    field = planted_room()
    assert field.thing_table is not None
    vectors = field.thing_table.embeddings.clone()
    for thing in (LAMP, MUG, BALL):
        pixels = smooth_image(32, 32, thing)
        Image.fromarray(pixels).save(f"{thing}.png")
        vectors[thing] = embedder.embed(torch.from_numpy(pixels)[None])[0]
    field.thing_table = replace(field.thing_table, embeddings=vectors)
    field.info = replace(field.info, embedding_model=model)
    field.save("a.scoup")
    encoder = field.text_encoder()
    archive = scoup.Archive("a", encoder)
    archive.add(field, floor=1)
    for thing in (LAMP, MUG, BALL):
        found = archive.find_image(f"{thing}.png", top=3)
        assert (found[0].thing, len(found), found[0].text) == (thing, 3, f"{thing}.png")
        assert found[0].score == pytest.approx(1, abs=2e-3)
    assert [each.thing for each in archive.find_image(f"{BALL}.png", "thing > 3", 1)] == [BALL]
    assert archive.find_image(f"{LAMP}.png", "floor = 2") == []
    save_table("words.npz", encoder.names or (), encoder.encode(encoder.names or ()).numpy())
    printed = run_json("archive", "a", "--image", f"{MUG}.png", "--top", "2", "--text", "words.npz")
    wanted = [each.to_dict() for each in archive.find_image(f"{MUG}.png", top=2)]
    assert printed["things"] == wanted
    tool, image = archive_tool(archive), base64.b64encode(Path(f"{MUG}.png").read_bytes()).decode()
    told = tool(image=image, limit=2)["things"]
    assert [each["thing"] for each in told] == [each["thing"] for each in wanted]
    no_picture = "^`image` is not a JPEG or PNG; pass a picture in base64$"  # without a path
    for arguments, said in (
        ({"image": "?"}, no_picture),
        ({"image": "aaaa"}, no_picture),
        ({"image": image[:400]}, no_picture),
        ({"image": image, "text": "mug"}, "without `image`"),
        ({"image": "", "text": "mug"}, "without `image`"),
        ({"image": ""}, "expected an image or a text"),
        ({}, "expected an image or a text"),
    ):
        with pytest.raises(InputError, match=said):
            tool(**arguments)
    # What a lamp is a part of, and its parts, are left out.
    ((block, number),) = archive._kept.places().values()
    scan = archive._kept.scan(block, number)
    for pair in ((LAMP, MUG), (MUG, LAMP)):
        shares = scan.shared.to_dense()
        shares[pair] = shares[pair[::-1]] = scan.counts[pair[0]] * 0.6
        sizes = scan.counts.clone()
        sizes[pair[1]] *= 10
        nested = replace(scan, shared=shares.to_sparse().coalesce(), counts=sizes)
        things = [thing for thing, _ in ImageSearch("", vectors[LAMP].float()).ask(nested).things()]
        assert (LAMP in things, MUG in things, BALL in things) == (True, False, True)


def test_an_image_needs_an_embedder_of_images(
    archive: scoup.Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    Image.new("RGB", (20, 30)).save(path)
    with pytest.raises(InputError, match=r"some/model .*embeds no image here .*cannot be loaded"):
        archive.find_image(path)
    monkeypatch.setattr("scoup.extract.registry.open_embedder", lambda name: PlainColors())
    with pytest.raises(InputError, match=r"32 dimensions.*embeds no image here \(it has 72 dimensions"):
        archive.find_image(path)
    with pytest.raises(InputError, match="contains no scan"):
        scoup.Archive(tmp_path / "nothing").find_image(path)
    with pytest.raises(InputError, match="`top`"):
        archive.find_image(path, top=0)


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


def test_other_words_give_the_answers_of_the_fields(
    archive: scoup.Archive, fields: dict[str, LanguageField]
) -> None:
    """Statistics of the words that were known when scans were added are not used for others."""
    known = fields["office"].text_encoder()
    assert known.names is not None
    names = [name for name in known.names if name != "word 3"]
    fewer = dict(zip(names, known.encode(names), strict=True))
    found = scoup.Archive(archive.folder, fewer).find("mug", where="scan = 'office'")
    field = LanguageField.load(archive.scans()["office"].field_path)
    field.text_encoder(fewer)
    assert [(each.thing, each.score) for each in found] == [
        (thing.number, thing.score) for thing in field.things("mug")
    ]


def test_the_verb(fields: dict[str, LanguageField], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    paths = [field.path for field in fields.values()]
    added = run_json("archive", "a", "--add", *paths, "--set", "floor=2", "--set", "city=Graz")
    assert [each["scan"] for each in added["scans"]] == ["hall", "kitchen", "office"]
    assert added["scans"][0]["columns"] == {"floor": 2, "city": "Graz"}
    found = run_json("archive", "a", "mug", "--where", "floor = 2", "--top", "2")
    assert sum(found["scans"].values()) == len(found["things"]) == 2
    assert found["things"] == [each.to_dict() for each in scoup.Archive("a").find("mug", top=2)]
    assert run_json("archive", "a", "mug", "--at-least", "3")["scans"] == {"kitchen": 3}
    exported = paths[1].with_suffix(".html")  # pyright: ignore[reportOptionalMemberAccess]
    exported.touch()
    assert run("archive", "a", "mug", "--page", "found.html")[0] == 0
    page, mugs = Path("found.html").read_text(), scoup.Archive("a").find("mug")
    assert page.count("<li>") == len(mugs) > 5
    assert page.count('<img alt="" src="data:image/png;base64,') == len(mugs) - 1  # one is too far away
    links = [os.path.relpath(exported) + f"#thing={each.thing}" for each in mugs if each.scan == "kitchen"]
    assert re.findall('href="(.*?)"', page) == links
    assert "exists" in refused("archive", "a", "mug", "--page", "found.html")
    assert "--page" in refused("archive", "a", "--list", "--page", "b.html")
    code, out, _ = run("archive", "a", ABSENT)
    assert (code, out) == (0, f"{ABSENT}: nothing found\n")
    assert "kitchen: 16 things of" in run("archive", "a", "--list")[1]
    assert "pass one of" in refused("archive", "a", "mug", "--list")
    assert "different names" in refused("archive", "a", "--add", paths[0], paths[0])
    assert "NAME=VALUE" in refused("archive", "a", "--add", paths[0], "--set", "floor")
    assert "--top" in refused("archive", "a", "mug", "--top", "0")
    assert len(run_json("archive", "a", "--remove", "hall")["scans"]) == 2
    assert json.loads(Path("a/archive.json").read_text())["embedding_model"] == MODEL
