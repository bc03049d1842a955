"""Visits from beginning to end: several visitors, keyboard, telephone, the server's pictures, its end, and the element
<scoup-view> of viewer/element within another page."""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from browser_support import (
    ALIKE,
    FRONT,
    PATIENCE,
    Browser,
    Page,
    Route,
    Visit,
    difference,
    field_of_instances,
    opened,
    patches,
    places_in,
    render,
    served,
    table,
    things_field,
    views,
    visiting,
)
from PIL import Image
from view_samples import selected_by_votes

import scoup
from cli_support import run_json
from scoup.pictures import Picture
from scoup.view.exact import PictureMode
from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField


def exact_picture(visit: Visit) -> Picture:
    """The server's picture that lies over the page's own."""
    script = "fetch(document.getElementById('picture').src).then((answer) => answer.arrayBuffer())"
    script += ".then((buffer) => Array.from(new Uint8Array(buffer)))"
    return np.asarray(Image.open(io.BytesIO(bytes(visit.page.evaluate(script)))).convert("RGB"))


def exact(viewed: ViewedField, visit: Visit, mode: PictureMode) -> Picture:
    """The library's picture of the texts on the page, in their colours."""
    queries = visit.state()["queries"]
    colors = [tuple(255 * part for part in query["color"]) for query in queries]
    texts, opacity = [query["text"] for query in queries], visit.state()["opacity"]
    return viewed.picture(FRONT, mode, texts, colors, opacity)


def test_the_exact_picture_is_the_methods_own(browser: Browser, live: str, viewed: ViewedField):
    with visiting(browser, live) as other, visiting(browser, live) as visit:
        page = visit.page
        visit.show_exact()
        assert difference(exact_picture(visit), viewed.picture(FRONT)) < ALIKE
        other.ask("lamp")
        visit.ask("kettle")
        page.locator("#badge", has_text="“kettle” (rendered codes").wait_for()
        for each, own in ((visit, "kettle"), (other, "lamp")):  # visitors do not see each other's texts
            assert [query["text"] for query in each.state()["queries"]] == [own]
            seen = patches(each.picture()).items()
            assert {name for name, pixels in seen if np.ptp(pixels, 1).max() > 50} == {own}
            assert "book" in each.click(places_in()["book"])
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
        visit.show_exact()
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
            keys: list[str] = []
            while len(keys) < 60 and len(keys) == len(set(keys)):  # until one comes again
                page.keyboard.press("Tab")
                if found := page.evaluate(FOCUSED):
                    keys.append(found["key"])
                    reached[found["key"]] = found
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
  return {key: element.id || `${all.indexOf(element)}`, name, outlined};
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
        size = "(({width, height}) => [width, height])(document.getElementById('canvas').getBoundingClientRect())"
        taller = page.evaluate(size)
        controls.tap()
        box = page.get_by_label("What do you look for?")
        box.fill("kettle")
        page.get_by_role("button", name="Find").tap()
        visit.row("kettle").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator("#panel").evaluate("panel => panel.scrollWidth <= panel.clientWidth")
        assert 0.3 * 740 < page.evaluate(size)[1] < taller[1]
        assert page.evaluate(size)[0] == width
        page.touchscreen.tap(width / 2, 5)
        page.locator("#place").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for button in page.locator("button:visible").all():
            area = button.bounding_box() or {"height": 0, "width": 0}
            assert min(area["height"], area["width"]) >= 24, button.inner_text()


def test_what_is_copied_does_what_is_seen(
    browser: Browser, live: str, viewed: ViewedField, tmp_path: Path, monkeypatch
):
    with visiting(browser, live) as visit:
        page = visit.page
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])

        def copied(button: str) -> str:
            page.evaluate("navigator.clipboard.writeText('')")
            visit.tab("Answers")
            page.get_by_role("button", name=button).click()
            visit.until("navigator.clipboard.readText().then((text) => text.includes('kettle'))")
            return page.evaluate("navigator.clipboard.readText()")

        visit.ask("kettle")
        visit.choose("m (medium)")
        visit.slide("Threshold", 0.7)
        command, program = copied("Copy as command line"), copied("Copy as Python")
        visit.ask("mug")
        visit.choose("All but the selection")
        rest = copied("Copy as Python")
    monkeypatch.chdir(tmp_path)
    wanted = selected_by_votes(viewed, "kettle", 1, 0.7)
    select, query = command.splitlines()
    assert select.startswith("scoup select ")
    for line in (select, query):
        assert "--threshold 0.7 --level m" in line
        run_json(*shlex.split(line)[1:])
    saved = scoup.load_gaussians(re.findall(r"--out (\S+)", select)[0])
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


# ---- <scoup-view>


ELEMENT = Path(__file__).resolve().parents[2] / "viewer" / "element"
FORGED = {"scoup": "asked", "detail": {"answers": [{"text": "forged", "present": True}]}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example page beside the page it shows, and another site that sends the same messages."""
    out = tmp_path_factory.mktemp("element")
    shutil.copytree(ELEMENT, out, dirs_exist_ok=True)
    export_page(ViewedField(field_of_instances().with_encoder(table())), out / "scene.scoup.html")
    (out / "other.html").write_text(
        f"<script>setInterval(() => parent.postMessage({json.dumps(FORGED)}, '*'), 20)</script>"
    )
    return out


@pytest.fixture(params=["file", "http"])
def page(request: pytest.FixtureRequest, browser: Browser, folder: Path) -> Iterator[Page]:
    page = browser.contexts[0].new_page()
    page.set_default_timeout(PATIENCE)

    def serve(route: Route) -> None:
        route.fulfill(path=folder / route.request.url.rsplit("/", 1)[1])

    page.route(lambda url: url.startswith("http:"), serve)
    start = folder.as_uri() if request.param == "file" else "http://scene.test"
    page.goto(f"{start}/example.html")
    yield page
    page.close()


def test_it_says_what_is_asked_and_selected_to_its_own_page_only(page: Page) -> None:
    page.evaluate("heard = []; window.addEventListener('message', ({ data }) => heard.push(data))")
    frame = page.frame_locator("scoup-view iframe")
    text = frame.get_by_label("What do you look for?")
    text.fill("kettle, furniture")
    text.press("Enter")
    asked = page.locator("#asked").filter(has_text="kettle: here, furniture: not here")
    asked.wait_for()
    canvas = frame.locator("#canvas")
    box = canvas.bounding_box()
    assert box is not None
    x, y = places_in(views()[0].resized(round(box["width"]), round(box["height"])))["mug"]
    canvas.click(position={"x": x * box["width"], "y": y * box["height"]})
    page.locator("#selected").filter(has_text="mug at ").wait_for()
    text.press("Escape")
    page.locator("#selected:empty").wait_for(state="attached")
    inner = page.frames[1]
    page.evaluate("heard = []")
    if page.url.startswith("http:"):  # an exported page tells other sites nothing
        inner.goto("http://elsewhere.test/scene.scoup.html")
        inner.locator("#loading").wait_for(state="hidden")
        inner.evaluate("window.scoupViewer.ask(['kettle'])")
        inner.evaluate("parent.postMessage('last', '*')")
        page.wait_for_function("heard.includes('last')")
        assert page.evaluate("heard") == ["last"]
    heard = page.evaluate("heard.length")
    # The element does not hear other windows and sites.
    page.evaluate("forged => window.postMessage(forged, '*')", FORGED)
    inner.goto("http://elsewhere.test/other.html")
    page.wait_for_function(f"heard.length >= {heard + 3}")
    assert asked.is_visible()
    page.evaluate("document.querySelector('scoup-view').removeAttribute('src')")
    assert page.locator("scoup-view iframe").get_attribute("src") == "about:blank"
