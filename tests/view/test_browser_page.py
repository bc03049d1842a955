"""The page in a real browser: what a visitor types, drags and clicks, and what is seen then.

Everything that the page does by itself is tried with a server, and in an exported page without a network.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from browser_support import (
    ABSENT,
    ABSENT_TOO,
    ALIKE,
    AUTOMATIC,
    CONTRASTS,
    MIXED,
    Visit,
    both_pages,
    difference,
    patches,
    places_in,
    render,
    selected_by_votes,
    views,
    visiting,
)
from PIL import Image

import scoup
from scoup.view.viewed_field import ViewedField

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest.importorskip("uvicorn")
pytestmark = pytest.mark.usefixtures("built_page")

LEVEL_WORDS = {"s": "fine", "m": "medium", "l": "coarse"}


def test_the_scene_is_seen_as_our_rasteriser_draws_it(visit: Visit, viewed: ViewedField):
    assert difference(visit.picture(), render(viewed)) < ALIKE
    visit.tab("View")
    visit.page.get_by_role("button", name="left.png").click()
    visit.until("window.scoupViewer.state().camera === 'left.png'")
    visit.settle()
    assert difference(visit.picture(), render(viewed, camera=views()[1].resized(400, 300))) < ALIKE
    assert difference(visit.picture(), render(viewed)) > 3 * ALIKE


def test_a_high_picture_shows_all_that_the_camera_sees(browser: Browser, live: str, viewed: ViewedField):
    with visiting(browser, live, (390, 844), is_mobile=True) as visit:
        visit.page.locator("#collapse").click()
        visit.settle()
        picture = visit.picture()
        height, width = picture.shape[:2]
        assert height > width
        visit.page.get_by_role("tab", name="View").wait_for(state="hidden")
        seen = views()[0].resized(width, width * 3 // 4)
        above = (height - seen.height) // 2
        middle = picture[above : above + seen.height]
        assert difference(middle, render(viewed, camera=seen)) < 2 * ALIKE  # up to half a pixel


def test_a_text_lights_up_its_thing_and_nothing_else(visit: Visit):
    plain = visit.picture()
    before = patches(plain)
    visit.ask("kettle")
    visit.choose("Colour")
    assert difference(visit.picture(), plain) > 3 * ALIKE
    visit.slide("Opacity of the colouring", 0)
    assert difference(visit.picture(), plain) < ALIKE
    visit.slide("Opacity of the colouring", 1)
    visit.choose("Heat")
    after = patches(visit.picture())
    for name, pixels in after.items():
        is_grey = np.ptp(pixels, 1).max() < 10
        assert is_grey == (name != "kettle"), name
    assert after["kettle"].max(1).min() > 200  # the light end of the colours
    visit.choose("All but the selection")
    rest = patches(visit.picture())
    assert rest.pop("kettle").max() < 10
    for name, pixels in rest.items():
        np.testing.assert_allclose(pixels, before[name], atol=2)


@both_pages
def test_several_texts_have_a_colour_each(visit: Visit):
    visit.ask("kettle", "lamp")
    visit.slide("Opacity of the colouring", 1)
    visit.tab("Answers")
    colors = {query["text"]: np.array(query["color"]) for query in visit.state()["queries"]}
    assert set(colors) == {"kettle", "lamp"}
    assert np.abs(colors["kettle"] - colors["lamp"]).max() > 0.3

    def share_of(name: str, color: np.ndarray) -> float:
        """Cosine of the pixels of a thing with a colour."""
        mean = patches(visit.picture())[name].mean(0)
        return float(mean @ color / np.linalg.norm(mean) / np.linalg.norm(color))

    for text, color in colors.items():
        assert share_of(text, color) > 0.99
        swatch = visit.row(text).locator(".swatch")
        shown = swatch.evaluate("element => getComputedStyle(element).backgroundColor")
        np.testing.assert_allclose([int(part) for part in shown[4:-1].split(",")], color * 255, atol=1)
    assert np.ptp(patches(visit.picture())["mug"], 1).max() < 10
    visit.page.get_by_role("button", name="Hide kettle").click()
    visit.settle()
    pixels = patches(visit.picture())
    assert np.ptp(pixels["kettle"], 1).max() < 10
    assert np.ptp(pixels["lamp"], 1).max() > 50
    visit.remove("lamp")
    assert [query["text"] for query in visit.state()["queries"]] == ["kettle"]


@both_pages
def test_the_legend_says_what_the_library_says(visit: Visit, viewed: ViewedField):
    visit.ask("kettle")
    answer = viewed.answers(["kettle"])[0]
    low, high = answer.spans[answer.level].tolist()
    legend = visit.page.locator("#legend")  # a colour bar, where there is one text
    assert [part.strip() for part in legend.inner_text().split("\n")] == [
        f"{low:.2f}", f"{high:.2f}", "relevancy to “kettle”"
    ]  # fmt: skip
    visit.ask("mug", ABSENT)
    assert not legend.is_visible()
    mug, absent = viewed.field.answer(["mug", ABSENT])
    facts = [visit.row(text).locator(".facts") for text in ("mug", ABSENT)]
    size = f"{LEVEL_WORDS[mug.level]} level, {int(mug.mask.sum())} Gaussians"
    assert facts[0].inner_text() == f"{mug.certainty}, {size}"
    assert f"Level {mug.level}," in (facts[0].locator("span").nth(1).get_attribute("title") or "")
    assert facts[1].inner_text() == "not here"
    title = facts[1].locator("span").get_attribute("title") or ""
    assert f"Score {absent.score:.2f}: the share of everyday words" in title
    assert "present from 0.37" in title
    visit.choose("l (coarse)")  # whose score is another one
    assert facts[0].inner_text() == "coarse level"
    assert facts[1].inner_text() == "not here"
    visit.choose("automatic")
    assert str(mug.certainty) in facts[0].inner_text()
    visit.tab("View")
    assert "kettle 0." in visit.page.locator("#threshold-value").inner_text()
    end = "document.querySelector('label[for=threshold]').getBoundingClientRect().right"
    assert (
        visit.page.evaluate(
            f"document.querySelector('#threshold-value').getBoundingClientRect().left - {end}"
        )
        > 8
    )


@both_pages
def test_something_absent_lights_up_only_if_wanted(visit: Visit, viewed: ViewedField):
    plain = visit.picture()
    visit.ask(ABSENT)
    assert difference(visit.picture(), plain) < ALIKE
    assert visit.page.locator("#outlines").is_hidden()
    swatch = visit.row(ABSENT).locator(".swatch")
    assert swatch.evaluate("each => getComputedStyle(each).backgroundColor") == "rgba(0, 0, 0, 0)"
    visit.choose("Only the selection")
    assert difference(visit.picture(), plain) < ALIKE
    visit.tick(ABSENT_TOO)
    assert difference(visit.picture(), render(viewed, selected_by_votes(viewed, ABSENT))) < ALIKE


def test_levels_and_thresholds_select_as_the_library_does(visit: Visit, viewed: ViewedField):
    visit.ask("dishes")  # a group, which the coarse level knows
    visit.choose("Only the selection")
    pixels = patches(visit.picture())
    assert {name for name, patch in pixels.items() if patch.mean() > 40} == {"kettle", "mug"}
    visit.remove("dishes")
    visit.ask(MIXED)
    sizes = set()
    names = {None: "automatic", 0: "s (fine)", 1: "m (medium)", 2: "l (coarse)"}
    for level, threshold in itertools.product(names, (None, 0.3, 0.99)):
        visit.choose(names[level])
        if threshold is None:
            visit.tick(AUTOMATIC)
        else:
            visit.slide("Threshold", threshold)
        visit.settle()
        mask = selected_by_votes(viewed, MIXED, level, threshold)
        sizes.add(int(mask.sum()))
        assert difference(visit.picture(), render(viewed, mask)) < ALIKE, (level, threshold)
    assert len(sizes) >= 5  # they did not all mean the same


def test_codes_and_confidence_are_seen_and_saved(visit: Visit, tmp_path: Path):
    pixels = plain = patches(visit.picture())
    for mode in ("Confidence", "Codes"):
        visit.choose(mode)
        pixels = patches(visit.picture())
        for name, patch in pixels.items():
            assert np.abs(patch - plain[name]).mean() > 10
    means = [patch.mean(0) for patch in pixels.values()]  # unlike things have codes of unlike colours
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(means, 2)) > 20
    saved = np.asarray(Image.open(visit.saved("Save picture", tmp_path)).convert("RGB"))
    assert difference(saved, visit.picture()) < ALIKE
    assert saved.max() > 100


def test_a_click_reads_what_is_there(visit: Visit):
    for name, place in places_in().items():
        said = visit.click(place)
        group = "dishes" if name in ("kettle", "mug") else "furniture"
        first = [
            visit.page.locator(f"#place dd[data-level={level}]").inner_text().split(",")[0] for level in "sml"
        ]
        assert first == [name, name, group]
        assert "position, distance" in said
        assert "views agree" in said
        title = visit.page.locator("#place dd span").first.get_attribute("title") or ""
        assert title.startswith("Relevancy ")
    assert "nothing" in visit.click((0.5, 0.5))


def test_a_selection_is_saved_and_loaded_back(visit: Visit, viewed: ViewedField, tmp_path: Path):
    visit.ask("kettle", "lamp")
    mask = selected_by_votes(viewed, "kettle") | selected_by_votes(viewed, "lamp")
    for mode, wanted in (("Heat", mask), ("All but the selection", ~mask)):
        visit.choose(mode)
        path = visit.saved("Save selection", tmp_path)
        saved = scoup.load_gaussians(path)
        own = viewed.gaussians.select(wanted)
        order, own_order = (torch.argsort(means[:, 0]) for means in (saved.means, own.means))
        torch.testing.assert_close(saved.means[order], own.means[own_order], atol=1e-5, rtol=0)
        torch.testing.assert_close(saved.opacities[order], own.opacities[own_order], atol=3e-3, rtol=0)
        torch.testing.assert_close(saved.scales[order], own.scales[own_order], atol=0, rtol=0.02)
        torch.testing.assert_close(saved.sh[order, 0], own.sh[own_order, 0], atol=8e-3, rtol=0)


@both_pages
def test_what_cannot_be_asked_or_saved_is_said(visit: Visit):
    message = visit.page.locator("#message")
    visit.page.get_by_role("button", name="Save selection").click()
    message.filter(has_text="nothing is selected").wait_for()
    box = visit.page.get_by_label("What do you look for?")
    box.fill("kettel")
    box.press("Enter")
    message.filter(has_text="kettle").wait_for()
    assert "/" not in message.inner_text()  # no folder of the server
    assert visit.state()["queries"] == []
    if visit.page.url.startswith("file:"):
        box.fill("mug left of the kettle")
        box.press("Enter")
        message.filter(has_text="need the field itself").wait_for()
    visit.problems[:] = [line for line in visit.problems if "400" not in line]  # the refusal, in the console
    visit.ask("kettle")
    assert not message.is_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read(browser: Browser, live: str, scheme: str):
    with visiting(browser, live, (900, 1400), color_scheme=scheme) as visit:
        page = visit.page
        sheet = page.evaluate("getComputedStyle(document.getElementById('panel')).backgroundColor")
        assert sheet == {"light": "rgb(255, 255, 255)", "dark": "rgb(30, 33, 38)"}[scheme]
        page.keyboard.press("?")
        states = [page.evaluate(CONTRASTS)]
        page.get_by_role("button", name="Close").click()
        states.append(page.evaluate(CONTRASTS))
        visit.ask("kettle", "mug", ABSENT)
        page.get_by_role("button", name="Hide mug").click()
        visit.click((0.4, 0.4))
        states.append(page.evaluate(CONTRASTS))
        visit.tab("View")
        page.get_by_role("button", name="Exact picture").click()
        page.locator("#badge", has_text="rendered codes").wait_for()
        page.evaluate("document.getElementById('message').textContent = 'Something went wrong.'")
        states.append(page.evaluate(CONTRASTS))
        page.evaluate("document.getElementById('closed-text').textContent = 'closed'")
        page.evaluate("document.getElementById('closed').hidden = false")
        page.evaluate("document.getElementById('loading').hidden = false")
        states.append(page.evaluate(CONTRASTS))
    for texts in states:
        assert len(texts) > 15
        faint = [text for text in texts if text["ratio"] < text["needed"]]
        assert faint == []
    seen = {text["text"] for texts in states for text in texts}
    assert {"Keys and gestures", "kettle, mug", "closed", "Heat", "Something went wrong."} <= seen
