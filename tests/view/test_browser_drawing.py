"""What the page draws: coarse scenes and while the camera moves, cleaned selections, relevancy on the GPU, phrases."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from browser_support import (
    A_THING,
    ALIKE,
    DRAWS,
    THINGS,
    Browser,
    Visit,
    coded,
    difference,
    render,
    served,
    splat,
    table,
    things_field,
    visiting,
)
from test_exported_phrases import check_alike, room
from test_one_grammar import PHRASES
from view_samples import selected_by_votes, unpacked

from scoup.base import InputError
from scoup.query import LanguageField
from scoup.scene import Camera, Cameras
from scoup.view import parts
from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField
from scoup.view.work import BusyError


@pytest.fixture
def in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "COARSE_GAUSSIANS", 60)
    monkeypatch.setattr(parts, "PART_GAUSSIANS", 200)


def whole_scene(visit: Visit, viewed: ViewedField) -> None:
    """Check that the page shows all parts."""
    visit.page.evaluate("window.scoupViewer.whole")
    visit.settle()
    assert visit.state()["gaussians"] == visit.state()["drawing"] == len(viewed.field)
    assert "more are loading" not in visit.page.inner_text("#facts")
    visit.ask("kettle")
    visit.choose("Only the selection")
    assert difference(visit.picture(), render(viewed, selected_by_votes(viewed, "kettle"))) < ALIKE


def asked(visit: Visit, mark: str) -> list[str]:
    """The ends of the addresses that the page asked for."""
    return [address.rsplit("/", 1)[1] for address in visit.requests if mark in address]


@pytest.mark.usefixtures("in_parts")
def test_a_large_scene_is_seen_coarsely_first(browser: Browser, monkeypatch, tmp_path: Path) -> None:
    viewed = ViewedField(things_field().with_encoder(table()))
    assert viewed.n_parts > 1
    export_page(viewed, tmp_path / "page", split=True)
    with visiting(browser, (tmp_path / "page" / "index.html").as_uri(), offline=True) as visit:
        whole_scene(visit, viewed)
        files = sorted(end.partition("?")[0] for end in asked(visit, "part_"))
        assert files == [f"part_{number}.js" for number in range(viewed.n_parts)]
    held, busy = threading.Event(), [True]
    part = viewed.part

    def part_when(number: int, whole: bool) -> bytes:
        held.wait()
        if busy:
            busy.clear()
            raise BusyError
        return part(number, whole=whole)

    monkeypatch.setattr(viewed, "part", part_when)
    with served(browser, viewed) as visit:
        assert 0 < visit.state()["gaussians"] <= 60
        assert "more are loading" in visit.page.inner_text("#facts")
        held.set()
        whole_scene(visit, viewed)
        assert len(visit.problems) == 1  # the server was busy, and asked again
        assert "503" in visit.problems.pop()


def break_parts(
    viewed: ViewedField, monkeypatch: pytest.MonkeyPatch, when: Callable[[int, bool], bool]
) -> None:
    """Make some parts unavailable."""
    own = viewed.part

    def part(number: int, whole: bool) -> bytes:
        if when(number, whole):
            raise InputError("scene.scoup: damaged")
        return own(number, whole=whole)

    monkeypatch.setattr(viewed, "part", part)


@pytest.mark.usefixtures("in_parts")
def test_a_part_that_cannot_be_had_is_said(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    viewed = ViewedField(things_field().with_encoder(table()))
    break_parts(viewed, monkeypatch, lambda *_: True)
    with served(browser, viewed) as visit:
        visit.page.evaluate("window.scoupViewer.whole")
        said = visit.page.inner_text("#message")
        assert said == "A part of the scene is missing: scene.scoup: damaged"
        assert 0 < visit.state()["gaussians"] <= 60
        assert "400" in visit.problems.pop()


def test_a_page_that_was_cut_short_says_so(browser: Browser, tmp_path: Path) -> None:
    file, page = tmp_path / "page.html", browser.contexts[0].new_page()
    export_page(ViewedField(things_field().with_encoder(table())), file)
    length = file.read_bytes().index(b"<!--")  # of all but the licences
    for share in (0.9, 0.3):
        os.truncate(file, int(share * length))
        page.goto(file.as_uri())
        assert page.inner_text("body") == "this page is cut short; copy it again, or export it again"
    page.close()


@pytest.mark.usefixtures("in_parts")
def test_files_that_do_not_belong_to_the_page_are_named(browser: Browser, tmp_path: Path) -> None:
    field = things_field().with_encoder(table())
    for folder, words in (("page", None), ("other", ["mug"])):
        export_page(ViewedField(field, words), tmp_path / folder, split=True)
    page = browser.contexts[0].new_page()
    for name, change in (
        ("scene.js", "removed"),
        *itertools.product(("words.js", "part_1.js"), ("damaged", "of another export")),
    ):
        file = tmp_path / "page" / name
        text = file.read_text()
        middle = len(text) // 2
        damaged = f"{text[:middle]}{'B' if text[middle] == 'A' else 'A'}{text[middle + 1 :]}"
        file.write_text(damaged if change == "damaged" else (tmp_path / "other" / name).read_text())
        if change == "removed":
            file.unlink()
        page.goto((tmp_path / "page" / "index.html").as_uri())
        said = f"{name} is missing, damaged or of another export; reload the page, or export it again"
        page.locator("#message, #loading-text", has_text=said).wait_for()
        file.write_text(text)
    page.close()


def four_places() -> LanguageField:
    """Four parts far from each other, and cameras near some, and far from all."""
    generator = torch.Generator().manual_seed(3)
    means = torch.rand(800, 3, generator=generator)
    means[:, 0] += 30 * (torch.arange(800) // 200)
    gaussians = splat(means, 0.03, torch.rand(800, 3, generator=generator))
    places = (("last.png", 90.5, 2), ("first.png", 0.5, 2), ("second.png", 30.5, 2), ("far.png", 45.5, 400))
    cameras = [
        Camera.look_at((x, -distance, 0.5), (x, 0, 0.5), name, 400, 300, 400) for name, x, distance in places
    ]
    return coded(gaussians, torch.zeros(800, 3, dtype=torch.int64), generator, Cameras(cameras))


def fly(visit: Visit, name: str) -> None:
    visit.page.evaluate("name => window.scoupViewer.flyTo(name)", name)
    visit.page.evaluate("window.scoupViewer.whole")
    visit.settle()


@pytest.mark.usefixtures("in_parts")
def test_what_is_near_comes_first_and_is_shown_whole(browser: Browser, monkeypatch) -> None:
    """Of merged parts, as many as there is room for, and others where the camera goes."""
    viewed = ViewedField(four_places().with_encoder(table()), most=300)
    merged = [len(unpacked(viewed.part(number))[0]["opacities"]) for number in range(4)]
    assert max(merged) <= 75
    break_parts(viewed, monkeypatch, lambda number, whole: whole and number == 1)
    flights = [
        ("first.png", 0), ("last.png", 3), ("far.png", 3),
        ("second.png", 3),  # which cannot be had whole, and stays merged
        ("first.png", 0), ("second.png", 0),
    ]  # fmt: skip
    with served(browser, viewed) as visit:
        for name, whole in flights:
            fly(visit, name)
            count = sum(merged) - merged[whole] + 200
            assert visit.state()["drawing"] == visit.state()["gaussians"] == count, name
            if name in ("first.png", "last.png"):
                assert difference(visit.picture(), viewed.picture(viewed.field.camera(name))) < ALIKE
            if name == "second.png":
                said = visit.page.inner_text("#message")
                assert said == "A part of the scene stays merged: scene.scoup: damaged"
        assert asked(visit, "/part/")[0] == "3-of-4"  # what is seen
        assert asked(visit, "?whole") == [f"{number}-of-4?whole" for number in (3, 0, 3, 1, 0)]
        assert "400" in visit.problems.pop()


def test_haze_and_needles_are_cleaned_from_the_selection(browser: Browser) -> None:
    field = things_field()
    gaussians = field.gaussians.select(torch.arange(len(field)))
    gaussians.opacities[:A_THING:2] = 0.08  # of the kettle, haze
    gaussians.scales[1:A_THING:2] = torch.tensor([0.12, 0.01, 0.01])  # and needles
    gaussians.scales[A_THING : 2 * A_THING] = torch.tensor([0.06, 0.06, 0.004])  # the mug's are flat
    clean_up = "clean up haze and needles of the selection"
    with served(browser, ViewedField(field.with_gaussians(gaussians).with_encoder(table()))) as visit:
        for text, stays in (("kettle", False), ("mug", True)):
            visit.ask(text)
            visit.choose("Only the selection")
            whole = visit.picture()
            assert whole.max() > 50
            visit.tick(clean_up)
            clean = visit.picture()
            assert difference(clean, whole) < ALIKE if stays else clean.max() < 20
            visit.tick(clean_up, False)
            visit.remove(text)


UNFINISHED = """() => {
  const own = WebGL2RenderingContext.prototype.getSyncParameter;
  WebGL2RenderingContext.prototype.getSyncParameter = function (...values) {
    return window.finished ? own.apply(this, values) : this.UNSIGNALED;
  };
}"""
"""Lets no frame be finished before ``window.finished``."""


def test_slow_browsers_draw_less_while_the_camera_moves(browser: Browser, monkeypatch) -> None:
    monkeypatch.setattr(parts, "COARSE_GAUSSIANS", 60)
    viewed = ViewedField(things_field().with_encoder(table()))
    with served(browser, viewed) as visit:
        visit.page.evaluate("window.scoupViewer.whole")
        visit.ask("kettle")
        rest = visit.picture()
        assert visit.state()["drawing"] == len(viewed.field)
        # A clock by which every frame takes a second.
        visit.page.evaluate("performance.now = () => (window.ticks = (window.ticks ?? 0) + 1000)")
        visit.page.locator("#canvas").focus()
        key = itertools.cycle(["ArrowLeft", "ArrowRight"])
        width = "document.querySelector('#canvas').width"
        while visit.state()["drawing"] > 60 or visit.page.evaluate(width) > rest.shape[1] / 2:
            visit.page.keyboard.press(next(key))
        if next(key) == "ArrowRight":
            visit.page.keyboard.press("ArrowRight")
        visit.settle()
        assert visit.state()["drawing"] == len(viewed.field)
        assert difference(visit.picture(), rest) < ALIKE
        # From one rest to the next: all Gaussians are drawn only once, after the last movement.
        visit.page.evaluate(DRAWS)
        draws: list[int] = []
        while len(draws) < 2:  # a busy machine may find the camera at rest before the first frame
            visit.page.keyboard.press(next(key))
            visit.settle()
            draws = visit.page.evaluate("window.draws.splice(0)")
            assert draws[-1] > 60
            assert all(drawn <= 60 for drawn in draws[:-1])
        visit.page.evaluate("window.scoupViewer.set({opacity: 0.9})")
        visit.settle()
        assert len(visit.page.evaluate("window.draws.splice(0)")) == 1
        # The camera does not rest while the browser still draws a frame of the movement.
        visit.page.evaluate(UNFINISHED)
        while not draws or draws[-1] > 60:
            visit.page.keyboard.press(next(key))
            draws = visit.page.evaluate("window.draws.splice(0)")
        visit.page.wait_for_timeout(700)
        assert all(drawn <= 60 for drawn in visit.page.evaluate("window.draws.splice(0)"))
        visit.page.evaluate("window.finished = true")
        visit.settle()
        assert visit.page.evaluate("window.draws")[-1] > 60


def test_relevancy_on_the_browsers_gpu_is_that_of_the_library(browser: Browser):
    # Opaque Gaussians ten pixels apart; the codes fill several rows of the textures.
    generator = torch.Generator().manual_seed(8)
    across, down = torch.meshgrid(torch.arange(38), torch.arange(28), indexing="xy")
    means = torch.stack([across.flatten() - 18.5, torch.zeros(38 * 28), 13.5 - down.flatten()], 1) * 0.2
    count = len(means)
    gaussians = splat(means, 0.03, torch.ones(count, 3), opacity=1.0)
    camera = Camera.look_at((0, -8, 0), (0, 0, 0), "front.png", 400, 300, 400)
    main = torch.randint(len(THINGS), (count, 3), generator=generator)
    field = coded(gaussians, main, generator, Cameras([camera]), k=6, n_others=300)
    field.code_weights = torch.rand(field.code_weights.shape, generator=generator).to(torch.float16)
    field.code_weights[::7, 1] = 0  # without a code
    viewed = ViewedField(field.with_encoder(table()))
    points = torch.cat([means, torch.ones(count, 1)], 1).double() @ (camera.viewmat[:3].T @ camera.K.T)
    columns, rows = (points[:, :2] / points[:, 2:]).floor().int().numpy().T
    with served(browser, viewed) as visit:
        white = visit.picture()
        assert difference(white, viewed.picture(camera)) < ALIKE
        for text in ("kettle", "dishes"):
            visit.page.evaluate("texts => window.scoupViewer.ask(texts)", [text])
            vectors = viewed.question([text])
            relevancy = field.gaussian_relevancy(vectors.queries, vectors.canonical)[:, 0]
            assert float(relevancy.max() - relevancy.min()) > 0.5
            for level in range(3):
                visit.page.evaluate("level => window.scoupViewer.set({mode: 'relevancy', level})", level)
                visit.settle()
                found = visit.picture()[rows, columns].mean(1) / white[rows, columns].mean(1)
                np.testing.assert_allclose(found, relevancy[level].numpy(), atol=0.01)
            visit.remove(text)


def test_an_exported_page_understands_phrases(browser: Browser, tmp_path: Path) -> None:
    viewed, text = ViewedField(room(1)), "what is left of salt and pepper"
    export_page(viewed, tmp_path / "room.html")
    with visiting(browser, (tmp_path / "room.html").as_uri(), offline=True) as visit:
        for some in [*zip(*[iter(PHRASES)] * 3, strict=True)][::4]:  # the others are asked without a browser
            visit.page.evaluate("texts => window.scoupViewer.ask(texts)", list(some))
            check_alike(viewed, some, visit.state()["queries"][-3:])
        visit.ask(text)
        facts = visit.row(text).locator(".facts").inner_text()
        assert facts.startswith("13 things, table, 2 x mug, laptop, lamp, ball, bowl")
        box = visit.page.get_by_label("What do you look for?")
        box.fill("mug across the table")
        box.press("Enter")
        visit.page.locator("#message").filter(has_text="unknown relation 'across'").wait_for()
        for query in visit.state()["queries"][:-1]:
            visit.remove(query["text"])
        command = visit.page.evaluate("window.scoupViewer.command()").split(" --out")[0]
        assert command.endswith("""'what is left of "salt and pepper"'""")
