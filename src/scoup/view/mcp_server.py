"""The Model Context Protocol server, by the protocol's own package `mcp`: over standard input and output, or over HTTP
for several clients on this machine, each of whose requests carries a token."""

from __future__ import annotations

import asyncio
import functools
import inspect
import io
import itertools
import json
import logging
import re
import secrets
import signal
import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Pictures

from scoup.base import VERSION, ScoupError, as_json, printable
from scoup.pictures import Picture
from scoup.view.guard import MOST_BYTES
from scoup.view.scene_tools import SceneTools
from scoup.view.viewer import bound_socket

HOST = "127.0.0.1"
INSTRUCTIONS = (
    "3D scenes whose objects can be found by text. Begin with list_scenes. Things have numbers that stay the same; "
    "positions are in scene units; keys that end in _metres are in metres, where the scene knows them."
)


def make_server(tools: SceneTools, more: Iterable[Callable[..., Any]] = ()) -> Any:
    """Return the server (``mcp.server.mcpserver.MCPServer``) with a tool per public method of ``SceneTools``, and more.

    Raises:
        ScoupError: the package `mcp` is not installed.
    """
    try:
        from mcp.server.mcpserver import Image, MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    except ImportError as error:
        raise ScoupError(
            "serving agents needs the package mcp, 2.3 or newer: pip install 'scoup[mcp]'"
        ) from error

    parameters: dict[str, Mapping[str, inspect.Parameter]] = {}  # of each tool
    kind = _strict(MCPServer, ToolError, parameters)
    server = kind("scoup", instructions=INSTRUCTIONS, version=VERSION, log_level="WARNING")

    def add(method: Callable[..., Any]) -> None:
        parameters[method.__name__] = inspect.signature(method).parameters

        @functools.wraps(method)
        def tool(**arguments: Any) -> Any:
            try:
                reply = method(**arguments)
            except ScoupError as error:  # the model reads what is wrong and tries again
                raise ToolError(printable(_without_folders(str(error), tools))) from error
            if isinstance(reply, np.ndarray):
                return Image(data=_png(reply), format="png")
            return as_json(reply, indent=None)  # models read every character

        server.tool(structured_output=False)(tool)

    for method in (
        tools.list_scenes,
        tools.list_cameras,
        tools.list_things,
        tools.describe_scene,
        tools.find,
        tools.describe_thing,
        tools.measure_distance,
        tools.render_view,
        *more,
    ):
        add(method)
    if tools.export_folder is not None:
        add(tools.export_selection)
    return server


def serve(
    tools: SceneTools,
    more: Iterable[Callable[..., Any]],
    port: int | None,
    announce: Callable[[str, str], None],
    stopping: Callable[[int], None],
) -> int | None:
    """Serve tools (``make_server``) over HTTP (``serve_http``); without a port over standard input and output, until
    the input ends (None), or a signal ends it: return its number. Without a port, ``announce`` gets no address.

    A signal ends no tool that runs, and no write to a client that does not read: ``stopping`` is called at once with
    its number, and may end the process."""
    server = make_server(tools, more)
    if port is not None:
        return serve_http(server, port, announce, stopping)
    announce("", "")
    stopped: list[int] = []
    try:
        asyncio.run(_serve(server, stopped, stopping))
    except (Exception, asyncio.CancelledError):
        if not stopped:  # else a task of the package that was cut off
            raise
    return stopped[0] if stopped else None


async def _serve(server: Any, stopped: list[int], stopping: Callable[[int], None]) -> None:
    from mcp.server.stdio import stdio_server

    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None

    def stop(number: int) -> None:
        stopped.append(number)
        stopping(number)
        task.cancel()

    # Without handlers, a signal raises inside the loop, which reports a fault.
    with suppress(NotImplementedError):  # on Windows
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop, number)
    lines: Any = _Lines()
    async with stdio_server(stdin=lines) as (messages, replies):
        lines.replies = replies
        inner = server._lowlevel_server
        await inner.run(messages, replies, inner.create_initialization_options())


class _Lines:
    """Lines of standard input that are messages. All others are answered here: the package ignores them.

    They are read by a thread that nothing waits for: the package's own would keep the process until the input ends.
    """

    replies: Any

    async def __aiter__(self) -> AsyncIterator[str]:
        from mcp_types import jsonrpc_message_adapter

        loop, lines = asyncio.get_running_loop(), asyncio.Queue[bytes | None](1)
        threading.Thread(target=self._read, args=(loop, lines), daemon=True).start()
        while (line := await lines.get()) is not None:
            try:
                jsonrpc_message_adapter.validate_json(line, by_name=False)
            except ValueError:
                if line.strip():
                    await self._refuse(line)
            else:
                yield line.decode()

    def _read(self, loop: asyncio.AbstractEventLoop, lines: asyncio.Queue[bytes | None]) -> None:
        stream = open(sys.stdin.fileno(), "rb", closefd=False)  # noqa: SIM115  # the process waits for sys.stdin
        with suppress(RuntimeError, CancelledError):  # the loop has ended
            for line in itertools.chain(stream, [None]):
                asyncio.run_coroutine_threadsafe(lines.put(line), loop).result()

    async def _refuse(self, line: bytes) -> None:
        from mcp.shared.message import SessionMessage
        from mcp_types import INVALID_REQUEST, PARSE_ERROR, ErrorData, JSONRPCError

        code, number, reason = PARSE_ERROR, None, "the line is not JSON"
        with suppress(ValueError, RecursionError):
            message = json.loads(line)
            code, reason = INVALID_REQUEST, "the line is not a message of JSON-RPC 2.0 in UTF-8"
            number = message.get("id") if isinstance(message, dict) else None
        if type(number) not in (int, str) or not str(number).isprintable():  # lone surrogates are not
            number = None
        error = JSONRPCError(jsonrpc="2.0", id=number, error=ErrorData(code=code, message=reason))
        await self.replies.send(SessionMessage(error))


def _strict(kind: Any, refusal: Any, parameters: Mapping[str, Mapping[str, inspect.Parameter]]) -> Any:
    """Return a subclass of ``MCPServer`` that refuses unknown arguments, and names wrong ones in one sentence of a
    ``ToolError``."""
    from pydantic import ValidationError

    class Strict(kind):
        async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:
            known = parameters.get(name)
            if known is not None and (unknown := sorted(arguments.keys() - known)):
                named = ", ".join(known) or "none"
                raise refusal(f"{name}: unknown argument {unknown[0][:80]!r}; known: {named}")
            try:
                return await super().call_tool(name, arguments, context)
            except refusal as error:
                if known is None or not isinstance(error.__cause__, ValidationError):
                    raise
                raise refusal(_problem(known, error.__cause__.errors()[0])) from None

    return Strict


def _problem(parameters: Mapping[str, inspect.Parameter], error: Mapping[str, Any]) -> str:
    """Describe the mistake in an argument in one sentence."""
    name, *_ = error["loc"]
    kind = parameters[name].annotation
    given = "none" if error["type"] == "missing" else repr(error["input"])[:80]
    return f"{name}: expected {kind}, got {given}"


def _without_folders(message: str, tools: SceneTools) -> str:
    """Remove the folders of this machine from a message."""
    for field in tools.fields.values():  # whose folders may have spaces in their names
        # Not the encoder's: it may be impossible to open one.
        words = field.info.words or field.embedding_model if field.words is None else field.words
        for source in (field.path, field.geometry_path, words):
            if source and isinstance(source, (str, Path)):
                message = message.replace(str(source), Path(source).name)
    return re.sub(r"(?<![\w.:/])/(?:[\w.@+~-]+/)+", "", message)


def _png(picture: Picture) -> bytes:
    data = io.BytesIO()
    Pictures.fromarray(picture).save(data, "PNG")
    return data.getvalue()


def serve_http(
    server: Any, port: int, announce: Callable[[str, str], None], stopping: Callable[[int], None]
) -> None:
    """Serve over HTTP, to this machine only, until a signal ends it.

    The package `mcp` refuses other names of the host than those of loopback, and requests of other sites.
    ``announce`` gets the address and a new token once clients can connect, ``stopping`` the number of the signal.

    Raises:
        InputError: the port cannot be bound to.
        KeyboardInterrupt: after SIGINT or SIGTERM, once the server has ended.
    """
    import uvicorn
    from starlette.requests import ClientDisconnect

    from scoup.view.connections import server_config

    class Server(uvicorn.Server):
        def handle_exit(self, sig: int, frame: Any) -> None:
            stopping(sig)
            super().handle_exit(sig, frame)

    # The package takes a client that leaves in the midst of its request for a fault.
    logging.getLogger("mcp.server.streamable_http").addFilter(
        lambda record: not (record.exc_info and isinstance(record.exc_info[1], ClientDisconnect))
    )
    token = secrets.token_urlsafe(24)
    inner = server.streamable_http_app(
        host=HOST, json_response=True, stateless_http=True, max_request_body_size=MOST_BYTES
    )
    with bound_socket(HOST, port) as listening:
        listening.listen()  # clients wait until the server runs
        announce(f"http://{HOST}:{listening.getsockname()[1]}/mcp", token)
        guarded = _WithToken(inner, token)
        Server(server_config(guarded, guarded.has_token, "on")).run(sockets=[listening])


class _WithToken:
    """Refuses requests without the token."""

    def __init__(self, inner: Any, token: str) -> None:
        self.inner = inner
        self.expected = f"Bearer {token}".encode()

    def has_token(self, scope: Any) -> bool:
        """Return whether a request has the token, by its ASGI scope."""
        given = dict(scope.get("headers", ())).get(b"authorization", b"")
        return secrets.compare_digest(given, self.expected)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        from starlette.responses import PlainTextResponse

        refusal = PlainTextResponse(
            "send the header Authorization: Bearer TOKEN, with the token that scoup mcp printed",
            401,
            {"www-authenticate": "Bearer", "connection": "close"},
        )
        is_refused = scope["type"] == "http" and not self.has_token(scope)
        await (refusal if is_refused else self.inner)(scope, receive, send)
