"""scoup view and mcp: pages that are written or served, agents that are answered; several clients at once."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import json
import os
import signal
import socket
import sys
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from subprocess import PIPE
from typing import Any
from urllib.parse import urlsplit

import pytest

from children import Child, child
from cli_support import RUN, printed, refused, run, run_json
from scoup.view import export, page, viewer
from scoup.view.page import PROGRAM, SETTINGS, STYLE, PageFiles

PAGE = PageFiles(f"<head>{STYLE}{SETTINGS}</head>{PROGRAM}", b"", "", "")
pytestmark = pytest.mark.usefixtures("quick_python", "here")


# ---- view


@pytest.fixture
def built_page(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (export, page, viewer):
        monkeypatch.setattr(module, "page_files", lambda: PAGE)


@pytest.mark.usefixtures("built_page")
def test_export_prints_sizes() -> None:
    out = printed("view", "f.scoup", "--export", "page.html")
    assert out.startswith("page.html: 0.")
    assert out.rstrip().endswith("3 words")
    record = run_json("view", "f.scoup", "--export", "page.html", "--overwrite")
    assert record["bytes"] == Path("page.html").stat().st_size
    folder = run_json("view", "f.scoup", "--export", "pages", "--split")
    assert folder["bytes"] == sum(path.stat().st_size for path in Path("pages").iterdir())
    odd = Path(os.fsdecode(b"\xe9t\xe9.scoup") if sys.platform == "linux" else "odd.scoup")
    Path("f.scoup").rename(odd)
    run_json("view", odd, "--export", "odd.html")
    odd.rename("f.scoup")
    Path("words.txt").write_text("mug\n")
    assert run_json("view", "f.scoup", "--export", "own.html", "--words", "words.txt")["words"] == 1


SERVE = f"""
import scoup.view
from scoup.view import page, viewer
viewer.page_files = lambda: page.PageFiles({PAGE.index!r}, b"", "", "")
from scoup.cli.app import entry
entry()
"""
SLOW = """
import sys, time
from scoup.view.viewed_field import ViewedField
def answers(*_):
    print("asked", flush=True)
    time.sleep(4)  # longer than the server waits for answers
ViewedField.answers = answers
"""
ASKED = json.dumps({"texts": ["kettle"]}).encode()


@contextmanager
def served(before: str = "") -> Iterator[tuple[Child, urllib.request.Request]]:
    """A server in a process of its own, which runs some Python before, and a query to it."""
    command = [sys.executable, "-c", before + SERVE, "view", "f.scoup", "--port", "0", "--json"]
    with child(command) as process:
        lines = []
        while not lines or lines[-1] != "}\n":
            lines.append(process.stdout.readline())
            assert lines[-1], process.stderr.read()
        yield process, urllib.request.Request(f"{json.loads(''.join(lines))['address']}api/query", ASKED)


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 0), (signal.SIGTERM, 143)])
def test_a_viewer_serves_until_it_is_stopped(stop: signal.Signals, code: int) -> None:
    with served() as (process, query):
        with urllib.request.urlopen(query) as answer:
            assert json.load(answer)["answers"][0]["text"] == "kettle"
        process.send_signal(stop)
        _, err = process.communicate()
    assert (process.returncode, err) == (code, "")


def ask(query: urllib.request.Request) -> None:
    with contextlib.suppress(OSError):  # nobody answers, or it is said that the server ends
        urllib.request.urlopen(query)


def test_a_viewer_stops_quietly_while_requests_wait() -> None:
    with served(SLOW) as (process, query):
        visitors = [threading.Thread(target=ask, args=(query,)) for _ in range(3)]
        for visitor in visitors:
            visitor.start()
        assert process.stdout.readline() == "asked\n"
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate()
        for visitor in visitors:
            visitor.join()
    assert (process.returncode, err) == (143, "")


# ---- mcp


needs_mcp = pytest.mark.skipif(importlib.util.find_spec("mcp") is None, reason="needs scoup[mcp]")
FIND = '{"name": "find", "arguments": {"scene": "f", "text": TEXT}}'
CALL = '{"jsonrpc": "2.0", "id": ID, "method": "tools/call", "params": ' + FIND + "}"
START = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}
FIRST = json.dumps({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": START})
SECOND = '{"jsonrpc": "2.0", "method": "notifications/initialized"}'


def call(number: object, text: str) -> str:
    return CALL.replace("ID", json.dumps(number)).replace("TEXT", text)


PARSE, INVALID = -32700, -32600
REFUSED = {
    "broken": ("{", None, PARSE),
    "not UTF-8": ("\udcff", None, PARSE),
    "a lone surrogate": (call(7, r'"\ud800"'), 7, INVALID),
    "an id of a lone surrogate": (call("\ud800", '"mug"'), None, INVALID),
    "deep": (call("a", "[" * 500 + "]" * 500), "a", INVALID),
    "deeper than Python's stack": ("[" * 30_000 + "]" * 30_000, None, PARSE),
    "a batch": (f"[{SECOND}]", None, INVALID),
    "no method": ('{"jsonrpc": "2.0", "id": true}', None, INVALID),
}


@needs_mcp
def test_every_line_is_answered_with_its_id_or_null() -> None:
    lines = [FIRST, SECOND, "", *(line for line, *_ in REFUSED.values()), call(5, '"kettle"')]
    with child([sys.executable, "-c", RUN, "mcp", "f.scoup"], stdin=PIPE, text=False) as server:
        server.stdin.write("\n".join([*lines, ""]).encode("utf-8", "surrogateescape"))
        server.stdin.flush()
        told = [server.stdout.readline() for _ in range(len(REFUSED) + 2)]
        rest, _ = server.communicate()
    assert (server.returncode, rest) == (0, b"")
    assert sum(map(len, told)) < 20_000
    first, *replies = map(json.loads, told)
    assert first["id"] == 0
    answered = [reply for reply in replies if "result" in reply]
    assert [reply["id"] for reply in answered] == [5]
    assert "kettle" in json.dumps(answered)
    found = [(reply["id"], reply["error"]["code"]) for reply in replies if "error" in reply]
    assert dict(zip(REFUSED, found, strict=True)) == {
        name: tuple(rest) for name, (_, *rest) in REFUSED.items()
    }


@contextmanager
def served_over_http(before: str = "") -> Iterator[tuple[Child, urllib.request.Request]]:
    """A server of agents, and a call with its token."""
    with child([sys.executable, "-c", before + RUN, "mcp", "f.scoup", "--http", "0"]) as server:
        address, header, _ = (server.stdout.readline().strip() for _ in range(3))
        kinds = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
        kinds["Authorization"] = header.partition("n: ")[2]
        yield server, urllib.request.Request(address, call(1, '"kettle"').encode(), kinds)


@needs_mcp
def test_several_clients_are_served_over_http_and_strangers_refused() -> None:
    import httpx2
    from mcp import Client
    from mcp.client.streamable_http import streamable_http_client

    async def found(address: str, headers: dict[str, str]) -> Any:
        async with (
            httpx2.AsyncClient(headers=headers, timeout=60) as http,
            Client(streamable_http_client(address, http_client=http)) as client,
        ):
            reply: Any = await client.call_tool("find", {"scene": "f", "text": "kettle"})
            return json.loads(reply.content[0].text)

    async def talk(address: str, token: str) -> list[Any]:
        known = {"Authorization": token}
        answers = await asyncio.gather(*(found(address, known) for _ in range(3)))
        strangers = [
            ({}, 401),
            ({"Authorization": "Bearer x"}, 401),
            (known | {"Host": "other.example"}, 421),
            (known | {"Origin": "http://other.example"}, 403),
        ]
        async with httpx2.AsyncClient() as http:
            got = [(await http.post(address, json={}, headers=each)).status_code for each, _ in strangers]
            large = await http.post(address, content=b" " * 70_000, headers=known)
        assert got == [status for _, status in strangers]
        assert large.status_code == 413
        return answers

    with served_over_http() as (server, asked):
        head = "".join(f"{name}: {value}\r\n" for name, value in asked.header_items())
        with socket.create_connection(("127.0.0.1", urlsplit(asked.full_url).port or 0)) as leaving:
            leaving.sendall(
                f"POST /mcp HTTP/1.1\r\nHost: 127.0.0.1:1\r\n{head}Content-Length: 9\r\n\r\n{{".encode()
            )
        one, *others = asyncio.run(talk(asked.full_url, str(asked.get_header("Authorization"))))
        server.send_signal(signal.SIGTERM)
        _, said = server.communicate()
    assert one["things"]
    assert others == [one, one]
    assert server.returncode == 143
    assert "Traceback" not in said  # refused names of the host are logged


STUCK = """
import sys, time
from scoup.view.scene_tools import SceneTools
def find(self, scene: str, text: str) -> str:
    print("asked", file=sys.stderr, flush=True)
    time.sleep(600)
SceneTools.find = find
"""
CODES = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]


@needs_mcp
@pytest.mark.parametrize(("served_over", "number", "code"), [("pipes", *CODES[1]), ("http", *CODES[0])])
def test_servers_of_agents_stop_while_a_tool_runs(served_over: str, number: int, code: int) -> None:
    with ExitStack() as stack:
        if served_over == "http":
            server, asked = stack.enter_context(served_over_http(STUCK))
            threading.Thread(target=ask, args=(asked,)).start()
        else:
            command = [sys.executable, "-c", STUCK + RUN, "mcp", "f.scoup"]
            server = stack.enter_context(child(command, stdin=PIPE))
            server.stdin.write("\n".join([FIRST, SECOND, call(1, '"kettle"'), ""]))
            server.stdin.flush()
        while server.stderr.readline() != "asked\n":
            assert server.poll() is None
        server.send_signal(number)
        server.wait()
    assert server.returncode == code


FEW_FILES = """
import resource
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
"""


@needs_mcp
@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
@pytest.mark.parametrize(("verb", "before"), [("view", FEW_FILES), ("mcp", ""), ("mcp", FEW_FILES)])
def test_connections_that_send_nothing_lock_nobody_out(verb: str, before: str) -> None:
    with ExitStack() as stack:
        if verb == "view":
            server, asked = stack.enter_context(served(before))
        else:
            server, asked = stack.enter_context(served_over_http(before))
        address = urlsplit(asked.full_url)
        for number in range(200):
            opened = stack.enter_context(socket.create_connection((address.hostname, address.port or 0)))
            opened.sendall(b"POST /mcp HTTP/1.1\r\nHost: 127" * (number % 2))
        for _ in range(3):
            with urllib.request.urlopen(asked) as answer:
                assert b"kettle" in answer.read()
        server.send_signal(signal.SIGTERM)
        _, err = server.communicate()
    assert (server.returncode, err) == (143, "")


@needs_mcp
@pytest.mark.skipif(sys.platform != "linux", reason="sizes of pipes as of Linux")
@pytest.mark.parametrize(("number", "code"), CODES)
def test_servers_of_agents_stop_while_nobody_reads(number: int, code: int) -> None:
    import fcntl
    import termios

    with child([sys.executable, "-c", RUN, "mcp", "f.scoup"], stdin=PIPE) as server:
        page = fcntl.fcntl(server.stdout, fcntl.F_SETPIPE_SZ, 4096)
        lines = [FIRST, SECOND, *(call(number, '"kettle"') for number in range(1, 40)), ""]
        server.stdin.write("\n".join(lines))
        server.stdin.flush()
        waiting = bytearray(4)
        while int.from_bytes(waiting, sys.byteorder) < page // 2:  # the next reply has no room in the page
            fcntl.ioctl(server.stdout, termios.FIONREAD, waiting)
        server.send_signal(number)
        server.wait()
        said = server.stderr.read()
    assert (server.returncode, said.count("Traceback")) == (code, 0), said


@needs_mcp
def test_ports_that_cannot_be_served_are_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "in use" in refused("mcp", "f.scoup", "--http", taken.getsockname()[1])


@needs_mcp
def test_a_token_that_nobody_sees_is_refused() -> None:
    assert "--quiet hides the token" in run("mcp", "f.scoup", "--http", "0", "--quiet")[2]
