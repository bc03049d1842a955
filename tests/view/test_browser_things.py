"""The page in a real browser on a field with things: they light up and are saved as `scoup select` selects them."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from browser_support import (
    ABSENT_TOO,
    ALIKE,
    AUTOMATIC,
    CONTRASTS,
    DRAWS,
    FILLERS,
    LEVELS,
    Browser,
    Visit,
    both_pages,
    check_saved,
    difference,
    field_of_instances,
    places_in,
    render,
    served,
    table,
    views,
)
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_dilation
from view_samples import of_select

from scoup import raster
from scoup.view.viewed_field import ViewedField
from support import altered

CLICKED = (0.25, 0.66, 1)
"""The colour of what is selected by a click."""


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return ViewedField(field_of_instances().with_encoder(table()))


@pytest.fixture
def visit(visit: Visit) -> Visit:
    """A visitor whose page lists its things."""
    visit.until("Boolean(window.scoupViewer.state().things)")
    return visit


def test_things_light_up_and_get_an_outline(visit: Visit, viewed: ViewedField, tmp_path: Path) -> None:
    by_things, answer = of_select(viewed, "kettle").mask, viewed.answers(["kettle"])[0]
    by_votes = of_select(viewed, "kettle", answer.level, 0.5).mask
    assert answer.chosen_things is not None
    assert (int(by_things.sum()), int(by_votes.sum())) == (90, 60)
    visit.ask("kettle")
    assert "90 Gaussians" in visit.row("kettle").inner_text()
    visit.tab("View")
    assert visit.page.locator("#threshold-value").inner_text() == "kettle by things"
    visit.tab("Answers")
    visit.choose("Only the selection")
    assert difference(visit.picture(), render(viewed, by_things)) < ALIKE
    visit.slide("Threshold", 0.5)
    assert difference(visit.picture(), render(viewed, by_votes)) < ALIKE
    assert difference(visit.picture(), render(viewed, by_things)) > 3 * ALIKE
    visit.tick(AUTOMATIC)
    for level, name in LEVELS.items():
        visit.choose(name)
        wanted = of_select(viewed, "kettle", level).mask
        assert difference(visit.picture(), render(viewed, wanted)) < ALIKE, name
    visit.choose("automatic")
    visit.choose("All but the selection")
    assert difference(visit.picture(), render(viewed, ~by_things)) < ALIKE
    # While the camera rests, what is selected has an outline.
    visit.remove("kettle")
    visit.choose("Colour")
    assert outline(visit, "outlines") is None
    assert pick(visit, "mug") == [4]
    assert is_around(viewed, of_thing(viewed, 4), outline(visit, "outlines", CLICKED))
    visit.page.keyboard.press("Escape")
    visit.settle()
    assert outline(visit, "outlines") is None
    visit.ask("kettle", "mug")
    for mode in ("Heat", "Colour"):
        visit.choose(mode)
        for query in visit.state()["queries"]:
            found = outline(visit, "outlines", query["color"])
            assert is_around(viewed, of_select(viewed, query["text"]).mask, found)
    saved = np.asarray(Image.open(visit.saved("Save picture", tmp_path)).convert("RGB")).astype(int)
    assert 0.01 < (np.abs(saved - visit.picture()).max(2) > 30).mean() < 0.2
    color = visit.state()["queries"][0]["color"]
    before = np.asarray(outline(visit, "outlines", color))
    hidden = "document.getElementById('outlines').hidden"  # at once
    assert visit.page.evaluate(f"(window.scoupViewer.flyTo('left.png'), {hidden})")
    visit.settle()
    after = np.asarray(outline(visit, "outlines", color))
    assert after.any()
    assert not np.array_equal(after, before)
    visit.choose("Only the selection")
    assert outline(visit, "outlines") is None


@both_pages
def test_texts_are_answered_as_by_the_library(visit: Visit, viewed: ViewedField, tmp_path: Path) -> None:
    # Commands ask what was asked, and exported pages tell it to the page around them.
    text = asked = "kettle and not book"
    targets = []
    if visit.page.url.startswith("file:"):
        text, asked, targets = FILLERS[1], f'"{FILLERS[1]}"', ["*"]
    visit.page.evaluate("targets = []; window.parent = { postMessage: (_, target) => targets.push(target) }")
    visit.tick(ABSENT_TOO)
    visit.ask(text)
    assert visit.page.evaluate("targets") == targets
    select, query = map(shlex.split, visit.page.evaluate("window.scoupViewer.command()").splitlines())
    assert (select[1], select[3], query[1], query[3]) == ("select", asked, "query", asked)
    assert f"field.question({json.dumps(asked)}, " in visit.page.evaluate("window.scoupViewer.python()")
    visit.remove(text)
    visit.tick(ABSENT_TOO, False)
    # Certainty and the next best thing.
    kettle, absent = answers = viewed.field.answer(["kettle", "furniture"])
    assert [answer.presence for answer in answers] == [True, False]
    visit.ask("kettle", "furniture")
    things = viewed.things()
    names = {thing["number"]: thing["name"] for thing in things}
    largest = max((one for one in things if one["level"] == 1), key=lambda thing: thing["gaussians"])
    visit.until(f"document.getElementById('text').placeholder.startsWith('{largest['name']}, ')")
    for answer, said in ((kettle, f"thing, {kettle.certainty}, "), (absent, "not here")):
        facts = visit.row(answer.text).locator(".facts")
        assert said in facts.inner_text()
        rival = answer.runner_up if answer.presence else None
        if rival:
            name = names[rival.thing]
            assert (
                f"or {f'{name} (thing {rival.thing})' if name else f'thing {rival.thing}'}, "
                in facts.inner_text()
            )
    # An absent text lights up as `scoup select --always` has it.
    visit.remove("kettle")
    visit.tick(ABSENT_TOO)
    visit.choose("Only the selection")
    for level, name in reversed(LEVELS.items()):
        visit.choose(name)
        wanted = of_select(viewed, "furniture", level).mask
        assert difference(visit.picture(), render(viewed, wanted)) < ALIKE, name
    # Things of several texts.
    visit.remove("furniture")
    visit.ask("mug", "kettle")
    wanted = of_select(viewed, "mug").mask | of_select(viewed, "kettle").mask
    assert int(wanted.sum()) > int(of_select(viewed, "kettle").mask.sum())
    visit.choose("Only the selection")
    assert difference(visit.picture(), render(viewed, wanted)) < ALIKE
    check_saved(visit.saved("Save selection", tmp_path), viewed.gaussians.select(wanted))
    visit.remove("mug")
    assert difference(visit.picture(), render(viewed, of_select(viewed, "kettle").mask)) < ALIKE


def test_phrases_light_up_things(browser: Browser) -> None:
    """A part that has a name of its own is left out of a thing."""
    field, fillers = field_of_instances(), [table()[name] for name in FILLERS]
    things = field.thing_table
    assert things is not None
    owners, embeddings = things.owners.clone(), things.embeddings.clone()
    owners[:30, 0] = 2  # of the kettle, to the thing that is named "book" at the finest level only
    embeddings[[0, 5, 8]] = torch.stack(fillers[:3]).half()
    named = replace(things, owners=owners, embeddings=embeddings)
    field = altered(field, thing_table=named, words=table())
    viewed = ViewedField(field)
    with served(browser, viewed) as visit:
        for text, count in (("mug right of the kettle", 60), ("kettle and not book", 60)):
            visit.ask(text)
            mask = field.answer(text).mask
            assert int(mask.sum()) == count
            visit.choose("Only the selection")
            assert difference(visit.picture(), render(viewed, mask)) < ALIKE
            visit.remove(text)
        visit.ask("kettle right of the mug")
        assert "none that is so, as seen from" in visit.row("kettle right of the mug").inner_text()


def pick(visit: Visit, name: str, *keys: str) -> list[int]:
    """Click on a thing; the numbers that are selected then."""
    for key in keys:
        visit.page.keyboard.down(key)
    visit.page.mouse.click(*visit.at(places_in()[name]))
    for key in keys:
        visit.page.keyboard.up(key)
    visit.settle()
    return visit.state()["things"]["selected"]


def test_clicks_select_things_and_the_pointer_outlines_them(visit: Visit, viewed: ViewedField) -> None:
    assert outline(visit) is None
    plain = visit.picture()
    visit.page.evaluate(DRAWS)
    for name, number in (("kettle", 3), ("mug", 4)):
        point_at(visit, name, number)
        assert visit.page.locator("#hovering").inner_text() == name
        assert is_around(viewed, of_thing(viewed, number), outline(visit))
    point_at(visit, "lamp", None)  # of no thing
    assert outline(visit) is None
    assert visit.page.evaluate("window.draws") == []  # the scene is not drawn again for it
    assert np.array_equal(visit.picture(), plain)
    visit.tab("Things")
    visit.page.locator("#thing-list button[data-thing='4']").hover()
    visit.until("window.scoupViewer.state().things.hovered === 4")
    assert outline(visit) is not None
    point_at(visit, "mug", 4)
    visit.page.evaluate("window.scoupViewer.flyTo('left.png')")
    assert outline(visit) is None  # that was for another view
    assert visit.page.locator("#hovering").is_hidden()
    visit.page.evaluate("window.scoupViewer.flyTo('front.png')")
    # Clicks select a thing of the middle level, then its group, with Alt its part, with Shift another one.
    for name, *keys, wanted in (
        ("kettle", [3]), ("kettle", [6]), ("kettle", [6]), ("kettle", "Alt", [3]), ("kettle", "Alt", [0]),
        ("mug", [4]), ("kettle", "Shift", [4, 3]), ("kettle", "Shift", [4]), ("lamp", []),
    ):  # fmt: skip
        assert pick(visit, name, *keys) == wanted, (name, keys)
    assert visit.page.evaluate("window.draws") != []  # but for this
    visit.page.mouse.move(0, 0)
    visit.settle()
    visit.page.mouse.move(5, 5)
    visit.until("window.scoupViewer.state().things.hovered === null")
    visit.settle()
    assert difference(visit.picture(), plain) < ALIKE
    pick(visit, "mug")
    assert difference(visit.picture(), plain) > 3 * ALIKE
    visit.page.keyboard.press("Escape")
    assert visit.state()["things"]["selected"] == []
    if visit.page.url.startswith("file:"):
        return  # an exported page says what is at a point without asking what is hidden
    # What is hidden is not here: the Gaussians of the book have its code, and every second one is of the kettle.
    said = visit.page.locator("#place dd[data-level='m']")
    here = visit.page.get_by_role("button", name="What is here?")
    pick(visit, "book")
    here.click()
    said.filter(has_text="book").wait_for()
    visit.tab("Things")
    visit.page.locator("#thing-list button[data-thing='5']").click()
    visit.page.get_by_role("button", name="Hide", exact=True).click()
    assert pick(visit, "book") == [3]
    here.click()
    said.wait_for()
    assert said.inner_text() == "kettle"


@both_pages
def test_a_known_length_says_how_many_metres_a_unit_has(visit: Visit) -> None:
    said, away = visit.page.locator("#measured"), visit.page.locator("#place dd").last
    pick(visit, "mug")
    visit.page.get_by_role("button", name="What is here?").click()
    away.filter(has_text=" scene units away").wait_for()
    visit.page.get_by_role("button", name="Clear").click()
    visit.page.mouse.move(0, 0)
    visit.settle()
    plain = visit.picture()
    visit.page.keyboard.press("m")
    for name, wanted in (("kettle", "Click the second point."), ("book", "Length ")):
        pick(visit, name)
        said.filter(has_text=wanted).wait_for()
    length, unit = said.inner_text().split(maxsplit=2)[1:]
    assert float(length) == pytest.approx(1.2, abs=0.1)  # of the surfaces before the centres
    assert unit == "scene units"
    visit.settle()
    changed = np.abs(visit.picture().astype(int) - plain).max(2) > 30
    assert 40 < changed.sum() < 400  # a line
    known, message = visit.page.get_by_label("True length in metres"), visit.page.locator("#message")
    known.press_sequentially("0,6")
    option = visit.page.locator("#metres-per-unit").inner_text().removeprefix("Copy ")
    assert float(option.split()[-1]) == pytest.approx(0.6 / float(length), rel=0.01)
    for bad in ("abc", "1,234.5", "-1", "0"):
        known.fill(bad)
        known.press("Enter")
        assert "must be a number above 0" in message.inner_text(), bad
        assert known.get_attribute("aria-invalid") == "true"
        assert said.inner_text() == "Length 0.6 m"  # the scale is kept
    known.fill("0.6")
    assert (message.inner_text(), known.get_attribute("aria-invalid")) == ("", "false")
    assert away.inner_text().endswith(" m away")
    visit.ask("kettle")
    assert option.startswith("scoup frame ")
    visit.remove("kettle")
    pick(visit, "kettle")
    said.filter(has_text="Click the second point.").wait_for()  # of another length
    assert visit.state()["things"]["selected"] == []
    visit.page.mouse.move(0, 0)
    visit.page.keyboard.press("Escape")
    visit.settle()
    assert difference(visit.picture(), plain) < ALIKE
    pick(visit, "kettle")
    assert " m" in visit.page.locator("#selection .facts").inner_text()


def outline(
    visit: Visit, canvas: str = "outline", color: tuple[float, ...] = (1, 1, 1)
) -> NDArray[np.bool_] | None:
    """The line of a colour over the picture, [H, W]; None where there is none."""
    pixels = visit.pixels(canvas)
    return None if pixels is None else (pixels == [*np.floor(255 * np.array(color) + 0.5), 255]).all(2)


def point_at(visit: Visit, name: str, number: int | None) -> None:
    """Move the pointer to a thing, and wait until it is known."""
    visit.page.mouse.move(*visit.at(places_in()[name]))
    visit.until(f"window.scoupViewer.state().things.hovered === {'null' if number is None else number}")


def is_around(viewed: ViewedField, mask: torch.Tensor, drawn: NDArray[np.bool_] | None) -> bool:
    """Whether a line, [H, W], is around what some of the Gaussians cover where the page opens."""
    assert drawn is not None
    projection = raster.project(viewed.gaussians.select(mask), views()[0].resized(*drawn.shape[::-1]))
    covered = (raster.render_channels(projection, torch.zeros(int(mask.sum()), 1))[1] > 0.5).numpy()
    assert 0.01 < covered.mean() < 0.5
    wanted = binary_dilation(covered) & ~covered
    return min(binary_dilation(wanted)[drawn].mean(), binary_dilation(drawn)[wanted].mean()) > 0.95


def of_thing(viewed: ViewedField, number: int) -> torch.Tensor:
    """[N] the Gaussians of a thing."""
    table = viewed.field.thing_table
    assert table is not None
    return (table.owners == number).any(1)


def test_things_are_named_hidden_and_saved(visit: Visit, viewed: ViewedField, tmp_path: Path) -> None:
    visit.tab("Things")
    rows = visit.page.locator("#thing-list button")
    rows.first.wait_for()
    assert rows.count() == 9
    visit.page.get_by_label("Filter things").fill("mug")
    assert rows.count() == 3
    assert all("mug" in text for text in rows.all_inner_texts())
    pick(visit, "mug")
    name = visit.page.get_by_label("Name of thing 4")
    assert name.input_value() == "mug"
    name.fill("my cup")
    name.press("Enter")
    visit.page.get_by_label("Filter things").fill("my cup")
    assert rows.count() == 1
    path, is_mug = visit.saved("Save", tmp_path), of_thing(viewed, 4)
    assert path.name == "my_cup.ply"
    assert b"comment thing 4: my cup\n" in path.read_bytes()[:400]
    check_saved(path, viewed.gaussians.select(is_mug))
    pick(visit, "kettle", "Shift")
    things = {thing.number: thing for thing in viewed.field.things()}
    distance = float((things[4].position - things[3].position).norm())
    measured = visit.page.locator("#selection .measure").inner_text()
    assert float(measured.split()[1]) == pytest.approx(distance, rel=0.01)
    assert [text for text in visit.page.evaluate(CONTRASTS) if text["ratio"] < text["needed"]] == []
    pick(visit, "mug")
    visit.page.get_by_role("button", name="Hide", exact=True).click()
    visit.settle()
    assert difference(visit.picture(), render(viewed, ~is_mug)) < ALIKE
    assert pick(visit, "mug") == []  # what is hidden is not clicked
    visit.page.keyboard.press("m")
    pick(visit, "mug")  # nor measured
    visit.page.locator("#message").filter(has_text="Nothing is at this point").wait_for()
    assert visit.page.locator("#measured").inner_text() == "Click the first point."
    visit.page.keyboard.press("Escape")
    visit.page.get_by_role("button", name="Show 1 hidden").click()
    assert visit.state()["things"]["hidden"] == []
    # A link opens the page at a thing.
    linked = "window.scoupViewer.state().things?.selected.join()"
    visit.page.evaluate("location.hash = 'thing=4'")
    visit.page.reload()
    visit.ready()
    visit.until(f"{linked} === '4'")
    visit.page.get_by_label("Filter things").fill("my cup")
    assert rows.count() == 1  # the name is kept as long as the session
    assert visit.page.locator("#selection").is_visible()
    visit.page.mouse.click(*visit.at((0.5, 0.5)))
    assert visit.page.evaluate(linked) == "7", "its group, since it is in the middle"
    visit.page.evaluate("location.hash = 'thing=3'")
    visit.until(f"{linked} === '3'")
