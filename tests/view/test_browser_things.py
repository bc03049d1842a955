"""The page in a real browser on a field with things: they light up and are saved as `scoup select` selects them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch
from browser_support import ALIKE, Visit, difference, field_of_instances, table, visiting

import scoup
from scoup import raster
from scoup.pictures import as_picture
from scoup.pictures.colors import Picture
from scoup.query.answering import answer_scene
from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest.importorskip("uvicorn")
pytestmark = pytest.mark.usefixtures("built_page")

LEVELS = {None: "automatic", 0: "s (fine)", 1: "m (medium)", 2: "l (coarse)"}


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return ViewedField(field_of_instances(), table())


@pytest.fixture(params=["live", "exported"])
def visit(
    request: pytest.FixtureRequest, browser: Browser, viewed: ViewedField, tmp_path: Path
) -> Iterator[Visit]:
    """A visitor of a server's page, or of one that needs none."""
    if request.param == "exported":
        export_page(viewed, tmp_path / "scene.html")
        with visiting(browser, (tmp_path / "scene.html").as_uri(), offline=True) as opened:
            yield opened
        return
    from scoup.view.viewer import Viewer

    with Viewer(viewed, port=0) as viewer, visiting(browser, viewer.address) as opened:
        yield opened


def selected(
    viewed: ViewedField, text: str, level: int | None = None, threshold: float | None = None
) -> torch.Tensor:
    """[N] what `scoup select` selects."""
    return answer_scene(viewed.field, viewed.question([text], always=True, threshold=threshold, level=level))[
        0
    ].mask


def render(viewed: ViewedField, mask: torch.Tensor) -> Picture:
    """What is to be seen of some of the Gaussians where the page opens."""
    assert viewed.field.cameras is not None
    camera = viewed.field.cameras[0].resized(400, 300)
    return as_picture(raster.render_colors(viewed.gaussians.select(mask), camera))


def test_things_light_up_until_a_threshold_is_set(visit: Visit, viewed: ViewedField) -> None:
    by_things, answer = selected(viewed, "kettle"), viewed.answers(["kettle"])[0]
    by_votes = selected(viewed, "kettle", answer.level, 0.5)
    assert answer.chosen_things is not None
    assert (int(by_things.sum()), int(by_votes.sum())) == (90, 60)
    visit.ask("kettle")
    assert "90 Gaussians" in visit.row("kettle").inner_text()
    assert visit.page.locator("#threshold-value").inner_text() == "things"
    visit.choose("Only the selection")
    assert difference(visit.picture(), render(viewed, by_things)) < ALIKE
    visit.slide("Threshold", 0.5)
    assert difference(visit.picture(), render(viewed, by_votes)) < ALIKE
    assert difference(visit.picture(), render(viewed, by_things)) > 3 * ALIKE
    visit.page.get_by_label("automatic, for each text").check()
    visit.settle()
    for level, name in LEVELS.items():
        visit.choose(name)
        wanted = selected(viewed, "kettle", level)
        assert difference(visit.picture(), render(viewed, wanted)) < ALIKE, name
    visit.choose("automatic")
    visit.choose("All but the selection")
    assert difference(visit.picture(), render(viewed, ~by_things)) < ALIKE


def test_things_and_votes_answer_side_by_side(visit: Visit, viewed: ViewedField, tmp_path: Path) -> None:
    assert [answer.chosen_things is None for answer in viewed.answers(["lamp", "mug"])] == [True, False]
    assert viewed.answers(["kettle"])[0].chosen_things is not None
    visit.ask("lamp", "kettle")
    wanted = selected(viewed, "lamp") | selected(viewed, "kettle")
    visit.choose("Only the selection")
    assert difference(visit.picture(), render(viewed, wanted)) < ALIKE
    with visit.page.expect_download() as download:
        visit.page.get_by_role("button", name="Save selection").click()
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    saved, own = scoup.load_gaussians(path).means, viewed.gaussians.select(wanted).means
    assert len(saved) == len(own)
    apart = (saved[:, None].double() - own).norm(dim=2)
    assert max(apart.amin(0).max(), apart.amin(1).max()) < 1e-5
    visit.page.get_by_role("button", name="Remove lamp").click()
    visit.settle()
    assert difference(visit.picture(), render(viewed, selected(viewed, "kettle"))) < ALIKE
