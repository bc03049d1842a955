"""The server of agents over HTTP, for several clients on this machine: each request carries a token."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable
from typing import Any

from scoup.view.guard import MOST_BYTES
from scoup.view.viewer import bound_socket

HOST = "127.0.0.1"


def serve_http(
    server: Any, port: int, announce: Callable[[str, str], None], stopping: Callable[[int], None]
) -> None:
    """Serve over HTTP, to this machine only, until a signal ends it.

    The package `mcp` refuses other names of the host than those of loopback, and requests of other sites.

    Args:
        server: from ``scoup.view.mcp_server.make_server``.
        port: to bind to; 0 takes any.
        announce: called with the address and a new token once clients can connect.
        stopping: called with the number of such a signal.

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
