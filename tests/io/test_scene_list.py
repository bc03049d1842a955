"""Lists of scenes: what is read of them, and what is refused, in one sentence that names file, scene and option."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.io import scene_list
from scoup.io.scene_list import ListedScene, Wanted, read_scene_list

BUILD = Wanted(
    "build", ("scene", "gaussians", "n-atoms", "wide", "scenes", "out"), ("scenes",), ("build", "extract")
)
FULL = """
# a comment
defaults:
  n-atoms: 64
  wide: true
  extract: {preset: fast}
  build: {out: default.scoup}
scenes:
  - name: kitchen
    scene: data/kitchen
    build: {gaussians: a.ply, n_atoms: 8}
    extract: {out: elsewhere}
  - {name: room.2, scene: data/room, wide: false, out: room.scoup, scenes: [a, 7]}
  - {name: raum_ü-3, scene: "data/räume", n-atoms: null, scenes: b}
"""


def written(folder: Path, text: str, name: str = "scenes.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str, name: str = "scenes.yaml") -> str:
    """The message for a list, less the path with which it must begin."""
    path = written(folder, text, name)
    with pytest.raises(FileFormatError) as caught:
        read_scene_list(path, BUILD)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


def scenes(entries: str) -> str:
    return f"scenes:\n  - {entries}\n"


def test_defaults_scenes_and_sections(tmp_path: Path) -> None:
    kitchen, room, third = read_scene_list(written(tmp_path, FULL), BUILD)
    assert kitchen == ListedScene(
        "kitchen",
        {"n-atoms": 8, "wide": True, "out": "default.scoup", "scene": "data/kitchen", "gaussians": "a.ply"},
    )
    # What stands in the section of defaults is still a default.
    assert room.options == {
        "n-atoms": 64, "wide": False, "out": "room.scoup", "scene": "data/room", "scenes": ("a", "7"),
    }  # fmt: skip
    assert third.name == "raum_ü-3"
    assert third.options["n-atoms"] is None
    assert (third.options["scene"], third.options["scenes"]) == ("data/räume", ("b",))


def test_json_is_the_same(tmp_path: Path) -> None:
    content = {"defaults": {"n-atoms": 8}, "scenes": [{"name": "a", "scene": "x"}]}
    expected = [ListedScene("a", {"n-atoms": 8, "scene": "x"})]
    for name in ("scenes.json", "scenes.yaml"):
        assert read_scene_list(written(tmp_path, json.dumps(content), name), BUILD) == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it is missing, expected names with values"),
        ("- a", "it is a list, expected"),
        ("scenes: 3", "has no scenes"),
        ("scenes: []", "has no scenes"),
        ("defaults: {n-atoms: 3}", "has no scenes"),
        ("scene: []", "has 'scene', expected defaults and scenes only"),
        ("defaults: [1]\nscenes: [{name: a}]", "defaults is a list, expected"),
        (scenes("a"), "scene 1 is 'a', expected"),
        (scenes("{scene: a}"), "scene 1 has no name"),
        (scenes("{name: 21}"), "scene 1 has the name 21; names are texts"),
        (scenes("{name: no}"), "scene 1 has the name False"),
        (scenes("{name: a/b}"), "scene 1 has the name 'a/b'"),
        (scenes("{name: ..}"), "scene 1 has the name '..'"),
        (scenes("{name: ''}"), "scene 1 has the name ''"),
        (scenes(f"{{name: {'a' * 65}}}"), "scene 1 has the name"),
        (scenes('{name: "a\\n"}'), "scene 1 has the name"),
        (scenes("{name: a}\n  - {name: A}"), "two scenes are named 'a'; rename one of them"),
        (scenes("{name: a, n-atom: 3}"), "scene 'a': scoup build has no option 'n-atom' here; nearest: n-atoms"),
        (scenes("{name: a, n-atoms: 3, n_atoms: 4}"), "scene 'a': n-atoms is given twice"),
        (scenes("{name: a, wide: true, wide: false}"), "(line 2): 'wide' is given twice"),
        (scenes("{name: a, 3: 4}"), "scene 1 has the name 3, expected a text"),
        (scenes("{name: a, out: {b: c}}"), "scene 'a': out is a mapping, expected a text, a number"),
        (scenes("{name: a, out: [b]}"), "scene 'a': out is a list"),
        (scenes("{name: a, out: ''}"), "scene 'a': out is ''"),
        (scenes('{name: a, out: "b\\0c"}'), "scene 'a': out is 'b\\x00c'"),
        (scenes("{name: a, out: 2024-02-03}"), "put texts in quotes"),
        (scenes("{name: a, out: 2024-02-33}"), "is not valid YAML"),
        (scenes("{name: a, n-atoms: .inf}"), "scene 'a': n-atoms is inf"),
        (scenes("{name: a, scenes: [[b]]}"), "scene 'a': scenes is a list"),
        (scenes("{name: a, build: 3}"), "build of scene 'a' is 3, expected"),
        (scenes("{name: a, extract: 3}"), "extract of scene 'a' is 3, expected"),
        (scenes("{name: a, build: {build: {}}}"), "build of scene 'a': scoup build has no option 'build' here"),
        (scenes("{name: a, build: {n-atom: 3}}"), "build of scene 'a': scoup build has no option 'n-atom'"),
        ("scenes: [", "is not valid YAML (line "),
        ("scenes:\n\t- a", "is not valid YAML (line 2)"),
        ("a: 1\n---\nb: 2", "is not valid YAML"),
        ("a: \x07", "is not valid YAML"),
        ("scenes: !!python/object/apply:os.system [ls]", "is not valid YAML (line 1)"),
        ("defaults: &d {wide: true}\nscenes: [*d]", "has an alias (*d, line 2); write out"),
        ("defaults: &d {wide: true}\nscenes: [{name: a, <<: *d}]", "has an alias (*d, line 2)"),
        ("[" * 100_000, "is nested too deeply"),
        ("{a: " * 9, "is nested too deeply"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal(tmp_path, text)


def test_what_is_refused_of_json(tmp_path: Path) -> None:
    assert "is not valid JSON (line 1)" in refusal(tmp_path, "{", "a.json")
    assert "is not valid JSON" in refusal(tmp_path, "[" * 100_000, "a.json")
    assert "scene 1 has no name" in refusal(tmp_path, '{"scenes": [{}]}', "a.json")


def test_an_alias_bomb_takes_no_memory(tmp_path: Path) -> None:
    layers = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    layers += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    assert "has an alias (*a0, line 2)" in refusal(tmp_path, "\n".join(layers))


def test_too_much_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scenes.yaml"
    with path.open("wb") as stream:
        stream.truncate(10**12)
    with pytest.raises(FileFormatError, match="is larger than 4 MB"):
        read_scene_list(path, BUILD)
    monkeypatch.setattr(scene_list, "MOST_SCENES", 2)
    assert "lists 3 scenes" in refusal(tmp_path, scenes("{name: a}\n  - {name: b}\n  - {name: c}"))


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="there is no such file"):
        read_scene_list(tmp_path / "scenes.yaml", BUILD)
    with pytest.raises(MissingFileError, match="is a folder"):
        read_scene_list(tmp_path, BUILD)
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="is not a text file"):
        read_scene_list(tmp_path / "bytes.yaml", BUILD)


@given(st.text(alphabet="abn: -{}[]&*!'\"\n\t#|>%@`0,?", max_size=60) | st.text(max_size=30))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = written(tmp_path_factory.getbasetemp(), text.encode("utf-8", "replace").decode(), "any.yaml")
    with suppress(FileFormatError):
        assert all(isinstance(scene, ListedScene) for scene in read_scene_list(path, BUILD))
