"""Viewers: a real server of a field, its address and its end, and what it refuses of strangers."""

from __future__ import annotations

import asyncio
import http.client
import json
import random
import socket
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("uvicorn", reason="needs scoup[view]")

from starlette.responses import Response
from view_samples import PAGE, random_field, table, viewed_field

from messages import refuses
from scoup.base import InputError, ScoupError
from scoup.view import connections
from scoup.view import viewer as module
from scoup.view.guard import Guard
from scoup.view.server import _Guarded
from scoup.view.viewer import Viewer, check_needed, open_viewer


@pytest.fixture(autouse=True)
def page(monkeypatch: pytest.MonkeyPatch) -> None:
    licences = "x" * (32 << 20)  # more than the system takes at once
    monkeypatch.setattr(module, "page_files", lambda: replace(PAGE, licences=licences))


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
    with open_viewer(random_field().with_encoder(table()), words=["thing 3"], height=300) as opened:
        assert 'height="300"' in opened._repr_html_()
        assert ask(opened, "/api/vocabulary")[1]["names"] == ["thing 3"]


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
    for host in ("192.0.2.1", "no such host"):
        with pytest.raises(InputError, match=r"is not a host|[Cc]annot assign"):
            Viewer(viewed_field(), host=host, port=0)


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


# ---- Connections that are too many, or slow


ASK_LICENCES = "GET PATHlicences.txt HTTP/1.1\r\nHost: HOST\r\n\r\n"
ASK_ALIVE = ASK_LICENCES.replace("licences.txt", "api/alive")
POST = "POST PATHapi/query HTTP/1.1\r\nHost: HOST\r\nContent-Length: 40\r\n\r\n"


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


def test_who_does_not_end_a_request_or_read_an_answer_is_let_go(viewer: Viewer, monkeypatch) -> None:
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
    with connect(viewer, ASK_LICENCES) as reader:
        assert reader.recv(15) == b"HTTP/1.1 200 OK"
        while viewer._server.server_state.connections:
            time.sleep(0.01)


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Places that no deadline frees: a visitor who is answered at all was let in at once."""
    for name, value in {"MOST": 8, "STRANGERS": 4, "SECONDS": 600.0}.items():
        monkeypatch.setattr(connections, name, value)


@pytest.mark.usefixtures("few_places")
def test_idle_half_sent_and_unread_requests_lock_nobody_out(viewer: Viewer) -> None:
    for sent in ("", "GET PATH", POST):
        with ExitStack() as stack:
            opened = [stack.enter_context(connect(viewer, sent)) for _ in range(30)]
            assert answers(viewer)
            assert len(viewer._server.server_state.connections) <= connections.MOST
            for ended in opened[:20]:
                assert ended.recv(100).startswith(b"HTTP/1.1 503 Service Unavailable\r\n"), sent
                until_closed(ended)
    with ExitStack() as stack:
        for _ in range(12):
            reader = stack.enter_context(connect(viewer, ASK_LICENCES))
            assert reader.recv(15) == b"HTTP/1.1 200 OK"
            state = viewer._server.server_state
            while not all(each.flow.write_paused for each in connections.opened_of(state)):
                time.sleep(0.01)
        assert answers(viewer)


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
def test_who_lacks_the_token_has_few_places_and_one_answer_each() -> None:
    sent = "GET {} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with Viewer(viewed_field(count=40), host="0.0.0.0", port=0) as viewer, ExitStack() as stack:
        path = f"{urlsplit(viewer.address).path}api/alive"
        with connect(viewer, sent.format("/nothing")) as stranger:
            assert b"connection: close" in stranger.recv(10_000).lower()
            until_closed(stranger)
        visitors = [stack.enter_context(connect(viewer, sent.format(path))) for _ in range(3)]
        for visitor in visitors:
            assert visitor.recv(10_000).startswith(b"HTTP/1.1 204")
        for _ in range(30):
            stack.enter_context(connect(viewer))
        for visitor in visitors:  # as before: strangers ended one another
            visitor.sendall(sent.format(path).encode())
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
