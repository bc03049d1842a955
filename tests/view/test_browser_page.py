"""The page in a real browser: what a visitor types, drags and clicks, and what is seen then.

Everything that the page does by itself is tried with a server, and in an exported page without a network.
"""

from __future__ import annotations

import itertools
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from browser_support import (
    ABSENT,
    ABSENT_TOO,
    ALIKE,
    AUTOMATIC,
    CONTRASTS,
    LEVELS,
    MIXED,
    Browser,
    Visit,
    both_pages,
    check_saved,
    difference,
    patches,
    places_in,
    render,
    views,
    visiting,
)
from view_samples import selected_by_votes

from scoup.view.viewed_field import ViewedField

LEVEL_WORDS = {"s": "fine", "m": "medium", "l": "coarse"}
BACKGROUND = "each => getComputedStyle(each).backgroundColor"


def test_pictures_clicks_and_files_are_those_of_the_library(
    visit: Visit, viewed: ViewedField, tmp_path: Path
):
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
    assert [name for name, pixels in after.items() if np.ptp(pixels, 1).max() >= 10] == ["kettle"]
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
    # Clicks and files.
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
        check_saved(visit.saved("Save selection", tmp_path), viewed.gaussians.select(wanted))
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


@both_pages
def test_texts_have_a_colour_and_what_the_library_says(visit: Visit, viewed: ViewedField):
    plain, page = visit.picture(), visit.page
    # What cannot be asked or saved is said.
    message, box = page.locator("#message"), page.get_by_label("What do you look for?")
    page.get_by_role("button", name="Save selection").click()
    message.filter(has_text="nothing is selected").wait_for()
    for text, said in {"kettel": "kettle", "mug left of the kettle": "this field has no things"}.items():
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
    assert legend.inner_text().split("\n") == [f"{low:.2f}", f"{high:.2f}", "relevancy to “kettle”"]
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
    box = "document.querySelector('{}').getBoundingClientRect()"
    gap = f"{box.format('#threshold-value')}.left - {box.format('label[for=threshold]')}.right"
    assert page.evaluate(gap) > 8
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


def test_every_text_can_be_read(browser: Browser, live: str):
    states = []
    with visiting(browser, live, (900, 1400)) as visit:
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
        visit.show_exact()
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


READ = """async ([address, method]) => {
  const body = method === "POST" ? JSON.stringify({texts: ["kettle"]}) : undefined;
  try { return (await fetch(address, {method, body})).status; } catch (error) { return error.name; }
}"""
DRAW = """(address) => {
  const picture = Object.assign(new Image(), {src: address});
  return picture.decode().then(() => "loaded", () => "refused");
}"""
FRAME = """(address) => new Promise((done) => {
  const frame = document.createElement("iframe");
  frame.onload = () => { try { done(frame.contentDocument ? "read" : "closed"); } catch { done("closed"); } };
  frame.src = address;
  document.body.append(frame);
})"""


def test_a_page_of_another_site_gets_nothing(browser: Browser, live: str, tmp_path: Path) -> None:
    page = browser.contexts[0].new_page()
    handler = partial(SimpleHTTPRequestHandler, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        for method, path in (("GET", "scene.bin"), ("GET", "api/scene"), ("POST", "api/query")):
            assert page.evaluate(READ, [live + path, method]) == "TypeError", path
        assert page.evaluate(DRAW, f"{live}api/thumbnail/0") == "refused"
        assert page.evaluate(FRAME, live) == "closed"
        # The same from its own page, so that the refusals above are about the site.
        page.goto(live)
        assert page.evaluate(READ, [f"{live}api/query", "POST"]) == 200
        assert page.evaluate(DRAW, f"{live}api/thumbnail/0") == "loaded"
        server.shutdown()
    page.close()
