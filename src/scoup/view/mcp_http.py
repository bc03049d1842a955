"""The server of agents over HTTP, for several clients on this machine: each request carries a token."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Any

from scoup.view.guard import MOST_BYTES
from scoup.view.viewer import bound_socket

HOST = "127.0.0.1"


def serve_http(server: Any, port: int, announce: Callable[[str, str], None]) -> None:
    """Serve over HTTP, to this machine only, until a signal ends it.

    The package `mcp` refuses other names of the host than those of loopback, and requests of other sites.

    Args:
        server: from ``scoup.view.mcp_server.make_server``.
        port: to bind to; 0 takes any.
        announce: called with the address and a new token once clients can connect.

    Raises:
        InputError: the port cannot be bound to.
        KeyboardInterrupt: after SIGINT or SIGTERM, once the server has ended.
    """
    import uvicorn

    token = secrets.token_urlsafe(24)
    inner = server.streamable_http_app(
        host=HOST, json_response=True, stateless_http=True, max_request_body_size=MOST_BYTES
    )
    with bound_socket(HOST, port) as listening:
        listening.listen()  # clients wait until the server runs
        announce(f"http://{HOST}:{listening.getsockname()[1]}/mcp", token)
        config = uvicorn.Config(
            _WithToken(inner, token),
            log_level="error",
            access_log=False,
            ws="none",
            timeout_graceful_shutdown=2,
            limit_concurrency=64,
        )
        uvicorn.Server(config).run(sockets=[listening])


class _WithToken:
    """Refuses requests without the token."""

    def __init__(self, inner: Any, token: str) -> None:
        self.inner = inner
        self.expected = f"Bearer {token}".encode()

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        from starlette.responses import PlainTextResponse

        given = dict(scope.get("headers", ())).get(b"authorization", b"")
        refusal = PlainTextResponse(
            "send the header Authorization: Bearer TOKEN, with the token that scoup mcp printed",
            401,
            {"www-authenticate": "Bearer"},
        )
        is_refused = scope["type"] == "http" and not secrets.compare_digest(given, self.expected)
        await (refusal if is_refused else self.inner)(scope, receive, send)
