"""Pages that need no server."""

from __future__ import annotations

import base64
import gzip
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from PIL import Image
from view_samples import PAGE, WORDS, random_field, table, unpacked, viewed_field

from messages import refuses
from scoup.base import OutputExistsError, ScoupError
from scoup.view import export
from scoup.view.export import FOLDER_FILES, ExportReport, export_page
from scoup.view.page import PageFiles, page_files
from scoup.view.viewed_field import ViewedField


@pytest.fixture(autouse=True)
def page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "page_files", lambda: PAGE)


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return viewed_field()


def data_of(page: Path, name: str = "window.scoupData") -> Any:
    """What a script of a page assigns to a name."""
    found = re.search(rf"{re.escape(name)} = (.*);\n", page.read_text())
    assert found is not None
    return json.loads(found[1])


def test_one_file_holds_everything(viewed: ViewedField, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(export, "MOST_THUMBNAILS", 2)
    out = tmp_path / "scene.html"
    report = export_page(viewed, out)
    text = out.read_text()
    export_page(viewed_field(), tmp_path / "again.html")  # an equal field gives the same bytes
    assert (tmp_path / "again.html").read_bytes() == out.read_bytes()
    assert (report.bytes, report.words) == (out.stat().st_size, len(WORDS))
    data = data_of(out)
    scene = base64.b64decode(data["scene"])
    assert len(scene) == report.scene_bytes
    assert unpacked(scene)[1]["n_gaussians"] == 60
    assert unpacked(base64.b64decode(data["words"]))[1]["names"] == list(WORDS)
    first, none, last = data["thumbnails"]  # of three views, two have a picture
    assert none is None
    for each in (first, last):
        assert Image.open(io.BytesIO(base64.b64decode(each))).size == (160, 120)
    program = re.search(r'window.scoupProgram = "([^"]*)"', text)
    assert program is not None
    assert gzip.decompress(base64.b64decode(program[1])) == PAGE.program
    assert PAGE.style in text
    assert "three: MIT - - as it is" in text  # within a comment
    assert not re.search(r"(src|href)=|viewer\.js", text)
    html = PAGE.with_settings({"name": "</script><script>alert(1)</script>"})
    assert "alert" in html
    assert "<script>alert" not in html


def assert_holds(folder: Path, report: ExportReport, *others: str) -> None:
    """Check what a folder holds, as the report says."""
    files = {path.name: path.stat().st_size for path in folder.iterdir()}
    assert set(files) == {*FOLDER_FILES, *others}
    assert report.bytes == sum(files.values())


def test_a_folder_holds_the_same_and_a_large_scene_in_parts(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("scoup.view.parts.COARSE_GAUSSIANS", 20)
    monkeypatch.setattr("scoup.view.parts.PART_GAUSSIANS", 30)
    viewed = viewed_field()
    folder = tmp_path / "page"
    report = export_page(viewed, folder, split=True)
    assert_holds(folder, report, "part_0.js", "part_1.js")
    assert "part_0" not in (folder / "index.html").read_text()  # which loads it when the first is shown
    export_page(viewed, tmp_path / "page.html")
    data = data_of(tmp_path / "page.html")
    scene = base64.b64decode(data["scene"])
    packed = [base64.b64decode(part) for part in data["parts"]]
    wanted = [viewed.part(number) for number in range(2)]
    assert [gzip.decompress(part) for part in packed] == [gzip.decompress(part) for part in wanted]
    assert report.scene_bytes == len(scene) + sum(map(len, packed))
    index = (folder / "index.html").read_text()
    target, mark = re.findall(r"= (window.scoup_(\w+)) =", index)[0]  # of other exports, it is another
    for number, part in enumerate(data["parts"]):
        assert data_of(folder / f"part_{number}.js", f"{target}.parts[{number}]") == part
    assert re.findall(r'src="([^"]*)"', index) == [f"{name}?{mark}" for name in FOLDER_FILES[1:]]
    (folder / "party.js").touch()  # of somebody else
    with pytest.raises(OutputExistsError):
        export_page(viewed, folder, split=True)
    for name, kept in (("PART_GAUSSIANS", ["part_0.js"]), ("COARSE_GAUSSIANS", [])):  # one part, then none
        monkeypatch.setattr(f"scoup.view.parts.{name}", 60)
        report = export_page(viewed_field(), folder, split=True, overwrite=True)
        assert_holds(folder, report, "party.js", *kept)
    other = re.findall(r"= (window.scoup_\w+) =", (folder / "index.html").read_text())[0]
    assert other != target
    scene = data_of(folder / "scene.js", f"{other}.scene")
    assert unpacked(base64.b64decode(scene))[1]["n_gaussians"] == 60


def test_nothing_is_overwritten_unasked_or_half_written(
    viewed: ViewedField, tmp_path: Path, monkeypatch
) -> None:
    out = tmp_path / "scene.html"
    out.write_text("mine")
    with pytest.raises(OutputExistsError):
        export_page(viewed, out)
    assert out.read_text() == "mine"

    with monkeypatch.context() as patch:
        patch.setattr(ViewedField, "thumbnail", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            export_page(viewed, out, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.html"]
    assert out.read_text() == "mine"
    export_page(viewed, out, overwrite=True)
    assert out.read_text() != "mine"


@pytest.mark.parametrize("split", [False, True])
def test_a_second_export_of_a_page_does_no_work(
    viewed: ViewedField, tmp_path: Path, monkeypatch, split: bool
) -> None:
    def again(*arguments: object, **options: object) -> None:
        monkeypatch.undo()
        monkeypatch.setattr(export, "_words", pytest.fail)
        monkeypatch.setattr(export, "page_files", lambda: PAGE)
        export_page(viewed, tmp_path / "page.html", split)

    monkeypatch.setattr(ViewedField, "scene", again)
    with pytest.raises(ScoupError, match="is being written"):
        export_page(viewed, tmp_path / "page.html", split)


def test_pages_tell_no_folder_of_this_machine(tmp_path: Path) -> None:
    field = random_field(cameras=False)  # and without words
    field.info = replace(field.info, words=tmp_path / "gone.npz")
    report = export_page(ViewedField(field), tmp_path / "scene.html")
    data = data_of(tmp_path / "scene.html")
    assert (report.words, data["words"], data["thumbnails"]) == (0, "", [])
    metadata = unpacked(base64.b64decode(data["scene"]))[1]
    assert metadata["words_problem"] == "this page was exported without words"
    assert str(tmp_path) not in json.dumps(metadata)
    field = random_field()
    field.info = replace(field.info, embedding_model=str(tmp_path / "clip"), words=tmp_path / "words.npz")
    field.save(tmp_path / "secret folder.scoup")
    viewed = ViewedField(field.with_encoder(table()))
    export_page(viewed, tmp_path / "scene.html", overwrite=True)
    assert str(tmp_path) not in (tmp_path / "scene.html").read_text()
    data = data_of(tmp_path / "scene.html")
    assert unpacked(base64.b64decode(data["scene"]))[1]["embedding_model"] == "clip"
    assert viewed.settings("live")["field"] == str(tmp_path / "secret folder.scoup")
    assert viewed.settings("exported")["open"] == "scoup view 'secret folder.scoup'"


def test_a_page_that_was_not_built_is_named_with_the_remedy(tmp_path: Path) -> None:
    with refuses(ScoupError):
        page_files(tmp_path)
    for name in ("index.html", "viewer.css", "licences.txt", "viewer.js"):
        (tmp_path / name).write_text("of another version")
    with refuses(ScoupError):
        page_files(tmp_path)
    (tmp_path / "index.html").write_text(PAGE.index)
    assert isinstance(page_files(tmp_path), PageFiles)
