"""scoup mcp: every line gets an answer, over HTTP several clients do."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import sys
from subprocess import PIPE
from typing import Any

import pytest

from children import child
from cli_support import RUN, refused, run

pytest.importorskip("mcp", reason="needs scoup[mcp]")
pytestmark = pytest.mark.usefixtures("quick_python", "here")
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


def test_every_line_is_answered_with_its_id_or_null() -> None:
    lines = [FIRST, SECOND, "", *(line for line, *_ in REFUSED.values()), call(5, '"kettle"')]
    with child([sys.executable, "-c", RUN, "mcp", "f.scoup"], stdin=PIPE, text=False) as server:
        assert server.stdin is not None
        assert server.stdout is not None
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
        known = {"Authorization": f"Bearer {token}"}
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

    with child([sys.executable, "-c", RUN, "mcp", "f.scoup", "--http", "0"]) as server:
        assert server.stdout is not None
        address, header, _ = (server.stdout.readline() for _ in range(3))
        one, *others = asyncio.run(talk(address.strip(), header.rpartition(" ")[2].strip()))
        server.send_signal(signal.SIGTERM)
        _, said = server.communicate()
    assert one["things"]
    assert others == [one, one]
    assert server.returncode == 143
    assert "Traceback" not in said  # refused names of the host are logged


def test_ports_that_cannot_be_served_are_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "in use" in refused("mcp", "f.scoup", "--http", taken.getsockname()[1])


def test_a_token_that_nobody_sees_is_refused() -> None:
    code, _, err = run("mcp", "f.scoup", "--http", "0", "--quiet")
    assert code == 2
    assert "--quiet hides the token" in err
