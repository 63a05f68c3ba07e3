"""Where this machine serves over HTTP, and for whom: no web site gets at what it serves.

A page of anywhere may have its browser ask a port of this machine. Where its name stands for a
loopback address (DNS rebinding), the header Host tells it; else the header Origin does.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from plotfeed.feeds.console.printed import bracketed
from plotfeed.proto.errors import PlotfeedError

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = frozenset({"localhost", LOOPBACK, "::1"})


def name_in_host(header: str) -> str:
    """The name in a header Host, without the port, in lower case."""
    if header.startswith("["):
        return header[1:].partition("]")[0].lower()
    return header.partition(":")[0].lower()


TOKEN_OCTETS = 18
FIXED_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")


@dataclass(frozen=True, slots=True)
class ServedAddress:
    """Host and port at which something is served over HTTP."""

    option: ClassVar[str]  # By which a command is given it
    host: str = LOOPBACK
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read HOST:PORT, [V6]:PORT, or a port alone on loopback; raises `PlotfeedError`."""
        host, _, port = text.rpartition(":")
        if host.startswith("[") and host.endswith("]"):
            host = host[1:-1]
        elif ":" in host:
            host = ""
            port = ""
        if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) < 65536):
            raise PlotfeedError(
                f"{cls.option}: expected HOST:PORT, such as {LOOPBACK}:{cls().port}, not {text!r}"
            )
        return cls(host or LOOPBACK, int(port))

    @property
    def is_loopback(self) -> bool:
        """Says whether only this machine can get there."""
        address = _address(self.host)
        return self.host in LOOPBACK_NAMES or (address is not None and address.is_loopback)

    def host_is_ours(self, header: str) -> bool:
        """Says whether a request with that header Host was made to a name of this machine."""
        name = name_in_host(header)
        if name in LOOPBACK_NAMES or name == self.host.lower():
            return True
        return not self.is_loopback and (
            name == socket.gethostname().lower() or _address(name) is not None
        )

    def url(self, path: str, token: str | None) -> str:
        """Where to find a path there, with the token if there is one."""
        host = self.host
        if host in {"0.0.0.0", "::"}:  # noqa: S104 - only printed  # nosec B104
            host = socket.gethostname()
        return f"http://{bracketed(host)}:{self.port}{path}{f'?token={token}' if token else ''}"


def fixed_token(environment: Mapping[str, str], variable: str) -> str | None:
    """The token that the environment fixes, so that links outlast a restart; None for none.

    Raises `PlotfeedError`, without the token, where it is too short or would not fit in a link.
    """
    token = environment.get(variable)
    if token is not None and not FIXED_TOKEN.fullmatch(token):
        raise PlotfeedError(
            f"{variable}: expected 16 to 128 letters, digits, - and _, not what it holds"
        )
    return token


def drawn_token() -> str:
    """A token that nobody can guess."""
    return secrets.token_urlsafe(TOKEN_OCTETS)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None
