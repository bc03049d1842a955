"""Connections that are too many, or slow: real sockets against a real viewer."""

from __future__ import annotations

import asyncio
import random
import socket
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("uvicorn", reason="needs scoup[view]")
from starlette.responses import Response
from view_samples import PAGE, viewed_field

from scoup.view import connections
from scoup.view.guard import Guard
from scoup.view.server import _Guarded
from scoup.view.viewer import Viewer

ASK_LICENCES = "GET PATHlicences.txt HTTP/1.1\r\nHost: HOST\r\n\r\n"
ASK_ALIVE = ASK_LICENCES.replace("licences.txt", "api/alive")
POST = "POST PATHapi/query HTTP/1.1\r\nHost: HOST\r\nContent-Length: 40\r\n\r\n"


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    page = replace(PAGE, licences="x" * (32 << 20))  # more than the system takes
    monkeypatch.setattr("scoup.view.viewer.page_files", lambda: page)
    with Viewer(viewed_field(count=40), port=0) as opened:
        yield opened


def connect(viewer: Viewer, sent: str = "") -> socket.socket:
    parts = urlsplit(viewer.address)
    found = socket.create_connection((parts.hostname or "", parts.port or 0), timeout=30)
    found.sendall(sent.replace("PATH", parts.path).replace("HOST", parts.netloc).encode())
    return found


def until_closed(opened: socket.socket) -> None:
    """Wait until the server closed a connection; time-outs raise."""
    with suppress(ConnectionResetError):
        while opened.recv(65_536):
            pass


def answers(viewer: Viewer) -> bool:
    with urllib.request.urlopen(f"{viewer.address}api/alive", timeout=30) as answer:
        return answer.status == 204


def test_who_does_not_end_a_request_is_let_go(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "SECONDS", 0.2)
    monkeypatch.setattr(viewer._server.config, "timeout_keep_alive", 0.2)
    for sent in (
        "",
        "GET PATH",
        "GET PATHapi/alive HTTP/1.1\r\nHost: HOST\r\nX-Slow: ",
        f"{POST}{{",
        f"{ASK_ALIVE}GET PATH",  # a whole request, and half of a second one
    ):
        with connect(viewer, sent) as opened:
            until_closed(opened)
        assert answers(viewer), sent


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Places that no deadline frees: a visitor who is answered at all was let in at once."""
    for name, value in {"MOST": 8, "STRANGERS": 4, "SECONDS": 600.0}.items():
        monkeypatch.setattr(connections, name, value)


@pytest.mark.usefixtures("few_places")
@pytest.mark.parametrize("sent", ["", "GET PATH", POST], ids=len)
def test_idle_and_half_sent_requests_lock_nobody_out(viewer: Viewer, sent: str) -> None:
    with ExitStack() as stack:
        opened = [stack.enter_context(connect(viewer, sent)) for _ in range(30)]
        assert answers(viewer)
        assert len(viewer._server.server_state.connections) <= connections.MOST
        for ended in opened[:20]:
            assert ended.recv(100).startswith(b"HTTP/1.1 503 Service Unavailable\r\n")
            until_closed(ended)


@pytest.mark.usefixtures("few_places")
def test_slow_readers_lock_nobody_out(viewer: Viewer) -> None:
    with ExitStack() as stack:
        for _ in range(12):
            reader = stack.enter_context(connect(viewer, ASK_LICENCES))
            assert reader.recv(15) == b"HTTP/1.1 200 OK"
            state = viewer._server.server_state
            while not all(each.flow.write_paused for each in connections.opened_of(state)):
                time.sleep(0.01)
        assert answers(viewer)


def test_who_does_not_read_an_answer_is_let_go(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "SECONDS", 0.2)
    with connect(viewer, ASK_LICENCES) as reader:
        assert reader.recv(15) == b"HTTP/1.1 200 OK"
        while viewer._server.server_state.connections:
            time.sleep(0.01)


@pytest.mark.parametrize("size", [0, 1, connections.PART, 2 * connections.PART + 1])
def test_answers_arrive_whole_and_others_have_their_turn_between_the_parts(size: int) -> None:
    content, told, got = random.Random(size).randbytes(size), list[str](), list[bytes]()

    async def send(message: Any) -> None:
        told.append("part" if message.get("body") else "start")
        got.append(message.get("body", b""))

    async def both() -> None:
        scope = {"type": "http", "method": "GET", "path": "/", "headers": [(b"host", b"localhost")]}
        inner: Any = Response(content)
        receive: Any = send  # nothing is received
        answer = asyncio.ensure_future(_Guarded(inner, Guard.of("localhost"))(scope, receive, send))
        while not answer.done():
            told.append("others")
            await asyncio.sleep(0)

    asyncio.run(both())
    assert b"".join(got) == content
    assert max(map(len, got)) <= connections.PART
    assert not any(pair == ("part", "part") for pair in pairwise(told))


@pytest.mark.usefixtures("few_places")
def test_who_lacks_the_token_has_few_places_and_one_answer_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scoup.view.viewer.page_files", lambda: PAGE)
    ask = "GET {} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with Viewer(viewed_field(count=40), host="0.0.0.0", port=0) as viewer, ExitStack() as stack:
        path = f"{urlsplit(viewer.address).path}api/alive"
        with connect(viewer, ask.format("/nothing")) as stranger:
            assert b"connection: close" in stranger.recv(10_000).lower()
            until_closed(stranger)
        visitors = [stack.enter_context(connect(viewer, ask.format(path))) for _ in range(3)]
        for visitor in visitors:
            assert visitor.recv(10_000).startswith(b"HTTP/1.1 204")
        for _ in range(30):
            stack.enter_context(connect(viewer))
        for visitor in visitors:  # as before: strangers ended one another
            visitor.sendall(ask.format(path).encode())
            assert visitor.recv(10_000).startswith(b"HTTP/1.1 204")
        assert len(viewer._server.server_state.connections) <= 3 + connections.STRANGERS


def test_the_address_with_the_most_connections_makes_room() -> None:
    def opened(address: str, when: float, is_stranger: bool = False) -> Any:
        deadline = SimpleNamespace(when=lambda: when)
        return SimpleNamespace(client=(address, 1), is_stranger=is_stranger, deadline=deadline)

    busy = SimpleNamespace(client=("b", 1), is_stranger=False, deadline=None)
    found: list[Any] = [opened("a", 1), opened("b", 3), opened("b", 2), busy, opened("c", 9, True)]
    assert connections.idlest(found) is found[4]
    assert connections.idlest(found[:4]) is found[2]
    assert connections.idlest(found[:4], but=found[2]) is found[1]
    assert connections.idlest(found[3:4]) is None
