"""scoup render."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from cli_support import run, run_json
from scoup.query import LanguageField
from scoup.raster import render_colors

pytestmark = pytest.mark.usefixtures("here")


def pixels(path: str) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def test_colours_are_those_of_the_splat():
    code, out, err = run("render", "f.scoup", "--plain")
    assert (code, out, err) == (0, "1 view rendered to f_color\n", "")
    field = LanguageField.load("f.scoup")
    assert field.cameras is not None
    expected = render_colors(field.gaussians, field.cameras[0]).numpy() * 255
    assert np.abs(pixels("f_color/view_00.png") - expected).max() <= 1


def test_codes_of_all_cameras():
    codes = ("render", "f.scoup", "--what", "codes", "--plain")
    record = run_json(*codes, "--camera", "all")
    assert record["files"] == [f"f_codes/view_0{number}.png" for number in range(4)]
    pictures = [pixels(file) for file in record["files"]]
    assert {picture.shape for picture in pictures} == {(30, 40, 3)}
    assert all(picture.std() > 5 for picture in pictures)
    run_json(*codes, "--level", "s", "--out", "fine")
    assert (pixels("fine/view_00.png") != pictures[0]).any()


def test_relevancy_of_a_text():
    run_json("render", "f.scoup", "--what", "relevancy", "--query", "kettle", "--scale", "3")
    picture = pixels("f_relevancy/view_00.png")
    assert picture.shape[1] >= 120
    assert picture.shape[0] > 90  # with title and legend


@pytest.mark.parametrize("what", [(), ("--what", "codes"), ("--what", "relevancy", "--query", "kettle")])
def test_lettering_stands_around_the_plain_picture(what):
    render = ("render", "f.scoup", *what, "--scale", "3.5")
    run_json(*render, "--out", "plain.png", "--plain")
    run_json(*render, "--out", "titled.png")
    plain, titled = pixels("plain.png"), pixels("titled.png")
    assert plain.shape == (105, 140, 3)
    assert titled.shape[1] == 140
    assert any((titled[top : top + 105] == plain).all() for top in range(1, titled.shape[0] - 104))


def test_one_picture_by_its_name():
    one = ("render", "f.scoup", "--out", "deep/a.png", "--camera", "view_01")
    assert run_json(*one)["files"] == ["deep/a.png"]
    run_json("render", "f.scoup", "--out", "all", "--camera", "all")
    assert (pixels("deep/a.png") == pixels("all/view_01.png")).all()


@pytest.mark.parametrize(("name", "plain"), [("turn.webp", True), ("turn.gif", False)])
def test_an_animation(name, plain):
    shown = ("--plain",) if plain else ("--what", "relevancy", "--query", "kettle")
    film = ("--camera", "all", "--out", name)
    record = run_json("render", "f.scoup", *film, *shown)
    assert record["files"] == [name]
    with Image.open(name) as picture:
        assert getattr(picture, "n_frames", 1) == 4
        assert (picture.size == (40, 30)) == plain
        picture.seek(1)
        picture.load()
        assert picture.info["duration"] == pytest.approx(1000 / 12, abs=4)
