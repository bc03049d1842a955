"""What the viewer's server refuses of strangers, over real connections and from pages of other sites."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest
from browser_support import table, things_field
from view_samples import PAGE

from scoup.view.viewed_field import ViewedField
from scoup.view.viewer import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return ViewedField(things_field().with_encoder(table()))


@contextmanager
def served(viewed: ViewedField, host: str = "127.0.0.1") -> Iterator[Viewer]:
    """A viewer; its page need not have been built."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scoup.view.viewer.page_files", lambda: PAGE)
        viewer = Viewer(viewed, host, port=0)
    with viewer:
        yield viewer


@pytest.fixture(scope="module")
def viewer(viewed: ViewedField) -> Iterator[Viewer]:
    with served(viewed) as opened:
        yield opened


def ask(
    viewer: Viewer, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, bytes]:
    """Status and body of the answer to a request that is sent as it stands."""
    place = urlsplit(viewer.address)
    connection = http.client.HTTPConnection(place.hostname or "", place.port or 0, timeout=60)
    try:
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, names)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def refusal(answer: tuple[int, bytes]) -> tuple[int, str]:
    """Status and sentence of a refusal."""
    status, body = answer
    return status, json.loads(body)["error"]


@pytest.mark.parametrize("path", [
    "/../../../../etc/passwd", "/..%2f..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd",
    "/viewer.js/../../viewer.py", "/page/viewer.js", "/page.py", "/.fingerprint", "/field.scoup", "/nothing",
    "/api/thumbnail/../../../etc/passwd", "/api/thumbnail/-1", "/api/thumbnail/99", "/api/thumbnail/" + "9" * 5000,
    "/api/thumbnail/%C2%B2", "\\..\\..\\etc\\passwd",
])  # fmt: skip
def test_nothing_else_is_handed_out(viewer: Viewer, path: str):
    status, sentence = refusal(ask(viewer, "GET", path))
    assert (status, bool(sentence)) == (404, True)


@contextmanager
def another_site() -> Iterator[str]:
    """Address of an empty page."""

    class Empty(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>another site</title>")

        def log_message(self, format: str, *arguments: Any) -> None:
            del format, arguments

    with ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


READ = """async ([address, method]) => {
  const body = method === "POST" ? JSON.stringify({texts: ["kettle"]}) : undefined;
  try { return (await fetch(address, {method, body})).status; } catch (error) { return error.name; }
}"""
DRAW = """(address) => new Promise((done) => {
  const picture = new Image();
  picture.onload = () => done("loaded");
  picture.onerror = () => done("refused");
  picture.src = address;
})"""
FRAME = """(address) => new Promise((done) => {
  const frame = document.createElement("iframe");
  frame.onload = () => { try { done(frame.contentDocument ? "read" : "closed"); } catch { done("closed"); } };
  frame.src = address;
  document.body.append(frame);
})"""


def test_a_page_of_another_site_gets_nothing(browser: Browser, viewer: Viewer):
    page = browser.new_page()
    with another_site() as site:
        page.goto(site)
        for method, path in (("GET", "scene.bin"), ("GET", "api/scene"), ("POST", "api/query")):
            assert page.evaluate(READ, [viewer.address + path, method]) == "TypeError", path
        assert page.evaluate(DRAW, f"{viewer.address}api/thumbnail/0") == "refused"
        assert page.evaluate(FRAME, viewer.address) == "closed"
        # The same from its own page, so that the refusals above are about the site.
        page.goto(viewer.address)
        assert page.evaluate(READ, [f"{viewer.address}api/query", "POST"]) == 200
        assert page.evaluate(DRAW, f"{viewer.address}api/thumbnail/0") == "loaded"
    page.close()
