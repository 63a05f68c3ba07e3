"""Access to the page by host, origin and token, so that no other web site can get at it."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Self

from plotfeed.feeds.transport.local_hosts import LOOPBACK, LOOPBACK_NAMES, name_in_host
from plotfeed.proto.errors import PlotfeedError

DEFAULT_PORT = 8590
TOKEN_OCTETS = 18
TOKEN_VARIABLE = "PLOTFEED_PAGE_TOKEN"  # noqa: S105 - its name  # nosec B105
FIXED_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Host and port at which the page is served."""

    host: str = LOOPBACK
    port: int = DEFAULT_PORT

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
                f"--page: expected HOST:PORT, such as 127.0.0.1:{DEFAULT_PORT}, not {text!r}"
            )
        return cls(host or LOOPBACK, int(port))

    @property
    def is_loopback(self) -> bool:
        """Says whether only this machine can get there."""
        if self.host in LOOPBACK_NAMES:
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def fixed_token(environment: Mapping[str, str]) -> str | None:
    """The token that the environment fixes, so that a link outlasts a restart; None if none.

    Raises `PlotfeedError`, without the token, where it is too short or would not fit in a link.
    """
    token = environment.get(TOKEN_VARIABLE)
    if token is not None and not FIXED_TOKEN.fullmatch(token):
        raise PlotfeedError(
            f"{TOKEN_VARIABLE}: expected 16 to 128 letters, digits, - and _, not what it holds"
        )
    return token


class PageAccess:
    """Decides about requests, given their headers by lower-case names."""

    def __init__(self, address: PageAddress, token: str | None = None) -> None:
        """A token is drawn where one is needed."""
        self._address = address
        self.token: str | None = None
        if not address.is_loopback:
            self.token = token or secrets.token_urlsafe(TOKEN_OCTETS)
        self.cookie = f"plotfeed-{address.port}"

    def host_is_ours(self, headers: Mapping[str, str]) -> bool:
        """Says whether a request was made to a name of this machine."""
        name = name_in_host(headers.get("host", ""))
        if self._address.is_loopback:
            return name in LOOPBACK_NAMES or name == self._address.host.lower()
        return (
            name in LOOPBACK_NAMES
            or name in {self._address.host.lower(), socket.gethostname().lower()}
            or _is_address(name)
        )

    def origin_is_ours(self, headers: Mapping[str, str]) -> bool:
        """Says whether a script that asks comes from this very page."""
        origin, host = headers.get("origin"), headers.get("host")
        return host is not None and origin in {f"http://{host}", f"https://{host}"}

    def is_token(self, token: str | None) -> bool:
        """Says whether a token is the one that was printed, or none is needed."""
        if self.token is None:
            return True
        return token is not None and hmac.compare_digest(token.encode(), self.token.encode())

    def has_token(self, headers: Mapping[str, str]) -> bool:
        """Says whether a request's cookie holds the token, or none is needed."""
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            morsel = None
        return self.is_token(None if morsel is None else morsel.value)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


ABORT_MS = 10_000
"""A connection whose other end takes nothing for so long is given up by the system, on Linux."""


class PageError(PlotfeedError):
    """The page cannot be served."""

    exit_code = 1


def listening(address: PageAddress) -> socket.socket:
    """A socket that listens there; raises `PageError` in one line."""
    where = f"--page {address.host}:{address.port}"
    listener = None
    try:
        found = socket.getaddrinfo(
            address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        family, _, _, _, target = found[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ABORT_MS)
        listener.bind(target)
        listener.listen(100)
        listener.setblocking(False)
    except OSError as error:
        if listener is not None:
            listener.close()
        raise PageError(f"{where}: {error.strerror or error}") from None
    return listener
