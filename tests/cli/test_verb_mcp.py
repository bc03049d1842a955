"""scoup mcp: every line gets an answer."""

from __future__ import annotations

import json
import sys
from subprocess import PIPE

import pytest

from children import child
from cli_support import RUN

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
    "deeper": (call("a", "[" * 50_000 + "]" * 50_000), None, INVALID),
    "deeper than Python's stack": ("[" * 30_000 + "]" * 30_000, None, PARSE),
    "a batch": (f"[{SECOND}]", None, INVALID),
    "no method": ('{"jsonrpc": "2.0", "id": true}', None, INVALID),
    "ten megabytes": (call(9, json.dumps("a" * 10_000_000)), None, INVALID),
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
