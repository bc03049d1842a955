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

import numpy as np
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


def data_of(text: str, name: str) -> object:
    """What a script assigns to a name."""
    found = re.search(rf"{re.escape(name)} = (.*);\n", text)
    assert found is not None
    return json.loads(found[1])


def page_data(page: Path) -> dict[str, Any]:
    """What a page of one file holds."""
    data = data_of(page.read_text(), "window.scoupData")
    assert isinstance(data, dict)
    return data


def test_one_file_holds_everything(viewed: ViewedField, tmp_path: Path) -> None:
    out = tmp_path / "scene.html"
    report = export_page(viewed, out)
    text = out.read_text()
    export_page(viewed_field(), tmp_path / "again.html")  # an equal field gives the same bytes
    assert (tmp_path / "again.html").read_bytes() == out.read_bytes()
    assert report.bytes == out.stat().st_size
    assert report.words == len(WORDS)
    data = page_data(out)
    scene = base64.b64decode(data["scene"])
    tensors, metadata = unpacked(scene)
    assert len(scene) == report.scene_bytes
    assert metadata["n_gaussians"] == 60
    assert tensors["opacities"].shape == (60,)
    words, names = unpacked(base64.b64decode(data["words"]))
    assert names["names"] == list(WORDS)
    assert words["scores"].dtype == np.float16
    pictures = [Image.open(io.BytesIO(base64.b64decode(each))) for each in data["thumbnails"]]
    assert [picture.size for picture in pictures] == [(160, 120)] * 3
    program = re.search(r'window.scoupProgram = "([^"]*)"', text)
    assert program is not None
    assert gzip.decompress(base64.b64decode(program[1])) == PAGE.program
    assert PAGE.style in text
    assert "three: MIT - - as it is" in text  # within a comment
    settings = json.loads(text.split('type="application/json">')[1].split("</script>")[0])
    assert settings["mode"] == "exported"
    assert "viewer.js" not in text
    assert not re.search(r"(src|href)=", text)


def assert_holds(folder: Path, report: ExportReport, *others: str) -> None:
    """Check what a folder holds, as the report says."""
    files = {path.name: path.stat().st_size for path in folder.iterdir()}
    assert set(files) == {*FOLDER_FILES, *others}
    assert report.bytes == sum(files.values())


def test_a_folder_holds_the_same(viewed: ViewedField, tmp_path: Path) -> None:
    out = tmp_path / "page"
    report = export_page(viewed, out, split=True)
    assert_holds(out, report)
    index = (out / "index.html").read_text()
    assert re.findall(r'src="([^"]*)"', index) == ["scene.js", "words.js", "thumbnails.js", "things.js"]
    scene = data_of((out / "scene.js").read_text(), "window.scoupData.scene")
    assert unpacked(base64.b64decode(str(scene)))[1]["n_gaussians"] == 60
    with pytest.raises(OutputExistsError):
        export_page(viewed, out, split=True)


def test_a_large_scene_is_written_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scoup.view.parts.COARSE_GAUSSIANS", 20)
    monkeypatch.setattr("scoup.view.parts.PART_GAUSSIANS", 30)
    viewed = viewed_field()
    wanted = [viewed.part(number) for number in range(2)]
    folder = tmp_path / "page"
    report = export_page(viewed, folder, split=True)
    assert_holds(folder, report, "part_0.js", "part_1.js")
    assert "part_0" not in (folder / "index.html").read_text()  # which loads it when the first is shown
    export_page(viewed, tmp_path / "page.html")
    data = page_data(tmp_path / "page.html")
    scene = base64.b64decode(data["scene"])
    packed = [base64.b64decode(part) for part in data["parts"]]
    assert [gzip.decompress(part) for part in packed] == [gzip.decompress(part) for part in wanted]
    assert report.scene_bytes == len(scene) + sum(map(len, packed))
    assert len(unpacked(scene)[1]["parts"]) == 2
    for number, part in enumerate(data["parts"]):
        script = (folder / f"part_{number}.js").read_text()
        assert data_of(script, f"window.scoupData.parts[{number}]") == part
    (folder / "party.js").touch()  # of somebody else
    monkeypatch.setattr("scoup.view.parts.PART_GAUSSIANS", 60)
    assert_holds(
        folder, export_page(viewed_field(), folder, split=True, overwrite=True), "part_0.js", "party.js"
    )


def test_nothing_is_overwritten_unasked_or_half_written(
    viewed: ViewedField, tmp_path: Path, monkeypatch
) -> None:
    out = tmp_path / "scene.html"
    out.write_text("mine")
    with pytest.raises(OutputExistsError):
        export_page(viewed, out)
    assert out.read_text() == "mine"

    def interrupt(*arguments: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(ViewedField, "thumbnail", interrupt)
    with pytest.raises(KeyboardInterrupt):
        export_page(viewed, out, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.html"]
    assert out.read_text() == "mine"
    monkeypatch.undo()
    monkeypatch.setattr(export, "page_files", lambda: PAGE)
    export_page(viewed, out, overwrite=True)
    assert out.read_text() != "mine"


def test_a_page_for_a_field_without_words(tmp_path: Path) -> None:
    field = random_field(cameras=False)
    field.info = replace(field.info, words=tmp_path / "gone.npz")
    report = export_page(ViewedField(field), tmp_path / "scene.html")
    data = page_data(tmp_path / "scene.html")
    assert (report.words, data["words"], data["thumbnails"]) == (0, "", [])
    metadata = unpacked(base64.b64decode(data["scene"]))[1]
    assert metadata["words_problem"] == "this page was exported without words"
    assert str(tmp_path) not in json.dumps(metadata)


def test_the_folders_of_this_machine_are_not_told(tmp_path: Path) -> None:
    field = random_field()
    field.info = replace(field.info, embedding_model=str(tmp_path / "clip"), words=tmp_path / "words.npz")
    field.save(tmp_path / "secret folder.scoup")
    viewed = ViewedField(field.with_encoder(table()))
    export_page(viewed, tmp_path / "scene.html")
    text = (tmp_path / "scene.html").read_text()
    assert str(tmp_path) not in text
    data = page_data(tmp_path / "scene.html")
    assert unpacked(base64.b64decode(data["scene"]))[1]["embedding_model"] == "clip"
    assert viewed.settings("live")["field"] == str(tmp_path / "secret folder.scoup")
    assert viewed.settings("exported")["open"] == "scoup view 'secret folder.scoup'"


def test_settings_cannot_end_their_script() -> None:
    html = PAGE.with_settings({"name": "</script><script>alert(1)</script>"})
    assert "alert" in html
    assert "<script>alert" not in html


def test_only_some_views_of_many_have_a_picture(viewed: ViewedField, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(export, "MOST_THUMBNAILS", 2)
    export_page(viewed, tmp_path / "scene.html")
    assert [each is None for each in page_data(tmp_path / "scene.html")["thumbnails"]] == [False, True, False]


def test_a_page_that_was_not_built_is_named_with_the_remedy(tmp_path: Path) -> None:
    with refuses(ScoupError):
        page_files(tmp_path)
    for name in ("index.html", "viewer.css", "licences.txt", "viewer.js"):
        (tmp_path / name).write_text("of another version")
    with refuses(ScoupError):
        page_files(tmp_path)
    (tmp_path / "index.html").write_text(PAGE.index)
    assert isinstance(page_files(tmp_path), PageFiles)
