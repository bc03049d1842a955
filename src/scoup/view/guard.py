"""Checks before the viewer's server reads a request: strangers, other sites and giant messages are refused."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

MOST_BYTES = 65_536
"""Of a message to the server; a query has a few hundred."""
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval' blob:; worker-src 'self' blob:; style-src 'self' "
    "'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self' data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:* https://localhost:* vscode-webview:"
)
"""The page loads nothing from anywhere else, and may be shown within a notebook on this machine."""
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_OWN_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


@dataclass(frozen=True)
class Guard:
    """The rules for who may send requests."""

    host: str  # the server is bound to it
    token: str = ""  # first part of every path; empty on loopback
    names: frozenset[str] = field(default_factory=frozenset)
    """Accepted in the header Host. A page of another site whose name resolves to this machine sends its own name (DNS
    rebinding)."""

    @classmethod
    def of(cls, host: str) -> Guard:
        """Return the rules of a server bound to a host; beyond loopback with a new token."""
        if is_loopback(host):
            return cls(host, "", _OWN_NAMES | {host.lower()})
        names = {host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}
        return cls(host, secrets.token_urlsafe(24), _OWN_NAMES | names)

    @property
    def prefix(self) -> str:
        """The first part of every path."""
        return f"/{self.token}" if self.token else ""

    def has_token(self, scope: Mapping[str, Any]) -> bool:
        """Return whether a request has the token, by its ASGI scope."""
        return scope["path"].startswith(f"{self.prefix}/")

    def refuses(self, method: str, host: str | None, origin: str | None, site: str | None) -> str | None:
        """Return why a request is refused, by its headers Host, Origin and Sec-Fetch-Site; None if it may pass."""
        name = urlsplit(f"//{host}").hostname if host and _is_host(host) else None
        if name is None or not (name in self.names or (not is_loopback(self.host) and _address(name))):
            return "this name of the server is not known; open the address that scoup view printed"
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "requests from other sites are refused"
        if method != "GET" and site not in (None, "same-origin", "none"):
            return "requests from other sites are refused"
        return None


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches a host."""
    address = _address(host)
    return host.lower() == "localhost" or (address is not None and address.is_loopback)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _is_host(text: str) -> bool:
    """Return whether the header Host is a name or an address, with or without a port."""
    try:
        parts = urlsplit(f"//{text}")
        return parts.netloc == text and not parts.username and parts.port != 0
    except ValueError:
        return False
