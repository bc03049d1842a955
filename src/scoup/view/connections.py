"""Connections to the servers of people and of agents: a slot for each client that asks, and none for idle ones.

uvicorn ends idle connections, and refuses the newest requests beyond a number; it neither makes room for new visitors
nor ends a connection that is slow to send a request or to read an answer.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar, Literal

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

MOST = 128
"""Connections at a time; browsers keep six to a server."""
STRANGERS = 32
"""Of these, connections that have not sent the token yet."""
SECONDS = 20.0
"""For a whole request, and for reading each ``PART`` of an answer."""
BURST = MOST // 2
"""Connections that are accepted in one go: their requests are read before as many again are."""
OTHER_FILES = 32
"""Open files of a server beside its connections."""
PART = 65_536
"""Bytes of an answer that are handed to the system at a time."""
_UNAVAILABLE = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class BoundedConnection(H11Protocol):
    """A connection with a deadline of ``SECONDS``, closed early when a new one needs its slot.

    Where all places are taken, the connection that the server has waited for longest ends: of strangers first, then of
    the address with the most connections.
    """

    has_token: ClassVar[Callable[[Any], bool] | None] = None
    """Whether a request (its ASGI scope) has the token; None if none is needed."""
    is_stranger = False
    deadline: asyncio.TimerHandle | None = None  # while the server waits for the client

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.is_stranger = self.has_token is not None
        self._wait()
        opened = opened_of(self.server_state)
        strangers = [peer for peer in opened if peer.is_stranger]
        most = most_connections()
        if len(strangers) > min(STRANGERS, most // 2):
            (idlest(strangers, self) or self).end()
        elif len(opened) > most:
            (idlest(opened, self) or self).end()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        has_token = type(self).has_token
        if self.scope is not None and has_token is not None and has_token(self.scope):
            self.is_stranger = False
        self._wait()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._wait()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._wait(anew=True)

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._wait(anew=True)

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        super().connection_lost(exc)

    def end(self) -> None:
        """End it; tell the reason to a client that has no part of an answer yet."""
        self.connections.discard(self)
        if self.transport.get_write_buffer_size():
            self.transport.abort()
        else:
            self.transport.write(_UNAVAILABLE)
            self.transport.close()

    def _wait(self, anew: bool = False) -> None:
        """Set the deadline if the client is to act: to send the rest of a request, or to read an answer."""
        asked = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        waits = asked or self.flow.write_paused or self.transport.is_closing()
        if anew or not waits:
            self._stop_waiting()
        if waits and self.deadline is None:
            self.deadline = self.loop.call_later(SECONDS, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self.deadline is not None:
            self.deadline.cancel()
            self.deadline = None


def most_connections() -> int:
    """Return ``MOST``, or fewer where the system allows the process few open files."""
    with suppress(ImportError):  # on Windows
        import resource

        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if files != resource.RLIM_INFINITY:
            return max(4, min(MOST, (files - OTHER_FILES) // 2))
    return MOST


def server_config(
    application: Any, has_token: Callable[[Any], bool] | None, lifespan: Literal["on", "off"]
) -> uvicorn.Config:
    """Return the settings of a server with bounded connections; ``has_token`` as of ``BoundedConnection``."""
    known = has_token and staticmethod(has_token)
    return uvicorn.Config(
        application,
        http=type("Connection", (BoundedConnection,), {"has_token": known}),
        ws="none",
        backlog=min(BURST, most_connections() // 2),
        log_level="error",  # warnings about odd requests would fill the terminal
        access_log=False,
        server_header=False,
        lifespan=lifespan,
        timeout_graceful_shutdown=2,
        h11_max_incomplete_event_size=65_536,
    )


def opened_of(server: ServerState) -> list[BoundedConnection]:
    """Return the connections of a server."""
    return [peer for peer in server.connections if isinstance(peer, BoundedConnection)]


def idlest(opened: list[BoundedConnection], but: BoundedConnection | None = None) -> BoundedConnection | None:
    """Return the connection with the earliest deadline: of strangers first, then of the address with the most."""
    addresses = Counter(peer.client and peer.client[0] for peer in opened)
    waiting = [
        (not peer.is_stranger, -addresses[peer.client and peer.client[0]], peer.deadline.when(), number)
        for number, peer in enumerate(opened)
        if peer.deadline is not None and peer is not but
    ]
    return opened[min(waiting)[-1]] if waiting else None
