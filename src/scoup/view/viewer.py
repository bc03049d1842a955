"""A viewer that is open: its server, its address, its end."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import socket
import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from scoup.base import InputError, ScoupError, html
from scoup.query import LanguageField
from scoup.view.decimation import MOST_GAUSSIANS
from scoup.view.guard import Guard, is_loopback
from scoup.view.page import page_files
from scoup.view.viewed_field import ViewedField

if TYPE_CHECKING:
    import uvicorn

PORT = 8350
_START_SECONDS = 30.0
_NEEDED = ("starlette", "uvicorn")
_FRAME = """{% if address %}<iframe src="{{ address }}" title="Viewer of {{ name }}" width="100%" height="{{ height }}"
 style="border:0" allow="clipboard-write; fullscreen"></iframe>
{%- else %}<p>The viewer of {{ name }} is closed.</p>{% endif %}"""


class Viewer:
    """A field in the browser, served from a thread of this process until ``close``, or the end of a ``with`` block.

    In a notebook it shows its page. ``remote`` and ``height`` are as for ``open_viewer``.

    Attributes:
        address: to be opened in a browser.
        is_local: only this machine reaches it.

    Args:
        host: to bind to. Beyond loopback the address contains a token that nobody can guess.
        port: to bind to; 0 takes any, None ``PORT`` or, if that is in use, any.

    Raises:
        ScoupError: the page was not built, or a package is missing.
        InputError: host and port cannot be bound to.
    """

    def __init__(
        self,
        viewed: ViewedField,
        host: str = "127.0.0.1",
        port: int | None = None,
        remote: bool = False,
        height: int = 640,
    ) -> None:
        check_needed()
        page = page_files()
        import uvicorn

        from scoup.view.connections import server_config
        from scoup.view.server import application

        guard = Guard.of(host)
        self.viewed, self.height, self.is_local = viewed, height, is_loopback(host)
        self._socket = bound_socket(host, port)
        host_name = _shown_host(host)
        self.address = f"http://{host_name}:{self._socket.getsockname()[1]}{guard.prefix}/"
        config = server_config(
            application(viewed, page, guard, remote), guard.has_token if guard.token else None, "off"
        )
        self._server: uvicorn.Server = uvicorn.Server(config)
        # Waited for in place of the thread: until Python 3.12, an interrupted join marks a running thread as ended.
        self._ended = threading.Event()
        threading.Thread(target=self._serve, name="scoup view", daemon=True).start()
        self._wait_for_start()

    def _serve(self) -> None:
        try:
            asyncio.run(self._server.serve(sockets=[self._socket]))
        finally:
            self._ended.set()

    def _wait_for_start(self) -> None:
        end = time.monotonic() + _START_SECONDS
        while not self._server.started:
            if self._ended.is_set() or time.monotonic() > end:
                self.close()
                raise ScoupError("the viewer's server did not start")
            time.sleep(0.01)
        self._socket.listen(socket.SOMAXCONN)  # the system queues further connections, and does not drop them

    @property
    def is_open(self) -> bool:
        """Return whether it still answers."""
        return not self._ended.is_set()

    def wait(self) -> None:
        """Wait until it is closed, or interrupted."""
        while not self._ended.wait(0.5):
            pass

    def close(self) -> None:
        """Stop answering; open pages say so."""
        log, silent = logging.getLogger("uvicorn.error"), logging.Filter("none of its names")
        log.addFilter(silent)  # it reports each pending request as a fault, with a traceback
        try:
            self._server.should_exit = True
            self._ended.wait(10)
            self._socket.close()
        finally:
            log.removeFilter(silent)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.viewed.name} at {self.address}{'' if self.is_open else ', closed'})"

    def _repr_html_(self) -> str:
        return html(
            _FRAME, name=self.viewed.name, address=self.address if self.is_open else None, height=self.height
        )


def open_viewer(
    field: LanguageField,
    words: Sequence[str] | None = None,
    most: int = MOST_GAUSSIANS,
    remote: bool = False,
    height: int = 640,
) -> Viewer:
    """Show a field in the browser, as `scoup view` does; in a notebook return the page itself.

    Args:
        field: to be shown.
        words: what a click chooses from; by default everyday words, or the names of the table.
        most: Gaussians that the page shows at most; neighbours are merged until no more are left.
        remote: show rendered pictures only, for scenes that are too much for the browser.
        height: of the page in a notebook, in pixels.

    Returns:
        A viewer, open until its ``close`` or the end of the process; its ``address`` is that of the page.

    Raises:
        ScoupError: the page was not built, or a package is missing.

    Example:
        >>> with scoup.open_viewer(field) as viewer:
        ...     viewer.address.startswith("http://127.0.0.1:")
        True
    """
    check_needed()
    return Viewer(ViewedField(field, words, most), remote=remote, height=height)


def check_needed(serves: bool = True) -> None:
    """Check that the page is there, and if it is served, the packages of the server.

    Raises:
        ScoupError: one is missing.
    """
    missing = [name for name in _NEEDED if serves and importlib.util.find_spec(name) is None]
    if missing:
        raise ScoupError(f'the viewer needs {" and ".join(missing)}: pip install "scoup[view]"')
    page_files()


def bound_socket(host: str, port: int | None) -> socket.socket:
    """Return a socket that is bound to host and port.

    Raises:
        InputError: the system refuses.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, PORT if port is None else port, type=socket.SOCK_STREAM
        )[0]
    except (OSError, OverflowError, UnicodeError) as error:
        raise InputError(f"{host}: is not a host of this machine ({error})") from None
    refusal = ""
    for wanted in dict.fromkeys([address[1], 0 if port is None else address[1]]):
        # If a socket names TCP, asyncio sets TCP_NODELAY: small answers arrive 40 ms earlier.
        bound = socket.socket(family, kind, protocol)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((address[0], wanted, *address[2:]))
        except OSError as error:
            bound.close()
            refusal = error.strerror or str(error)
        else:
            return bound
    raise InputError(f"{host}, port {port}: {refusal}; pass another `port`, or 0 for any that is free")


def _shown_host(host: str) -> str:
    """Return the host as an address names it: the name of the machine for one that stands for all of its hosts."""
    name = socket.gethostname() if host in ("0.0.0.0", "::") else host
    return f"[{name}]" if ":" in name else name
