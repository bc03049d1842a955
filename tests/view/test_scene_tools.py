"""Tools for language models: the calls, and the server with the protocol's own client."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import anyio
import numpy as np
import pytest
from PIL import Image

from cli_support import run, write_scene
from query.planted_room import CLUTTER, ROOM, planted_room
from query.test_named import BALL, LAMP, MUG, named_room
from scoup.archive import Archive, archive_tool
from scoup.base import InputError, ScoupError
from scoup.field import read_facts
from scoup.io import load_gaussians
from scoup.query import LanguageField, overlaps
from scoup.view.scene_tools import MOST_MARKED, WIDEST, SceneTools
from scoup.view.viewed_field import ViewedField


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("agent")
    write_scene(place / "scene")
    table = place / "scene" / "words.npz"
    options = ("--n-atoms", "8", "--model", table)
    code, _, err = run("build", place / "scene", *options, "--out", place / "f.scoup")
    assert code == 0, err
    return place


@pytest.fixture(scope="module")
def tools(folder: Path) -> SceneTools:
    return SceneTools({"f": LanguageField.load(folder / "f.scoup")}, folder / "out", 0.5)


@pytest.mark.parametrize("words", [(), ("lamp", "mug", "laptop")])
def test_page_catalogue_and_agents_give_things_one_name(words: tuple[str, ...]) -> None:
    field = named_room({"ball": {LAMP: 0.5}, "pen": {MUG: 0.01}, "Tiffany": {BALL: 0.6}})
    every = field.naming_question(words)
    places = [
        {thing.number: thing.text for thing in field.catalog(every).things},
        {row["number"]: row["name"] or "" for row in ViewedField(field, words=words).things()},
        {
            row["thing"]: row["text"]
            for row in SceneTools({"f": field}, words=words).list_things("f")["things"]
        },
    ]
    assert places[0] == places[1] == places[2]
    # Votes for a word that the encoder lacks, or a list leaves out, do not count: nobody could ask for it.
    expected = ("lamp", "mug", "") if words else ("ball", "pen", "")
    assert tuple(places[0][number] for number in (LAMP, MUG, BALL)) == expected


def test_replies_are_those_of_the_field(tools: SceneTools, folder: Path):
    field = tools.fields["f"]
    scene = tools.list_scenes()[0]
    assert (scene["scene"], scene["gaussians"], scene["cameras"]) == ("f", 150, 4)
    assert scene["things"] == len(field.things()) == read_facts(folder / "f.scoup")["things"]
    assert [each["camera"] for each in tools.list_cameras("f")] == [
        camera.name for camera in field.cameras or ()
    ]
    things = field.things()
    listed = tools.list_things("f", limit=200)
    assert len(listed["things"]) == len(things) > 1
    assert {one["thing"] for one in listed["things"]} == {thing.number for thing in things}
    assert (listed["more"], tools.list_things("f", limit=1)["more"]) == (0, len(things) - 1)
    assert len(json.dumps(listed["things"])) < 160 * len(things)
    graph = tools.describe_scene("f", limit=200)
    catalog = field.catalog(["kettle", "mug", "wooden table"])
    assert {each["thing"] for each in graph["things"]} == set(catalog.objects)
    assert {each["thing"]: each["text"] for each in graph["things"]}.items() <= {
        each["thing"]: each["text"] for each in listed["things"]
    }.items()
    for part in things:
        around = {each["thing"] for each in tools.describe_scene("f", part.number)["things"]}
        alike = {each.number for each in things if overlaps(part, each)}
        assert around & alike == {part.number}, "nothing is on or in its own whole"
    level = things[0].level
    assert {one["level"] for one in tools.list_things("f", level)["things"]} == {level}
    one, other = things[0], things[1]
    assert tools.describe_thing("f", one.number or 0)["gaussians"] == one.n_gaussians
    measured = tools.measure_distance("f", one.number or 0, other.number or 0)
    assert measured["distance"] == pytest.approx(float((one.position - other.position).norm()), rel=1e-4)
    assert measured["metres"] == pytest.approx(measured["distance"] / 2, rel=1e-3)
    found = tools.find("f", "kettle")
    assert [each["thing"] for each in found["things"]] == list(field.answer("kettle").things)
    for text, asked in (
        ("kettle", ["kettle"]),
        ("kettles", ["kettles"]),
        ("kettle on the mug", ["kettle", "mug"]),
    ):
        records = [field.answer(each).to_dict() for each in asked]
        kept = ("score", "certainty", "runner_up")
        wanted = [
            {"text": each, **{name: one[name] for name in kept}}
            for each, one in zip(asked, records, strict=True)
        ]
        assert tools.find("f", text)["texts"] == wanted
        assert wanted[0]["runner_up"] is not None
    assert found["frame"]["up"] == field.frame().to_dict()["up"]
    assert found["frame"]["units"] == "scene, of 0.5 metres"
    assert "splat" in found["frame"]["axes"]


def test_a_scene_is_described_as_a_graph():
    """Of the room: table, two mugs, laptop, lamp, ball, bowl, apple, and a pen that touches nothing known."""
    tools = SceneTools({"room": planted_room()})
    graph = tools.describe_scene("room")
    assert len(graph["things"]) == len(ROOM) + len(CLUTTER)
    assert {each["thing"]: each["on"] for each in graph["things"] if "on" in each} == {
        number: [0] for number in (1, 2, 3, 6)
    }
    assert [each for each in graph["things"] if "inside" in each] == [
        {"thing": 7, "text": "apple", "certainty": "sure", "inside": [6]}
    ]
    around = {number: tools.describe_scene("room", number)["things"] for number in (0, 4, 6)}
    assert around[4] == [{"thing": 4, "text": "lamp", "certainty": "sure"}]
    assert around[0][0] == {"thing": 0, "text": "table", "certainty": "sure"}
    assert {each["thing"] for each in around[0][1:]} == {1, 2, 3, 6}
    assert {each["thing"] for each in around[6]} == {6, 0, 7}
    assert tools.describe_scene("room", limit=1)["more"] == len(graph["things"]) - 1
    listed = SceneTools(tools.fields, words=("bowl", "ball")).list_things("room")["things"]
    assert {each["text"]: each["thing"] for each in listed if each["text"]} == {"bowl": 6, "ball": 5}


def test_a_view_marks_things(tools: SceneTools):
    plain = tools.render_view("f")
    field = tools.fields["f"]
    assert plain.shape[:2] == (field.camera(0).height, field.camera(0).width)
    seen = [thing.number for thing in field.things() if thing.number is not None][:MOST_MARKED]
    assert bool((tools.render_view("f", things=seen) != plain).any())
    assert max(plain.shape) <= WIDEST


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda tools: tools.find("nowhere", "kettle"), "no scene named 'nowhere'"),
        (lambda tools: tools.find("f", ""), "expected 1 to"),
        (lambda tools: tools.find("f", "x" * 100_000), "expected 1 to"),
        (lambda tools: tools.find("f", "kettle opposite the mug"), "known relations"),
        (lambda tools: tools.find("f", "kettle", limit=10**9), "limit"),
        (lambda tools: tools.find("f", "kettle", seen_from="x"), "'x'"),
        (lambda tools: tools.list_things("f", "z"), "no level"),
        (lambda tools: tools.describe_thing("f", -1), "no thing -1"),
        (lambda tools: tools.describe_scene("f", 10**9), "no thing 10"),
        (lambda tools: tools.measure_distance("f", 0, 10**12), "no thing"),
        (lambda tools: tools.render_view("f", things=list(range(MOST_MARKED + 1))), "at most"),
        *(
            (lambda tools, name=name: tools.export_selection("f", "kettle", name), "expected a plain name")
            for name in ("../x.ply", "/etc/x", "a/b", "", ".ply", "x\0y", "C:x", "A.PLY", "x" * 300)
        ),
    ],
)
def test_hostile_arguments_are_refused(tools: SceneTools, call: Any, said: str):
    with pytest.raises(ScoupError, match=said):
        call(tools)
    assert tools.export_folder is not None
    assert not [path for path in tools.export_folder.rglob("*") if path.suffix != ".ply"]


def test_exports_are_new_files_of_one_folder(tools: SceneTools, folder: Path):
    answer = tools.fields["f"].select("kettle or mug or wooden table")
    if not bool(answer.mask.any()):
        pytest.fail("the scene of this test has something to export")
    reply = tools.export_selection("f", "kettle or mug or wooden table", "found")
    assert len(load_gaussians(folder / "out" / reply["file"])) == reply["gaussians"] == int(answer.mask.sum())
    (folder / "out" / "link.ply").symlink_to("nowhere.ply")
    for taken in ("found.ply", "link"):
        with pytest.raises(InputError, match="already exists; choose another name"):
            tools.export_selection("f", "kettle or mug or wooden table", taken)
    with pytest.raises(InputError, match="writes no files"):
        SceneTools(tools.fields).export_selection("f", "kettle", "a")


MISTAKES: list[tuple[str, dict[str, Any], str]] = [
    ("find", {"text": "mug", "limit": "many"}, "limit: expected int, got 'many'"),
    ("find", {}, "text: expected str, got none"),
    ("find", {"text": "mug", "most": 3}, "find: unknown argument 'most'; known: scene, text, seen_from, limit"),
    (
        "find", {"text": "ketle"},
        "find: words.npz: no text embedding named 'ketle'; nearest names: 'kettle', 'texture', 'wooden table', "
        "'object', 'stuff'",
    ),
    ("describe_thing", {"thing": 9999},
     "describe_thing: there is no thing 9999; list_things names those of the scene"),
]  # fmt: skip


def test_the_server_speaks_to_the_official_client(tools: SceneTools, folder: Path):
    mcp = pytest.importorskip("mcp", reason="the package mcp is not installed")
    from scoup.view.mcp_server import make_server

    archive = Archive(folder / "archive")
    archive.add(folder / "f.scoup", floor=2)
    server = make_server(SceneTools(tools.fields), [archive_tool(archive)])

    async def talk() -> list[Any]:
        async with mcp.Client(server) as client:
            names = sorted(tool.name for tool in (await client.list_tools()).tools)
            found = await client.call_tool("find", {"scene": "f", "text": "kettles"})
            said = []
            for tool, arguments, _ in MISTAKES:
                reply = await client.call_tool(tool, {"scene": "f", **arguments})
                assert reply.is_error
                said.append(reply.content[0].text)
            asked = {"text": "kettle", "where": "floor = 2"}
            archived = await client.call_tool("find_in_archive", asked)
            picture = await client.call_tool("render_view", {"scene": "f"})
            return [names, found, said, archived, picture]

    names, found, said, archived, picture = anyio.run(talk)
    reading = [
        "describe_scene",
        "describe_thing",
        "find",
        "find_in_archive",
        "list_cameras",
        "list_scenes",
        "list_things",
        "measure_distance",
    ]
    assert names == [*reading, "render_view"]  # no exports without a folder
    expected = LanguageField.load(folder / "f.scoup").things("kettles")
    assert [each["thing"] for each in json.loads(found.content[0].text)["things"]] == [
        thing.number for thing in expected
    ]
    assert [text.removeprefix("Error executing tool ") for text in said] == [text for _, _, text in MISTAKES]
    kettles = archive.find("kettle")
    records = json.loads(archived.content[0].text)["things"]
    assert [{**each, "field": str(folder / "f.scoup")} for each in records] == [
        each.to_dict() for each in kettles
    ]
    assert not any("field" in each for each in records)
    image = Image.open(io.BytesIO(base64.b64decode(picture.content[0].data)))
    assert np.asarray(image).shape[2] == 3


def test_errors_name_no_folders(tools: SceneTools, folder: Path):
    mcp = pytest.importorskip("mcp", reason="the package mcp is not installed")
    from scoup.view.mcp_server import make_server

    def broken() -> None:
        raise InputError(
            f"{folder / 'out' / 'a.ply'}: is not {tools.fields['f'].path}, and/or https://a.b/c/d"
        )

    async def talk() -> Any:
        async with mcp.Client(make_server(tools, [broken])) as client:
            return (await client.call_tool("broken", {})).content[0].text

    said = anyio.run(talk)
    assert said == "Error executing tool broken: a.ply: is not f.scoup, and/or https://a.b/c/d"


def test_errors_say_that_a_table_is_missing(tmp_path: Path, folder: Path):
    mcp = pytest.importorskip("mcp", reason="the package mcp is not installed")
    from scoup.view.mcp_server import make_server

    field = LanguageField.load(folder / "f.scoup", words=tmp_path / "my words" / "gone.npz")
    server = make_server(SceneTools({"f": field}))

    async def talk() -> list[str]:
        async with mcp.Client(server) as client:
            replies = [await client.call_tool("find", {"scene": scene, "text": "kettle"}) for scene in "fg"]
            return [reply.content[0].text.removeprefix("Error executing tool find: ") for reply in replies]

    missing, unknown = anyio.run(talk)
    assert missing.startswith("gone.npz: ")
    assert unknown == "no scene named 'g'; nearest names: 'f'"
