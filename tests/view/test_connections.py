"""Connections that are too many, or slow: real sockets against a real viewer."""

from __future__ import annotations

import socket
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from urllib.parse import urlsplit

import pytest

pytest.importorskip("uvicorn", reason="needs scoup[view]")
from view_samples import PAGE, viewed_field

from scoup.view import connections
from scoup.view.viewer import Viewer


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    monkeypatch.setattr("scoup.view.viewer.page_files", lambda: PAGE)
    with Viewer(viewed_field(count=40), port=0) as opened:
        yield opened


def connect(viewer: Viewer, sent: str = "") -> socket.socket:
    parts = urlsplit(viewer.address)
    found = socket.create_connection((parts.hostname or "", parts.port or 0), timeout=30)
    found.sendall(sent.replace("PATH", parts.path).replace("HOST", parts.netloc).encode())
    return found


def is_closed_by_the_server(opened: socket.socket) -> bool:
    """Waits for it; time-outs raise."""
    try:
        while opened.recv(65_536):
            pass
    except ConnectionResetError:
        return True
    return True


def answers(viewer: Viewer) -> bool:
    with urllib.request.urlopen(f"{viewer.address}api/alive", timeout=30) as answer:
        return answer.status == 204


@pytest.mark.parametrize(
    "sent",
    [
        "",
        "GET PATH",
        "GET PATHapi/alive HTTP/1.1\r\nHost: HOST\r\nX-Slow: ",
        "POST PATHapi/query HTTP/1.1\r\nHost: HOST\r\nContent-Length: 40\r\n\r\n{",
        # A whole request, and half of a second one.
        "GET PATHapi/alive HTTP/1.1\r\nHost: HOST\r\n\r\nGET PATH",
    ],
)
def test_who_does_not_end_a_request_is_let_go(viewer: Viewer, monkeypatch, sent: str) -> None:
    monkeypatch.setattr(connections, "SECONDS", 0.2)
    monkeypatch.setattr(viewer._server.config, "timeout_keep_alive", 0.2)
    with connect(viewer, sent) as opened:
        assert is_closed_by_the_server(opened)
    assert answers(viewer)


def test_more_than_so_many_are_turned_away_and_the_rest_is_served(viewer: Viewer, monkeypatch) -> None:
    monkeypatch.setattr(connections, "MOST", 5)
    monkeypatch.setattr(connections, "SECONDS", 600.0)
    with ExitStack() as stack:
        kept = [stack.enter_context(connect(viewer, "GET PATH")) for _ in range(5)]
        for _ in range(30):
            with connect(viewer) as refused:
                assert is_closed_by_the_server(refused)
        parts = urlsplit(viewer.address)
        rest = f"api/alive HTTP/1.1\r\nHost: {parts.netloc}\r\nConnection: close\r\n\r\n"
        for opened in kept:
            opened.sendall(rest.encode())
            assert opened.recv(100).startswith(b"HTTP/1.1 204")
    assert answers(viewer)


def test_one_who_waits_for_a_long_answer_is_not_slow(viewer: Viewer, monkeypatch) -> None:
    monkeypatch.setattr(connections, "SECONDS", 0.2)
    import time

    slow = viewer.viewed.vocabulary

    def vocabulary():
        time.sleep(1.0)
        return slow()

    monkeypatch.setattr(viewer.viewed, "vocabulary", vocabulary)
    with urllib.request.urlopen(f"{viewer.address}api/vocabulary", timeout=30) as answer:
        assert answer.status == 200
