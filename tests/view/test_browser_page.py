"""The page in a real browser: what a visitor types, drags and clicks, and what is seen then.

Everything that the page does by itself is tried with a server, and in an exported page without a network. Then visits
from beginning to end: several visitors, keyboard, telephone, the server's pictures, its end.
"""

from __future__ import annotations

import io
import itertools
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from browser_support import (
    ABSENT,
    ABSENT_TOO,
    ALIKE,
    AUTOMATIC,
    CONTRASTS,
    FRONT,
    LEVELS,
    MIXED,
    Visit,
    both_pages,
    difference,
    opened,
    patches,
    places_in,
    render,
    selected_by_votes,
    served,
    table,
    things_field,
    views,
    visiting,
)
from PIL import Image

import scoup
from cli_support import run_json
from scoup.pictures import Picture
from scoup.view.exact import PictureMode
from scoup.view.viewed_field import ViewedField

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest.importorskip("uvicorn")
pytestmark = pytest.mark.usefixtures("quick_python", "built_page")

LEVEL_WORDS = {"s": "fine", "m": "medium", "l": "coarse"}
BACKGROUND = "each => getComputedStyle(each).backgroundColor"


def test_the_scene_and_the_thing_of_a_text_are_seen(visit: Visit, viewed: ViewedField, tmp_path: Path):
    plain = visit.picture()
    before = patches(plain)
    for name, camera in (("left.png", views()[1].resized(400, 300)), ("front.png", None)):
        visit.tab("View")
        visit.page.get_by_role("button", name=name).click()
        visit.until(f"window.scoupViewer.state().camera === '{name}'")
        visit.settle()
        assert difference(visit.picture(), render(viewed, camera=camera)) < ALIKE
        assert (difference(visit.picture(), plain) > 3 * ALIKE) == (name == "left.png")
    visit.tab("Answers")
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
    visit.remove("kettle")
    for mode in ("Confidence", "Codes"):
        visit.choose(mode)
        after = patches(visit.picture())
        for name, patch in after.items():
            assert np.abs(patch - before[name]).mean() > 10
    means = [patch.mean(0) for patch in after.values()]  # unlike things have codes of unlike colours
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(means, 2)) > 20
    saved = np.asarray(Image.open(visit.saved("Save picture", tmp_path)).convert("RGB"))
    assert difference(saved, visit.picture()) < ALIKE
    assert saved.max() > 100


@both_pages
def test_texts_have_a_colour_and_what_the_library_says(visit: Visit, viewed: ViewedField):
    plain, page = visit.picture(), visit.page
    # What cannot be asked or saved is said.
    message, box = page.locator("#message"), page.get_by_label("What do you look for?")
    page.get_by_role("button", name="Save selection").click()
    message.filter(has_text="nothing is selected").wait_for()
    refused = {"kettel": "kettle"}
    if page.url.startswith("file:"):
        refused["mug left of the kettle"] = "need the field itself"
    for text, said in refused.items():
        box.fill(text)
        box.press("Enter")
        message.filter(has_text=said).wait_for()
        assert "/" not in message.inner_text()  # no folder of the server
        assert visit.state()["queries"] == []
    visit.problems[:] = [line for line in visit.problems if "400" not in line]  # the refusal, in the console
    visit.ask("kettle")
    assert not message.is_visible()
    # The legend.
    answer = viewed.answers(["kettle"])[0]
    low, high = answer.spans[answer.level].tolist()
    legend = page.locator("#legend")  # a colour bar, where there is one text
    said = [part.strip() for part in legend.inner_text().split("\n")]
    assert said == [f"{low:.2f}", f"{high:.2f}", "relevancy to “kettle”"]
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
    assert "present from 0.35" in title
    visit.choose("l (coarse)")  # whose score is another one
    assert [each.inner_text() for each in facts] == ["coarse level", "not here"]
    visit.choose("automatic")
    assert str(mug.certainty) in facts[0].inner_text()
    visit.tab("View")
    assert "kettle 0." in page.locator("#threshold-value").inner_text()
    label, value = (
        page.locator(each).bounding_box() for each in ("label[for=threshold]", "#threshold-value")
    )
    assert label is not None
    assert value is not None
    assert value["x"] - label["x"] - label["width"] > 8
    # Several texts have a colour each.
    visit.remove("mug")
    visit.remove(ABSENT)
    visit.ask("lamp")
    visit.slide("Opacity of the colouring", 1)
    visit.tab("Answers")
    colors = {query["text"]: np.array(query["color"]) for query in visit.state()["queries"]}
    assert set(colors) == {"kettle", "lamp"}
    assert np.abs(colors["kettle"] - colors["lamp"]).max() > 0.3
    seen = patches(visit.picture())
    for text, color in colors.items():
        mean = seen[text].mean(0)
        assert float(mean @ color / np.linalg.norm(mean) / np.linalg.norm(color)) > 0.99
        shown = visit.row(text).locator(".swatch").evaluate(BACKGROUND)
        np.testing.assert_allclose([int(part) for part in shown[4:-1].split(",")], color * 255, atol=1)
    assert np.ptp(seen["mug"], 1).max() < 10
    page.get_by_role("button", name="Hide kettle").click()
    visit.settle()
    seen = patches(visit.picture())
    assert np.ptp(seen["kettle"], 1).max() < 10
    assert np.ptp(seen["lamp"], 1).max() > 50
    visit.remove("lamp")
    assert [query["text"] for query in visit.state()["queries"]] == ["kettle"]
    # Something absent lights up only if wanted.
    visit.remove("kettle")
    visit.ask(ABSENT)
    assert difference(visit.picture(), plain) < ALIKE
    assert page.locator("#outlines").is_hidden()
    assert visit.row(ABSENT).locator(".swatch").evaluate(BACKGROUND) == "rgba(0, 0, 0, 0)"
    visit.choose("Only the selection")
    assert difference(visit.picture(), plain) < ALIKE
    visit.tick(ABSENT_TOO)
    assert difference(visit.picture(), render(viewed, selected_by_votes(viewed, ABSENT))) < ALIKE


def test_levels_clicks_and_files_are_those_of_the_library(visit: Visit, viewed: ViewedField, tmp_path: Path):
    for name, place in places_in().items():
        said = visit.click(place)
        group = "dishes" if name in ("kettle", "mug") else "furniture"
        words = [visit.page.locator(f"#place dd[data-level={level}]").inner_text() for level in "sml"]
        assert [each.split(",")[0] for each in words] == [name, name, group]
        assert "position, distance" in said
        assert "views agree" in said
        title = visit.page.locator("#place dd span").first.get_attribute("title") or ""
        assert title.startswith("Relevancy ")
    assert "nothing" in visit.click((0.5, 0.5))
    visit.ask("kettle", "lamp")
    mask = selected_by_votes(viewed, "kettle") | selected_by_votes(viewed, "lamp")
    for mode, wanted in (("Heat", mask), ("All but the selection", ~mask)):
        visit.choose(mode)
        saved = scoup.load_gaussians(visit.saved("Save selection", tmp_path))
        own = viewed.gaussians.select(wanted)
        order, own_order = (torch.argsort(means[:, 0]) for means in (saved.means, own.means))
        torch.testing.assert_close(saved.means[order], own.means[own_order], atol=1e-5, rtol=0)
        torch.testing.assert_close(saved.opacities[order], own.opacities[own_order], atol=3e-3, rtol=0)
        torch.testing.assert_close(saved.scales[order], own.scales[own_order], atol=0, rtol=0.02)
        torch.testing.assert_close(saved.sh[order, 0], own.sh[own_order, 0], atol=8e-3, rtol=0)
    visit.remove("kettle")
    visit.remove("lamp")
    visit.ask("dishes")  # a group, which the coarse level knows
    visit.choose("Only the selection")
    pixels = patches(visit.picture())
    assert {name for name, patch in pixels.items() if patch.mean() > 40} == {"kettle", "mug"}
    visit.remove("dishes")
    visit.ask(MIXED)
    sizes = set()
    for level, threshold in itertools.product(LEVELS, (None, 0.3, 0.99)):
        visit.choose(LEVELS[level])
        if threshold is None:
            visit.tick(AUTOMATIC)
        else:
            visit.slide("Threshold", threshold)
        mask = selected_by_votes(viewed, MIXED, level, threshold)
        sizes.add(int(mask.sum()))
        assert difference(visit.picture(), render(viewed, mask)) < ALIKE, (level, threshold)
    assert len(sizes) >= 5  # they did not all mean the same


def test_every_text_can_be_read(browser: Browser, live: str):
    states = []
    with visiting(browser, live, (900, 1400), color_scheme="light") as visit:
        page = visit.page

        def look() -> None:
            page.emulate_media(color_scheme="dark")
            assert page.locator("#panel").evaluate(BACKGROUND) == "rgb(30, 33, 38)"
            states.append(page.evaluate(CONTRASTS))
            page.emulate_media(color_scheme="light")
            assert page.locator("#panel").evaluate(BACKGROUND) == "rgb(255, 255, 255)"
            states.append(page.evaluate(CONTRASTS))

        page.keyboard.press("?")
        look()
        page.get_by_role("button", name="Close").click()
        look()
        visit.ask("kettle", "mug", ABSENT)
        page.get_by_role("button", name="Hide mug").click()
        visit.click((0.4, 0.4))
        look()
        visit.tab("View")
        page.get_by_role("button", name="Exact picture").click()
        page.locator("#badge", has_text="rendered codes").wait_for()
        page.evaluate("document.getElementById('message').textContent = 'Something went wrong.'")
        look()
        page.evaluate("document.getElementById('closed-text').textContent = 'closed'")
        page.evaluate("document.getElementById('closed').hidden = false")
        page.evaluate("document.getElementById('loading').hidden = false")
        look()
    for texts in states:
        assert len(texts) > 15
        assert [text for text in texts if text["ratio"] < text["needed"]] == []
    seen = {text["text"] for texts in states for text in texts}
    assert {"Keys and gestures", "kettle, mug", "closed", "Heat", "Something went wrong."} <= seen


# ---- Visits from beginning to end


def exact_picture(visit: Visit) -> Picture:
    """The server's picture that lies over the page's own."""
    script = """async () => {
      const bytes = new Uint8Array(await (await fetch(document.getElementById("picture").src)).arrayBuffer());
      return Array.from(bytes);
    }"""
    return np.asarray(Image.open(io.BytesIO(bytes(visit.page.evaluate(script)))).convert("RGB"))


def exact(viewed: ViewedField, visit: Visit, mode: PictureMode) -> Picture:
    """The library's picture of the texts on the page, in their colours."""
    queries = visit.state()["queries"]
    colors = [tuple(255 * part for part in query["color"]) for query in queries]
    texts, opacity = [query["text"] for query in queries], visit.state()["opacity"]
    return viewed.picture(FRONT, mode, texts, colors, opacity)


def test_visitors_do_not_see_each_others_texts(browser: Browser, live: str):
    with visiting(browser, live) as first, visiting(browser, live) as second:
        first.ask("kettle")
        second.ask("lamp")
        for visit, own in ((first, "kettle"), (second, "lamp")):
            assert [query["text"] for query in visit.state()["queries"]] == [own]
            seen = patches(visit.picture()).items()
            assert {name for name, pixels in seen if np.ptp(pixels, 1).max() > 50} == {own}
            assert "book" in visit.click(places_in()["book"])


def test_the_exact_picture_is_the_methods_own(browser: Browser, live: str, viewed: ViewedField):
    with visiting(browser, live) as visit:
        page = visit.page
        visit.tab("View")
        page.get_by_role("button", name="Exact picture").click()
        page.locator("#badge", has_text="rendered codes").wait_for()
        assert difference(exact_picture(visit), viewed.picture(FRONT)) < ALIKE
        visit.ask("kettle")
        page.locator("#badge", has_text="“kettle” (rendered codes").wait_for()
        shown = exact_picture(visit)
        assert difference(shown, exact(viewed, visit, "heat")) < ALIKE
        visit.ask("lamp")
        page.locator("#badge", has_text="“kettle”, “lamp” (rendered codes").wait_for()
        both = exact_picture(visit)
        assert difference(both, exact(viewed, visit, "heat")) < ALIKE
        for name, pixels in patches(visit.picture()).items():  # the colours of the page
            np.testing.assert_allclose(patches(both)[name].mean(0), pixels.mean(0), atol=40)
        visit.remove("lamp")
        visit.tab("View")
        page.get_by_label("when the camera rests").check()
        page.locator("#canvas").focus()
        for _ in range(3):
            page.keyboard.press("ArrowLeft")
        page.locator("#badge", has_text="rendered codes").wait_for()
        visit.until("!document.getElementById('picture').hidden")
        assert difference(exact_picture(visit), shown) > 3 * ALIKE  # of another view
        page.keyboard.press("x")
        page.locator("#picture").wait_for(state="hidden")
        # A slider does not fill the server's queue.
        visit.tab("View")
        page.get_by_label("when the camera rests").uncheck()
        page.get_by_role("button", name="Exact picture").click()
        page.locator("#badge", has_text="rendered codes").wait_for()
        before = len(visit.requests)
        page.evaluate("for (let i = 0; i < 30; i++) window.scoupViewer.set({ threshold: i / 30 })")
        page.locator("#badge", has_text="rendered codes").wait_for()
        asked = [address for address in visit.requests[before:] if "api/render" in address]
        assert 1 <= len(asked) <= 2  # one under way, and the newest


def test_remote_pages_show_the_servers_pictures_only(browser: Browser, viewed: ViewedField, tmp_path: Path):
    with served(browser, viewed, remote=True) as visit:
        assert difference(visit.picture(), viewed.picture(FRONT)) < ALIKE
        visit.ask("kettle")
        assert difference(visit.picture(), exact(viewed, visit, "heat")) < ALIKE
        assert "kettle" in visit.click(places_in()["kettle"])
        assert visit.page.get_by_role("radio", name="Confidence").is_disabled()
        before = visit.picture()
        visit.page.locator("#canvas").focus()
        for _ in range(3):
            visit.page.keyboard.press("ArrowRight")
        visit.settle()
        assert difference(visit.picture(), before) > 3 * ALIKE
        assert visit.saved("Save selection", tmp_path).suffix == ".ply"
        assert not any("scene.bin" in address for address in visit.requests)


def test_by_keyboard_alone(browser: Browser, live: str):
    with visiting(browser, live) as visit:
        page = visit.page
        page.keyboard.press("/")
        assert page.evaluate("document.activeElement.id") == "text"
        page.keyboard.type("mug")
        page.keyboard.press("Enter")
        visit.row("mug").wait_for()
        page.keyboard.press("Escape")
        modes = ["colour", "heat", "only", "except", "codes", "confidence"]
        for number, mode in enumerate(modes, 1):
            page.keyboard.press(str(number))
            assert visit.state()["mode"] == mode
        assert visit.state()["camera"] == "front.png"
        before = visit.picture()
        for key in ("ArrowLeft", "w", "e"):
            page.keyboard.press(key)
        visit.settle()
        assert visit.state()["camera"] is None
        assert difference(visit.picture(), before) > 3 * ALIKE
        page.keyboard.press("?")
        page.locator("#help").wait_for()
        page.keyboard.press("Escape")
        page.locator("#help").wait_for(state="hidden")
        # Every control is reached by Tab, is seen to be reached, and has a name.
        reached: dict[str, dict[str, Any]] = {}
        for tab in ("View", "Answers"):
            page.get_by_role("tab", name=tab).focus()
            page.keyboard.press("Enter")
            page.evaluate("document.activeElement.blur()")
            of_tab: dict[str, dict[str, Any]] = {}
            for _ in range(60):
                page.keyboard.press("Tab")
                found = page.evaluate(FOCUSED)
                if found is None:
                    continue
                if found["key"] in of_tab:
                    break
                of_tab[found["key"]] = found
            reached |= of_tab
        for found in reached.values():
            assert found["name"], found
            assert found["outlined"], found
        wanted = "text threshold opacity save-selection copy-command canvas measure exact-show"
        assert set(wanted.split()) <= set(reached)
        # The focus stays with choices, sliders and the list of texts.
        visit.remove("mug")
        page.evaluate("window.scoupViewer.flyTo('front.png')")
        page.get_by_role("radio", name="Codes").check()
        page.keyboard.press("2")
        assert visit.state()["mode"] == "heat"
        visit.tab("View")
        page.get_by_label("Opacity").focus()
        page.keyboard.press("ArrowLeft")  # which is the slider's, and does not turn the scene
        assert visit.state()["opacity"] == pytest.approx(0.59)
        assert visit.state()["camera"] == "front.png"
        visit.tab("Answers")
        visit.ask("kettle", "mug")
        focused = "document.activeElement.getAttribute('aria-label')"
        for name, wanted in (("Hide kettle", "Show kettle"), ("Remove kettle", "Remove mug")):
            page.get_by_role("button", name=name).focus()
            page.keyboard.press("Enter")
            assert page.evaluate(focused) == wanted


FOCUSED = """() => {
  const element = document.activeElement;
  if (!element || element === document.body) return null;
  const all = [...document.querySelectorAll("*")];
  const outlined = [element, element.parentElement].some((each) => {
    const style = getComputedStyle(each);
    return style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2;
  });
  const labels = [...(element.labels ?? [])].map((label) => label.textContent.trim()).join(" ");
  const name = element.getAttribute("aria-label") || labels || element.textContent.trim();
  return {key: element.id || `${all.indexOf(element)}`, tag: element.tagName, name, outlined};
}"""


@pytest.mark.parametrize("width", [360, pytest.param(390, marks=pytest.mark.slow)])
def test_on_a_telephone(browser: Browser, live: str, viewed: ViewedField, width: int):
    with visiting(browser, live, (width, 740), has_touch=True, is_mobile=True) as visit:
        page = visit.page
        controls = page.get_by_role("button", name="Show or hide the controls")
        controls.tap()
        visit.settle()
        # A high picture shows all that the camera sees.
        page.get_by_role("tab", name="View").wait_for(state="hidden")
        picture = visit.picture()
        height, wide = picture.shape[:2]
        assert height > wide
        seen = views()[0].resized(wide, wide * 3 // 4)
        above = (height - seen.height) // 2
        middle = picture[above : above + seen.height]
        assert difference(middle, render(viewed, camera=seen)) < 2 * ALIKE  # up to half a pixel
        taller = page.locator("#canvas").bounding_box()
        controls.tap()
        box = page.get_by_label("What do you look for?")
        box.fill("kettle")
        page.get_by_role("button", name="Find").tap()
        visit.row("kettle").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator("#panel").evaluate("panel => panel.scrollWidth <= panel.clientWidth")
        size = page.locator("#canvas").bounding_box()
        assert size is not None
        assert taller is not None
        assert 0.3 * 740 < size["height"] < taller["height"]
        assert size["width"] == width
        page.touchscreen.tap(width / 2, 5)
        page.locator("#place").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for button in page.locator("button:visible").all():
            area = button.bounding_box() or {"height": 0, "width": 0}
            assert min(area["height"], area["width"]) >= 24, button.inner_text()


def test_what_is_copied_does_what_is_seen(
    browser: Browser, live: str, viewed: ViewedField, tmp_path: Path, monkeypatch
):
    permissions = ["clipboard-read", "clipboard-write"]
    with visiting(browser, live, permissions=permissions) as visit:
        page = visit.page

        def copied(button: str) -> str:
            visit.tab("Answers")
            page.get_by_role("button", name=button).click()
            visit.until("navigator.clipboard.readText().then((text) => text.includes('kettle'))")
            return page.evaluate("navigator.clipboard.readText()")

        visit.ask("kettle")
        visit.choose("m (medium)")
        visit.slide("Threshold", 0.7)
        command = copied("Copy as command line")
        page.evaluate("navigator.clipboard.writeText('')")
        program = copied("Copy as Python")
        visit.ask("mug")
        visit.choose("All but the selection")
        page.evaluate("navigator.clipboard.writeText('')")
        rest = copied("Copy as Python")
    monkeypatch.chdir(tmp_path)
    wanted = selected_by_votes(viewed, "kettle", 1, 0.7)
    lines = command.splitlines()
    assert lines[0].startswith("scoup select ")
    for line in lines:
        run_json(*shlex.split(line)[1:])
        assert "--level m" in line
        assert "--threshold 0.7" in line
    assert len(lines) == 2
    saved = scoup.load_gaussians(re.findall(r"--out (\S+)", lines[0])[0])
    assert torch.equal(saved.means, viewed.gaussians.means[wanted])
    names: dict[str, Any] = {}
    exec(compile(program, "copied", "exec"), names)
    assert (names["seen"].view, names["seen"].answer.threshold) == ("front.png", 0.7)
    part = scoup.LanguageField.load(next(Path().glob("*.scoup")))
    assert torch.equal(part.gaussians.means, viewed.gaussians.means[wanted])
    exec(compile(rest, "copied", "exec"), {})
    without = scoup.LanguageField.load("without_kettle.scoup")  # and without the mug
    both = wanted | selected_by_votes(viewed, "mug", 1, 0.7)
    assert torch.equal(without.gaussians.means, viewed.gaussians.means[~both])


def test_the_page_goes_on_when_its_server_is_back_with_its_field(browser: Browser, viewed: ViewedField):
    other = ViewedField(things_field().with_encoder(table()))
    other.field.codebook[0, 0] = other.field.codebook[0, 1]  # the same splat, other codes
    assert other.identity != viewed.identity
    first = opened(viewed)
    port = int(re.findall(r":(\d+)/", first.address)[0])
    with visiting(browser, first.address) as visit:
        visit.ask("kettle")
        first.close()
        dialog = visit.page.get_by_role("alertdialog")
        dialog.wait_for()
        assert f"The server was closed. Start it again: scoup view {viewed.path}" in dialog.inner_text()
        with opened(viewed, port=port):
            dialog.wait_for(state="hidden")
            visit.ask("mug")
            assert len(visit.state()["queries"]) == 2
        dialog.wait_for()
        with opened(other, port=port):
            dialog.filter(has_text="Another field is served here now").wait_for()
        visit.problems.clear()
