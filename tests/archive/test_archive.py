"""Archives: what answers in each scan is what its field answers."""

from __future__ import annotations

import base64
import fnmatch
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from PIL import Image

import scoup
from cli_support import refused, run, run_json
from mask_samples import smooth_image
from messages import refuses, warns
from query import planted_room as planted
from query.planted_room import ABSENT, ROOM, planted_room, with_whole
from query.test_named import BALL, LAMP, LAPTOP, MUG, names_of
from scoup.archive import list_scans
from scoup.archive.agent_tool import archive_tool
from scoup.archive.database import call, connect
from scoup.archive.found_things import FoundThing
from scoup.archive.page import results_page
from scoup.archive.search import Found, look_alikes, rank_of
from scoup.base import InputError, ScoupError, ScoupWarning
from scoup.field import NameTable
from scoup.models import WordTable
from scoup.models.image import open_image_model
from scoup.models.plain_colors import PlainColors
from scoup.query import LanguageField, ThingIndex, constants
from scoup.query.thing_judge import Shares, thing_index
from support import altered, table_of, unit

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")

Fields = dict[str, LanguageField]


def assert_answers_are_those_of(found: list[FoundThing], fields: Fields, question: str) -> None:
    for name, field in fields.items():
        mine = {each.thing: each for each in found if each.scan == name}
        things = field.things(question)
        assert set(mine) == {thing.number for thing in things}
        for thing in things:
            one = mine[thing.number or 0]
            for name in ("text", "score", "level", "n_gaussians"):
                assert getattr(one, name) == getattr(thing, name)
            assert torch.equal(one.position, thing.position)
            assert torch.equal(one.box.corners(), thing.box.corners())


def words_of(fields: Fields) -> dict[str, torch.Tensor]:
    """Words and their vectors, which all fields have."""
    encoder = fields["office"].encoder
    assert encoder.names is not None
    return dict(zip(encoder.names, encoder.encode(encoder.names), strict=True))


@pytest.fixture(scope="module")
def twenty(fields: Fields, tmp_path_factory: pytest.TempPathFactory) -> Fields:
    """Saved fields of twenty rooms: other boxes and doubtful things in each, wholes in some, names in some."""
    folder, made = tmp_path_factory.mktemp("twenty"), {}
    encoder = fields["office"].encoder
    for number in range(20):
        generator = torch.Generator().manual_seed(number)
        boxes = [box for box in ROOM if torch.rand(1, generator=generator) < 0.6] or [*ROOM]
        field, names = planted_room(boxes), [box.name for box in boxes] + [*planted.CLUTTER]
        if number % 3 == 0:
            field, _ = with_whole(field, range(min(2, len(boxes))))
            names.append(names[0])
        table, count = table_of(field), len(names)
        noise = torch.randn(count, planted.DIM, generator=generator) * 0.08
        voted = {"mug": {0: 0.6, 1: 0.5}, "lamp": {count - 1: 0.4}, ABSENT: {}}
        table = replace(
            table,
            embeddings=unit(encoder.encode(names) + noise).half(),
            n_regions=torch.randint(1, 9, (count,), generator=generator).int(),
            stability=torch.rand(count, generator=generator),
            agreement=0.7 + 0.3 * torch.rand(count, generator=generator),
            names=names_of(voted, float(torch.rand(1, generator=generator))) if number % 5 == 0 else None,
        )
        info = replace(field.info, embedding_model="some/model")
        field = field.changed(field.gaussians, thing_table=table, info=info).with_encoder(encoder)
        field.save(folder / f"room {number}.scoup")
        made[f"room {number}"] = field
    return made


@pytest.fixture(scope="module")
def many(twenty: Fields, tmp_path_factory: pytest.TempPathFactory) -> scoup.Archive:
    made = scoup.Archive(tmp_path_factory.mktemp("many"), next(iter(twenty.values())).encoder)
    for field in twenty.values():
        made.add(field)
    return made


@pytest.mark.parametrize(("question", "scans"), [
    ("mug", range(12, 20)), ("lamp", range(8, 20)), ("apple", range(8, 21)), (ABSENT, range(1, 12)),
    ("mug or ball", range(12, 21)), ("mug and lamp", range(1, 20)), ("pen left of the laptop", range(1, 12)),
    ("word 3", range(1, 20)), ("mugs", range(12, 20)), ("pen or largest mug on the table", range(4, 21)),
])  # fmt: skip
def test_twenty_scans_answer(many: scoup.Archive, twenty: Fields, question: str, scans: range) -> None:
    """What is found is what the fields answer, the best ones first."""

    @cache
    def leads(scan: str, text: str) -> torch.Tensor:
        asked = twenty[scan].question(text)
        index = thing_index(twenty[scan], asked)
        assert index is not None
        return index.leads(index.fits(asked.queries))

    found = many.find(question, top=10_000)
    assert len({each.scan for each in found}) in scans
    assert_answers_are_those_of(found, twenty, question)
    ordered = [rank_of([each.score], leads(each.scan, each.text)[each.thing])[0] for each in found]
    assert ordered == sorted(ordered, reverse=True)
    for top in (1, 3):
        best = [(each.scan, each.thing) for each in many.find(question, top=top)]
        assert best == [(each.scan, each.thing) for each in found[:top]]


def test_things_are_counted_as_in_the_fields(archive: scoup.Archive, fields: Fields, tmp_path: Path) -> None:
    places = torch.arange(len(fields["office"].gaussians))
    few = fields["office"][(places < 1000) | (places % 30 == 0)]  # later things keep less than ten Gaussians
    few.save(tmp_path / "few.scoup")
    archive.add(few)
    counts = {name: len(field.things()) for name, field in {**fields, "few": few}.items()}
    assert {scan.name: scan.things for scan in list_scans(archive.folder)} == counts
    assert 0 < counts["few"] < len(table_of(few))


def test_names_that_a_model_gave_answer_as_in_the_field(fields: Fields, tmp_path: Path) -> None:
    table = words_of(fields)
    table["beaker"] = unit(table["mug"] + 0.1 * table["ball"])  # near to a name
    votes = {"mug": {MUG: 0.6, BALL: 0.5}, "lamp": {BALL: 0.3}, ABSENT: {}, "pen": {LAPTOP: 0.3}}
    presence = {"mug": 0.9, "lamp": 0.9 * constants.LIKELY, ABSENT: 0.05, "pen": 0.05}
    archive, field = scoup.Archive(tmp_path / "a", table), planted_room()
    archive.add(fields["hall"])
    things = replace(table_of(fields["office"]), names=names_of(votes, presence))
    info = replace(field.info, embedding_model="some/model")
    field = altered(field, thing_table=things, info=info, words=table)
    field.save(tmp_path / "named.scoup")
    archive.add(field)
    # Without the names, "mug" would find the other, too.
    asked = {"mug": {MUG}, "beaker": {MUG}, "lamp": {LAMP}, ABSENT: set(), "pen": set()}
    for question in (*asked, "mugs", "mug left of the laptop", "pen or lamp"):
        found = archive.find(question)
        assert_answers_are_those_of(found, {"named": field}, question)
        if question in asked:
            assert {each.thing for each in found if each.scan == "named"} == asked[question]
    assert archive.find("mug")[0].score == pytest.approx(field.answer("mug").score)
    none = torch.zeros(0, dtype=torch.int32)
    in_vain = NameTable(("mug",), torch.tensor([0.1]), none, none, none.float())
    field.thing_table = replace(things, names=in_vain)
    field.save(tmp_path / "named.scoup", overwrite=True)
    with warns(ScoupWarning):
        archive.find("lamp left of the ball")
    archive.add(field)
    assert_answers_are_those_of(archive.find("lamp"), {"named": field}, "lamp")


def test_scans_and_things_are_chosen_by_their_columns(archive: scoup.Archive, fields: Fields) -> None:
    found = archive.find("lamp", where="floor >= 1 and city = 'Graz'")
    assert {each.scan for each in found} == {"kitchen", "hall"}
    assert found[0].columns == {"floor": int(found[0].scan == "hall") + 1, "city": "Graz"}
    assert len(found[0].field()) == len(LanguageField.load(found[0].field_path))
    assert archive.find("lamp", where="gaussians > 1000") == []
    assert {each.scan for each in archive.find("mug", at_least=3)} == {"kitchen"}
    for question in ("mug", "mug or lamp", "mug and lamp"):
        things = {name: field.things(question) for name, field in fields.items()}
        enough = [name for name in sorted(things) if len(things[name]) >= 2]
        enough.sort(key=lambda name: -len(things[name]))
        found = [(each.scan, each.thing) for each in archive.find(question, at_least=2)]
        assert found == [(name, thing.number) for name in enough for thing in things[name]]
        most = len(things[enough[0]]) if enough else 0
        assert len(archive.find(question, at_least=2, top=1)) == most
        assert archive.find(question, at_least=most + 1) == []


def test_a_condition_reads_this_folder_and_nothing_else(archive: scoup.Archive) -> None:
    for where in (
        "true; DROP TABLE things", "(SELECT count(*) FROM read_text('/etc/hostname')) > 0", "",
        "(SELECT count(*) FROM (COPY things TO 'a.csv')) > 0", "error('\\0') = 1", "\ud800 = 1",
    ):  # fmt: skip
        with pytest.raises(InputError, match="condition"):
            archive.find("mug", where=where)


def test_the_name_of_the_folder_is_no_pattern(archive: scoup.Archive, fields: Fields) -> None:
    other = shutil.copytree(
        archive.folder, archive.folder.with_name("scans")
    )  # which DuckDB would read instead
    for file in other.iterdir():
        file.write_bytes(b"damaged")
    assert fnmatch.fnmatch(str(other), str(archive.folder))
    assert_answers_are_those_of(archive.find("mug", where="floor >= 0"), fields, "mug")
    assert {scan.name for scan in list_scans(archive.folder)} == {*fields}
    archive.add(fields["kitchen"])
    assert_answers_are_those_of(scoup.Archive(archive.folder).find("mug"), fields, "mug")


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize(("where", "reason"), [
    ("(SELECT count(*) FROM range(20000000000000)) > 0", "more than 2 seconds"),
    ("list_sum(list_transform(range(3000), lambda x: x + length(repeat('x', 400000000)))) > 0", "more than 2 seconds"),
    ("list_sum(range(4000000000)) > 0", "memory"),
])  # fmt: skip
def test_a_condition_takes_so_much_and_no_more(archive: scoup.Archive, where: str, reason: str) -> None:
    archive = scoup.Archive(archive.folder, where_seconds=2)
    with pytest.raises(InputError, match=f"cannot be used: .*{reason}"):
        archive.find("mug", where=where)


def test_errors_of_duckdb_are_ours(archive: scoup.Archive) -> None:
    connection = connect()
    connection.execute("SET memory_limit = '20MB'")
    connection.execute("SET temp_directory = ''")
    for query, error in (
        ("SELECT list(range::VARCHAR || 'x') FROM range(9000000)", ScoupError),
        ("SELECT 1 +", InputError),
        ("COPY (SELECT 1) TO '/nowhere/a.parquet' (FORMAT parquet)", FileNotFoundError),
    ):
        with pytest.raises(error):
            call(connection, query)
    room = Path(str(scoup.archive.__file__)).parent
    users = [path.name for path in room.glob("*.py") if "import duckdb" in path.read_text(encoding="utf-8")]
    assert users == ["database.py"]


def test_a_field_that_left_or_changed_answers_no_phrase(fields: Fields, tmp_path: Path) -> None:
    archive, paths = scoup.Archive(tmp_path / "a"), [tmp_path / "one.scoup", tmp_path / "two.scoup"]
    field, phrase = planted_room(), "mug left of the laptop"
    field.info = replace(field.info, embedding_model="some/model", words=fields["office"].info.words)
    for path in paths:
        field.save(path)
        archive.add(path)
    assert {each.scan for each in archive.find(phrase)} == {"one", "two"}
    things = table_of(field)
    field.thing_table = replace(things, embeddings=things.embeddings.flip(0))
    field.save(paths[0], overwrite=True)
    with warns(ScoupWarning):
        assert {each.scan for each in archive.find(phrase)} == {"two"}
    paths[1].unlink()
    for at_least in (None, 1):
        with warns(ScoupWarning), refuses():
            archive.find(phrase, at_least=at_least)
    archive.remove("one")
    assert "is gone" in refused("archive", archive.folder, phrase, folder=tmp_path)
    assert {each.scan for each in archive.find("mug")} == {"two"}


def test_a_page_has_no_pictures_of_what_is_gone(fields: Fields, tmp_path: Path) -> None:
    path = Path(shutil.copy(str(fields["office"].path), tmp_path / "moved.scoup"))
    archive = scoup.Archive(tmp_path / "a", fields["office"].encoder)
    archive.add(path)
    found = archive.find("mug")
    moved = [replace(found[0], position=found[0].position + 1), replace(found[1], thing=999)]
    with warns(ScoupWarning):
        assert "<img" not in results_page("mug", moved, tmp_path / "page.html")
    path.unlink()
    with warns(ScoupWarning):
        page = results_page("<mug>", found, tmp_path / "page.html")
    assert ("<img" not in page, page.count("<li>"), "<h1>&lt;mug&gt;</h1>" in page) == (True, 2, True)


def test_other_words_give_the_answers_of_the_fields(archive: scoup.Archive, fields: Fields) -> None:
    """Statistics of the words that were known when scans were added are not used for others."""
    fewer = words_of(fields)
    del fewer["word 3"]
    found = scoup.Archive(archive.folder, fewer).find("mug", where="scan = 'office'")
    field = LanguageField.load(archive.scans()["office"].field_path, words=fewer)
    assert_answers_are_those_of(found, {"office": field}, "mug")


def test_an_image_finds_what_looks_like_it(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("transformers", reason="transformers is not installed")
    from tiny_models import saved, tiny_clip

    model = str(saved(tiny_clip(), tmp_path / "model"))
    embedder = open_image_model(model)
    monkeypatch.setattr(planted, "DIM", embedder.dim)
    monkeypatch.chdir(tmp_path)
    field = planted_room()
    vectors = table_of(field).embeddings.clone()
    for thing in (LAMP, MUG, BALL):
        pixels = smooth_image(32, 32, thing)
        Image.fromarray(pixels).save(f"{thing}.png")
        vectors[thing] = embedder.embed(torch.from_numpy(pixels)[None])[0]
    field.thing_table = replace(table_of(field), embeddings=vectors)
    field.info = replace(field.info, embedding_model=model)
    field.save("a.scoup")
    encoder = field.encoder
    archive = scoup.Archive("a", encoder)
    archive.add(field, floor=1)
    for thing in (LAMP, MUG, BALL):
        found = archive.find_image(f"{thing}.png", top=3)
        assert (found[0].thing, len(found), found[0].text) == (thing, 3, f"{thing}.png")
        assert found[0].score == pytest.approx(1, abs=2e-3)
        with Image.open(f"{thing}.png") as opened:
            by_pixels = archive.find_image(opened, top=3)
        for one, other in zip(found, by_pixels, strict=True):
            assert replace(other, text=one.text).to_dict() == one.to_dict()
    assert [each.thing for each in archive.find_image(f"{BALL}.png", "thing > 3", 1)] == [BALL]
    assert archive.find_image(f"{LAMP}.png", "floor = 2") == []
    WordTable.save("words.npz", encoder.names or (), encoder.encode(encoder.names or ()).numpy())
    printed = run_json("archive", "a", "--image", f"{MUG}.png", "--top", "2", "--text", "words.npz")
    wanted = archive.find_image(f"{MUG}.png", top=2)
    assert printed["things"] == [each.to_dict() for each in wanted]
    tool, image = archive_tool(archive), base64.b64encode(Path(f"{MUG}.png").read_bytes()).decode()
    assert [each["thing"] for each in tool(image=image, limit=2)["things"]] == [each.thing for each in wanted]
    wrong = [*({"image": each} for each in ("?", "aaaa", image[:400], "")), {}]
    for arguments in (*wrong, {"image": image, "text": "mug"}, {"image": "", "text": "mug"}):
        with refuses():
            tool(**arguments)


def test_parts_and_wholes_of_what_looks_alike_are_left_out() -> None:
    field = planted_room()
    index = ThingIndex.of(table_of(field), field.encoder.everyday())
    vector = field.encoder.encode(["lamp"])[0]
    every = torch.arange(len(index.counts))
    for pair in ((LAMP, MUG), (MUG, LAMP)):
        shared = index.shared(every, every >= 0, len(every))
        shared[pair] = shared[pair[::-1]] = index.counts[pair[0]] * 0.6
        sizes = index.counts.clone()
        sizes[pair[1]] *= 10
        rows, others = shared.nonzero(as_tuple=True)
        ends = torch.nn.functional.pad(rows.bincount(minlength=len(every)).cumsum(0), (1, 0))
        shares = Shares(ends, others.int(), shared[rows, others])
        nested = replace(index, shares=shares, counts=sizes)
        things = [found.thing for found in look_alikes(nested, vector, "", [every >= 0])]
        assert (LAMP in things, MUG in things, BALL in things) == (True, False, True)


def test_an_image_needs_an_embedder_of_images(archive: scoup.Archive, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.png"
    Image.new("RGB", (20, 30)).save(path)
    with pytest.raises(InputError, match=r"some/model .*embeds no image here .*cannot be loaded"):
        archive.find_image(path)
    monkeypatch.setattr("scoup.extract.open_embedder", lambda name: PlainColors())
    for asked, top in ((archive, 10), (scoup.Archive(tmp_path / "nothing"), 10), (archive, 0)):
        with refuses():
            asked.find_image(path, top=top)


def test_the_verb(fields: Fields, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    paths = [field.path for field in fields.values()]
    added = run_json("archive", "a", "--add", *paths, "--set", "floor=2", "--set", "city=Graz")
    assert [each["scan"] for each in added["scans"]] == ["hall", "kitchen", "office"]
    assert added["scans"][0]["columns"] == {"floor": 2, "city": "Graz"}
    found = run_json("archive", "a", "mug", "--where", "floor = 2", "--top", "2")
    assert sum(found["scans"].values()) == len(found["things"]) == 2
    assert found["things"] == [each.to_dict() for each in scoup.Archive("a").find("mug", top=2)]
    assert "the best of 5; best first" in run("archive", "a", "mug", "--top", "2")[1]
    assert run_json("archive", "a", "mug", "--at-least", "3")["scans"] == {"kitchen": 3}
    exported = paths[1].with_suffix(".html")  # pyright: ignore[reportOptionalMemberAccess]
    exported.touch()
    assert run("archive", "a", "mug", "--page", "found.html")[0] == 0
    page, mugs = Path("found.html").read_text(), scoup.Archive("a").find("mug")
    assert page.count("<li>") == len(mugs) == 5  # all that there are
    assert page.count('<img alt="" src="data:image/png;base64,') == len(mugs)
    links = [os.path.relpath(exported) + f"#thing={each.thing}" for each in mugs if each.scan == "kitchen"]
    assert re.findall('href="(.*?)"', page) == links
    assert "exists" in refused("archive", "a", "mug", "--page", "found.html")
    code, out, _ = run("archive", "a", ABSENT)
    assert (code, out) == (0, f"{ABSENT}: nothing found\n")
    scoup.Archive("a").add(fields["kitchen"], city="Graz\nhall: 99 things")
    assert "kitchen: 16 things of" in (listed := run("archive", "a", "--list")[1])
    assert len(listed.splitlines()) == 4
    assert len(run_json("archive", "a", "--remove", "hall")["scans"]) == 2
    assert json.loads(Path("a/archive.json").read_text())["embedding_model"] == "some/model"


def test_doubtful_answers_are_marked_and_folded(
    archive: scoup.Archive, fields: Fields, monkeypatch: pytest.MonkeyPatch
) -> None:
    for question in ("mug", "mug left of the laptop"):
        for thing in archive.find(question):
            assert thing.certainty == fields[thing.scan].answer("mug").certainty == "sure"
    monkeypatch.setattr(constants, "SURE", 2.0)
    monkeypatch.setattr(constants, "LIKELY", 2.0)
    lines = run("archive", archive.folder, "mug")[1].splitlines()
    assert lines[0].startswith("5 are doubtful: kitchen (thing ")
    assert len(lines) == 2
    page = results_page("mug", archive.find("mug"), archive.folder / "found.html")
    assert page.index("<li>") > page.index("<summary>5 doubtful</summary>")


def test_a_condition_that_cannot_be_used_says_what_can(archive: scoup.Archive) -> None:
    for where in ("room = 2", "floor =", "floor + scan > 2", "no_such_function(floor)", "city::INTEGER > 2"):
        with refuses() as error:
            archive.find("mug", where=where)
        assert "columns are scan, thing, row" in str(error.value)


def test_scans_that_may_have_better_things_are_asked(archive: scoup.Archive) -> None:
    """One good thing is not enough to leave out a batch that is better than the last of the best."""

    class Batches:
        def batches(self) -> Iterator[tuple[float, Callable[[], list[Found]]]]:
            for bound, ranks in ((1.0, (0.9, 0.2)), (0.5, (0.4,)), (0.3, (0.25,))):
                yield bound, lambda ranks=ranks: [Found(0, 0, "mug", None, rank) for rank in ranks]

    found, count = archive._answers(cast(Any, Batches()), {0: None}, 2)
    assert [answer.rank for answer in found] == [0.9, 0.4]
    assert count is None  # the last scan was not asked
