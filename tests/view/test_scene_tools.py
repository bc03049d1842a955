"""Tools for language models: the calls, and the server with the protocol's own client."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import pytest
from PIL import Image

from cli_support import run_json, write_scene
from messages import check_message, refuses
from query.planted_room import CLUTTER, ROOM, planted_room
from query.test_named import BALL, LAMP, MUG, named_room
from scoup.archive import Archive, archive_tool
from scoup.base import InputError, ScoupError, WorldFrame
from scoup.field import read_facts
from scoup.io import load_gaussians
from scoup.query import LanguageField
from scoup.query.relations import overlaps
from scoup.view.scene_tools import MOST_MARKED, SceneTools
from scoup.view.viewed_field import ViewedField


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("agent")
    write_scene(place / "scene")
    table = place / "scene" / "words.npz"
    options = ("--n-atoms", "8", "--model", table)
    run_json("build", place / "scene", *options, "--out", place / "f.scoup")
    return place


@pytest.fixture(scope="module")
def tools(folder: Path) -> SceneTools:
    field = LanguageField.load(folder / "f.scoup").with_world(WorldFrame(0.5, name="map"))
    return SceneTools({"f": field}, folder / "out")


@pytest.mark.parametrize("words", [(), ("lamp", "mug", "laptop")])
def test_page_catalogue_and_agents_give_things_one_name(words: tuple[str, ...]) -> None:
    field = named_room({"ball": {LAMP: 0.5}, "pen": {MUG: 0.01}, "Tiffany": {BALL: 0.6}})
    every = field.naming_question(words)
    page, agents = ViewedField(field, words=words), SceneTools({"f": field}, words=words)
    names = {thing.number: thing.text for thing in field.catalog(every).things}
    assert {row["number"]: row["name"] or "" for row in page.things()} == names
    assert {row["thing"]: row["text"] for row in agents.list_things("f")["things"]} == names
    # Votes for a word that the encoder lacks, or a list leaves out, do not count: nobody could ask for it.
    expected = ("lamp", "mug", "") if words else ("ball", "pen", "")
    assert tuple(names[number] for number in (LAMP, MUG, BALL)) == expected


def test_replies_are_those_of_the_field(tools: SceneTools, folder: Path):
    field = tools.fields["f"]
    scene, things = tools.list_scenes()[0], field.things()
    assert (scene["scene"], scene["gaussians"], scene["cameras"]) == ("f", 150, 4)
    assert scene["things"] == len(things) == read_facts(folder / "f.scoup")["things"]
    cameras = [camera.name for camera in field.cameras or ()]
    assert [each["camera"] for each in tools.list_cameras("f")] == cameras
    listed = tools.list_things("f", limit=200)
    assert len(listed["things"]) == len(things) > 1
    names = {one["thing"]: one["text"] for one in listed["things"]}
    assert set(names) == {thing.number for thing in things}
    assert (listed["more"], tools.list_things("f", limit=1)["more"]) == (0, len(things) - 1)
    assert len(json.dumps(listed["things"])) < 160 * len(things)
    graph = {each["thing"]: each["text"] for each in tools.describe_scene("f", limit=200)["things"]}
    assert set(graph) == set(field.catalog(["kettle", "mug", "wooden table"]).objects)
    assert graph.items() <= names.items()
    for part in things:
        around = {each["thing"] for each in tools.describe_scene("f", part.number)["things"]}
        alike = {each.number for each in things if overlaps(part, each)}
        assert around & alike == {part.number}, "nothing is on or in its own whole"
    one, other = things[:2]
    assert {each["level"] for each in tools.list_things("f", one.level)["things"]} == {one.level}
    assert tools.describe_thing("f", one.number or 0)["gaussians"] == one.n_gaussians
    measured = tools.measure_distance("f", one.number or 0, other.number or 0)
    assert measured["distance"] == pytest.approx(float((one.position - other.position).norm()), rel=1e-4)
    assert measured["metres"] == pytest.approx(measured["distance"] / 2, rel=1e-3)
    # Of a phrase, the texts in it are judged.
    wanted = [{"text": text, **field.answer(text).to_dict()} for text in ("kettle", "mug")]
    wanted = [
        {name: each[name] for name in ("text", "score", "certainty", "count", "runner_up")} for each in wanted
    ]
    assert tools.find("f", "kettle on the mug")["texts"] == wanted
    frame = tools.find("f", "kettle")["frame"]
    assert (frame["up"], frame["metres_per_unit"]) == (field.frame().to_dict()["up"], 0.5)
    assert scene["frame"] == field.world.to_dict()
    for each in (
        *listed["things"],
        *tools.find("f", "kettle")["things"],
        tools.describe_thing("f", one.number or 0),
    ):
        assert len(each["position_metres"]) == len(each["extent_metres"]) == 3
    assert "splat" in frame["axes"]
    plain, marked = (tools.render_view("f", things=seen) for seen in ([], list(names)[:MOST_MARKED]))
    assert plain.shape[:2] == (field.camera(0).height, field.camera(0).width)
    assert bool((marked != plain).any())


def test_a_scene_is_described_as_a_graph():
    """Of the room: table, two mugs, laptop, lamp, ball, bowl, apple, and a pen that touches nothing known."""
    tools = SceneTools({"room": planted_room()})
    graph = tools.describe_scene("room")
    assert len(graph["things"]) == len(ROOM) + len(CLUTTER)
    on_table = {1, 2, 3, 6}
    on = {each["thing"]: each["on"] for each in graph["things"] if "on" in each}
    assert on == {thing: [0] for thing in on_table}
    apple = {"thing": 7, "text": "apple", "named_by": "embedding", "inside": [6]}
    assert [each for each in graph["things"] if "inside" in each] == [apple]
    around = {number: tools.describe_scene("room", number)["things"] for number in (0, 4, 6)}
    assert around[4] == [{"thing": 4, "text": "lamp", "named_by": "embedding"}]
    assert around[0][0] == {"thing": 0, "text": "table", "named_by": "embedding"}
    assert {each["thing"] for each in around[0][1:]} == on_table
    assert {each["thing"] for each in around[6]} == {6, 0, 7}
    assert tools.describe_scene("room", limit=1)["more"] == len(graph["things"]) - 1
    listed = SceneTools(tools.fields, words=("bowl", "ball")).list_things("room")["things"]
    assert {each["text"]: each["thing"] for each in listed if each["text"]} == {"bowl": 6, "ball": 5}


BAD_NAMES = ("../x.ply", "/etc/x", "a/b", "", ".ply", "x\0y", "C:x", "A.PLY", "x" * 300)
HOSTILE: list[tuple[Any, ...]] = [
    ("find", "nowhere", "kettle"),
    *(("find", "f", text) for text in ("", "x" * 100_000, "kettle opposite the mug")),
    ("find", "f", "kettle", "x"), ("find", "f", "kettle", None, 10**9), ("list_things", "f", "z"),
    ("describe_thing", "f", -1), ("describe_scene", "f", 10**9), ("measure_distance", "f", 0, 10**12),
    ("render_view", "f", None, list(range(MOST_MARKED + 1))),
    *(("export_selection", "f", "kettle", name) for name in BAD_NAMES),
]  # fmt: skip


def test_hostile_arguments_are_refused(tools: SceneTools):
    for name, *arguments in HOSTILE:
        with refuses(ScoupError):
            getattr(tools, name)(*arguments)
    assert tools.export_folder is not None
    assert not [path for path in tools.export_folder.rglob("*") if path.suffix != ".ply"]


def test_exports_are_new_files_of_one_folder(tools: SceneTools, folder: Path):
    text = "kettle or mug or wooden table"
    count = int(tools.fields["f"].select(text).mask.sum())
    reply = tools.export_selection("f", text, "found")
    assert len(load_gaussians(folder / "out" / reply["file"])) == reply["gaussians"] == count > 0
    (folder / "out" / "link.ply").symlink_to("nowhere.ply")
    for taken in ("found.ply", "link"):
        with refuses():
            tools.export_selection("f", text, taken)
    with refuses():
        SceneTools(tools.fields).export_selection("f", "kettle", "a")


MISTAKES: list[tuple[str, dict[str, Any]]] = [
    ("find", {"text": "mug", "limit": "many"}), ("find", {}), ("find", {"text": "mug", "most": 3}),
    ("find", {"text": "ketle"}), ("describe_thing", {"thing": 9999}),
]  # fmt: skip


@pytest.fixture
def connected() -> Callable[..., Any]:
    """A client of the official package to the server of some tools."""
    mcp = pytest.importorskip("mcp", reason="the package mcp is not installed")
    from scoup.view.mcp_server import make_server

    return lambda *tools: mcp.Client(make_server(*tools))


def test_the_server_speaks_to_the_official_client(tools: SceneTools, folder: Path, connected):
    archive = Archive(folder / "archive")
    archive.add(folder / "f.scoup", floor=2)

    def odd() -> dict[str, Any]:
        return {"odd": [float("nan"), float("inf"), 1.5, "\udcff"]}

    def wrong() -> None:
        raise InputError("\udcff\x1b: is damaged")

    async def talk() -> list[Any]:
        async with connected(SceneTools(tools.fields), [odd, wrong]) as client:
            said = [(await client.call_tool(name, {})).content[0].text for name in ("odd", "wrong")]
            assert json.loads(said[0])["odd"] == [None, None, 1.5, "\udcff"]
            assert said[1].endswith(r"\udcff\x1b: is damaged")
        async with connected(SceneTools(tools.fields), [archive_tool(archive)]) as client:
            names = sorted(tool.name for tool in (await client.list_tools()).tools)
            for tool, arguments in MISTAKES:
                reply = await client.call_tool(tool, {"scene": "f", **arguments})
                assert reply.is_error
                check_message(reply.content[0].text)
            asked = {
                "find": {"scene": "f", "text": "kettles"}, "render_view": {"scene": "f"},
                "find_in_archive": {"text": "kettle", "where": "floor = 2"},
            }  # fmt: skip
            return [names, *[(await client.call_tool(*call)).content[0] for call in asked.items()]]

    names, found, picture, archived = anyio.run(talk)
    assert " ".join(names) == (  # no exports without a folder
        "describe_scene describe_thing find find_in_archive list_cameras list_scenes list_things measure_distance "
        "render_view"
    )
    reply, things = json.loads(found.text), tools.fields["f"].things("kettles")
    assert [each["thing"] for each in reply["things"]] == [thing.number for thing in things]
    assert [each["text"] for each in reply["texts"]] == ["kettles"]
    records = json.loads(archived.text)["things"]
    assert not any("field" in each for each in records)
    wanted = [each.to_dict() for each in archive.find("kettle")]
    assert [{**each, "field": str(folder / "f.scoup")} for each in records] == wanted
    assert Image.open(io.BytesIO(base64.b64decode(picture.data))).mode == "RGB"


def test_errors_name_no_folders(tools: SceneTools, tmp_path: Path, folder: Path, connected):
    def broken() -> None:
        path = tools.fields["f"].path
        raise InputError(f"{folder / 'out' / 'a.ply'}: is not {path}, and/or https://a.b/c/d")

    # A table of words that is missing is said of the scene that needs it only.
    missing = LanguageField.load(folder / "f.scoup", words=tmp_path / "my words" / "gone.npz")

    async def talk() -> None:
        async with connected(SceneTools({"f": missing}), [broken]) as client:
            for tool, scene in (("broken", {}), ("find", {"scene": "f"}), ("find", {"scene": "g"})):
                arguments = {**scene, "text": "kettle"} if scene else {}
                check_message((await client.call_tool(tool, arguments)).content[0].text)

    anyio.run(talk)
