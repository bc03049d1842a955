"""Connections to the viewer's server: not too many, and none that is slow to say what it wants.

uvicorn bounds requests and idle connections; it neither bounds connections nor ends one that sends half a request.
"""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST = 128
"""Connections at a time; browsers keep six to a server."""
SECONDS = 20.0
"""From the first sign of a request to its end; messages are a few hundred bytes."""


class BoundedConnection(H11Protocol):
    """A connection that is closed at once beyond ``MOST``, and after ``SECONDS`` without a whole request."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if len(self.connections) > MOST:
            transport.abort()
        else:
            self._wait()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._wait()
        else:
            self._be_content()

    def connection_lost(self, exc: Exception | None) -> None:
        self._be_content()
        super().connection_lost(exc)

    def _wait(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(SECONDS, self.transport.abort)

    def _be_content(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
