"""Fixtures of the viewer's tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from benchmarks.chromium import chromium, program
from browser_support import Browser, Visit, opened, saved_field, visiting

from scoup.query import LanguageField
from scoup.view.export import export_page
from scoup.view.page import PAGE_FOLDER
from scoup.view.viewed_field import ViewedField


# Of a module, not of the session: as long as playwright runs, no other test of this process could run an event loop.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium with one context, in which all pages of a site share a process and its compiled program.

    An idle page of each site keeps that process alive. WebGL draws alone: the rest of a page is composed without it.
    Skips with a reason where there is no browser; with SCOUP_TEST_BROWSER=required that is a failure.
    """
    packages = ("playwright", "starlette", "uvicorn")
    reasons = [f"{package} is not installed" for package in packages if find_spec(package) is None]
    if program() is None:
        reasons.append("there is no Chromium here (apt-get install chromium)")
    if not (PAGE_FOLDER / "viewer.js").is_file():
        reasons.append("the page is not built: python tools/build_viewer.py")
    if reasons:
        (pytest.fail if os.environ.get("SCOUP_TEST_BROWSER") == "required" else pytest.skip)(reasons[0])
    with chromium("--process-per-site", "--disable-gpu-compositing") as opened:
        context = opened.new_context()
        for address in ("http://127.0.0.1/", Path(__file__).as_uri()):
            page = context.new_page()
            page.route("http:**", lambda route: route.fulfill(body=""))
            page.goto(address)
        yield opened


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A field file, with ``words.npz`` beside it."""
    return saved_field(tmp_path_factory.mktemp("viewer"))


@pytest.fixture(scope="module")
def viewed(saved: Path) -> ViewedField:
    return ViewedField(LanguageField.load(saved, words=saved.with_name("words.npz")))


@pytest.fixture(scope="module")
def live(viewed: ViewedField) -> Iterator[str]:
    """Address of a server's page."""
    with opened(viewed) as viewer:
        yield viewer.address


@pytest.fixture(scope="module")
def exported(viewed: ViewedField, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of a page that needs no server."""
    page = tmp_path_factory.mktemp("exported") / "scene.html"
    export_page(viewed, page)
    return page.as_uri()


@pytest.fixture(params=["live", pytest.param("exported", marks=pytest.mark.slow)])
def visit(request: pytest.FixtureRequest, browser: Browser) -> Iterator[Visit]:
    """A visitor of either page; of the exported one without a network."""
    kind = request.param
    with visiting(browser, request.getfixturevalue(kind), offline=kind == "exported") as opened:
        yield opened
