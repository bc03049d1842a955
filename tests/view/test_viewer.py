"""Viewers: a real server of a field, its address and its end, and what it refuses of strangers."""

from __future__ import annotations

import http.client
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("uvicorn", reason="needs scoup[view]")

from view_samples import PAGE, random_field, table, viewed_field

from messages import refuses
from scoup.base import InputError, ScoupError
from scoup.view import viewer as module
from scoup.view.viewer import PORT, Viewer, check_needed, open_viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(autouse=True)
def page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "page_files", lambda: PAGE)


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with Viewer(viewed_field(), port=0) as opened:
        yield opened


def ask(viewer: Viewer, path: str, message: Any = None) -> tuple[int, Any]:
    """Status and JSON of the answer to a request that is sent as it stands: a question where there is a message."""
    place = urlsplit(viewer.address)
    with closing(http.client.HTTPConnection(place.hostname or "", place.port or 0, timeout=60)) as connection:
        connection.request("POST" if message else "GET", path, json.dumps(message) if message else None)
        answer = connection.getresponse()
        return answer.status, json.load(answer)


def test_it_answers_until_it_is_closed(viewer: Viewer) -> None:
    assert viewer.is_open
    assert repr(viewer) == f"Viewer(field at {viewer.address})"
    assert f'src="{viewer.address}"' in viewer._repr_html_()
    status, said = ask(viewer, "/api/query", {"texts": ["thing 1"]})
    assert (status, said["answers"][0]["text"]) == (200, "thing 1")
    viewer.close()
    assert not viewer.is_open
    assert "closed" in viewer._repr_html_()
    with pytest.raises(ConnectionRefusedError):
        ask(viewer, "/api/query", {"texts": ["thing 1"]})
    viewer.close()  # once more does nothing


def test_a_port_in_use_is_named_or_another_is_taken() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port}: .*in use.*another `port`"):
            Viewer(viewed_field(), port=port)
    with Viewer(viewed_field()) as first, Viewer(viewed_field()) as second:
        assert first.address != second.address
        assert first.address.startswith("http://127.0.0.1:")
    assert PORT > 1024
    for host in ("192.0.2.1", "no such host"):
        with pytest.raises(InputError, match=r"is not a host|[Cc]annot assign"):
            Viewer(viewed_field(), host=host, port=0)


def test_a_field_opens_its_viewer() -> None:
    with open_viewer(random_field().with_encoder(table()), words=["thing 3"], height=300) as viewer:
        assert 'height="300"' in viewer._repr_html_()
        assert ask(viewer, "/api/vocabulary")[1]["names"] == ["thing 3"]


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    check_needed()
    monkeypatch.setattr(module, "_NEEDED", ("uvicorn", "no_such_package"))
    with refuses(ScoupError):
        open_viewer(random_field())


def test_nothing_else_is_handed_out(viewer: Viewer) -> None:
    for path in (
        "/../../../../etc/passwd", "/..%2f..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd",
        "/viewer.js/../../viewer.py", "/page/viewer.js", "/page.py", "/.fingerprint", "/field.scoup", "/nothing",
        "/api/thumbnail/../../../etc/passwd", "/api/thumbnail/-1", "/api/thumbnail/99",
        "/api/thumbnail/" + "9" * 5000, "/api/thumbnail/%C2%B2", "\\..\\..\\etc\\passwd",
    ):  # fmt: skip
        status, said = ask(viewer, path)
        assert (status, bool(said["error"])) == (404, True), path


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
  const body = method === "POST" ? JSON.stringify({texts: ["thing 1"]}) : undefined;
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
