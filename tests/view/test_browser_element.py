"""The element <scoup-view> of viewer/element within another page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browser_support import PATIENCE, field_of_instances, places_in, table, views

from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

pytestmark = pytest.mark.usefixtures("built_page")

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
    page = browser.new_page()
    page.set_default_timeout(PATIENCE)

    def serve(route: Route) -> None:
        route.fulfill(path=folder / route.request.url.rsplit("/", 1)[1])

    page.route(lambda url: url.startswith("http:"), serve)
    start = folder.as_uri() if request.param == "file" else "http://scene.test"
    page.goto(f"{start}/example.html")
    yield page
    page.close()


def test_it_says_what_is_asked_and_selected(page: Page) -> None:
    frame = page.frame_locator("scoup-view iframe")
    text = frame.get_by_label("What do you look for?")
    text.fill("kettle, furniture")
    text.press("Enter")
    page.get_by_text("kettle: here, furniture: not here").wait_for()
    canvas = frame.locator("#canvas")
    box = canvas.bounding_box()
    assert box is not None
    x, y = places_in(views()[0].resized(round(box["width"]), round(box["height"])))["mug"]
    canvas.click(position={"x": x * box["width"], "y": y * box["height"]})
    page.locator("#selected").filter(has_text="mug at ").wait_for()
    text.press("Escape")
    page.locator("#selected:empty").wait_for(state="attached")


def test_it_hears_its_own_page_only(page: Page) -> None:
    page.evaluate("window.heard = 0; window.addEventListener('message', () => { heard += 1 })")
    page.evaluate("forged => window.postMessage(forged, '*')", FORGED)  # of another window
    frame = 'document.querySelector("scoup-view").shadowRoot.querySelector("iframe").contentWindow'
    page.evaluate(f"{frame}.location = 'http://elsewhere.test/other.html'")  # another site
    page.wait_for_function("heard >= 3")
    assert page.locator("#asked").inner_text() == "Ask for something."
    page.evaluate("document.querySelector('scoup-view').removeAttribute('src')")
    assert page.locator("scoup-view iframe").get_attribute("src") == "about:blank"


def test_an_exported_page_tells_other_sites_nothing(page: Page) -> None:
    page.evaluate("heard = []; window.addEventListener('message', ({ data }) => heard.push(data))")
    frame = page.frames[1]
    frame.goto("http://elsewhere.test/scene.scoup.html")
    frame.locator("#loading").wait_for(state="hidden")
    frame.evaluate("window.scoupViewer.ask(['kettle'])")
    frame.evaluate("parent.postMessage('last', '*')")
    page.wait_for_function("heard.includes('last')")
    assert page.evaluate("heard") == ["last"]
