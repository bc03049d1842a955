"""Files of ``scoup select`` and ``scoup label`` in SuperSplat; CONTRIBUTING.md says how to build it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser_support import A_THING, THINGS, Browser, Page, Route, Visit, saved_field

from cli_support import run_json
from scoup.io import PlyTable

PROGRAM = os.environ.get("SCOUP_SUPERSPLAT")
pytestmark = pytest.mark.skipif(not PROGRAM, reason="SCOUP_SUPERSPLAT names no folder `dist` of SuperSplat")
COUNTS = """() => {
  const [{splatData, numSelected, numDeleted}] = scene.events.invoke("scene.splats");
  return [splatData.numSplats, numSelected, numDeleted];
}"""
EXPORT = (
    "scene.events.invoke('scene.write', 'ply', {filename: 'out.ply', splatIdx: 'all', serializeSettings: {}})"
)


@pytest.fixture
def page(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    """A page with the files of a folder that has a field."""
    saved_field(tmp_path)
    visit = Visit(browser.contexts[0].new_page())

    def serve(route: Route) -> None:
        name = route.request.url.split("?")[0].split("/", 3)[3]
        files = (tmp_path / name, Path(PROGRAM or "", name))
        route.fulfill(path=next(file for file in files if file.is_file()))

    visit.page.route("**/*", serve)
    yield visit.page
    assert visit.problems == []
    visit.page.close()


def counts(page: Page, file: str) -> list[int]:
    """Open a file; return how many Gaussians it has in SuperSplat, selected ones, deleted ones."""
    page.goto(f"http://splat.test/index.html?load=/{file}")
    page.wait_for_function("window.scene?.events.invoke('scene.splats')?.length")
    return page.evaluate(COUNTS)


def test_a_selection_is_live_and_labels_do_not_matter(page: Page, tmp_path: Path) -> None:
    field, whole = tmp_path / "things.scoup", len(THINGS) * A_THING
    run_json("label", field, "kettle", "--out", tmp_path / "labels", "--outputs", "ids")
    assert counts(page, "labels/labels.ply") == [whole, 0, 0]
    record = run_json("select", field, "kettle", "--edit", "state", "--out", tmp_path / "live.ply")
    assert counts(page, "live.ply") == [whole, record["selected"], 0]
    page.keyboard.press("Delete")
    page.wait_for_function(f"({COUNTS})()[2]")
    with page.expect_download() as download:
        page.evaluate(EXPORT)
    download.value.save_as(tmp_path / "out.ply")
    left, table = PlyTable.read(tmp_path / "out.ply"), PlyTable.read(tmp_path / "live.ply")
    wanted = table.rows[table.rows["state"] == 0][list(left.names)]
    assert sorted(left.rows.tolist()) == sorted(wanted.tolist())  # SuperSplat has an order of its own
