"""Access to the page by host, origin and token: no other web site, and to each his own address."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import NamedTuple, Self

from plotfeed.feeds.console.posix import listen_again
from plotfeed.feeds.page.audience import Role
from plotfeed.feeds.transport.local_hosts import LOOPBACK, LOOPBACK_NAMES, name_in_host
from plotfeed.proto.errors import PlotfeedError

DEFAULT_PORT = 8590
TOKEN_OCTETS = 18
TOKEN_VARIABLE = "PLOTFEED_PAGE_TOKEN"  # noqa: S105 - its name  # nosec B105
AUDIENCE_VARIABLE = "PLOTFEED_AUDIENCE_TOKEN"
"""The same for the audience's address."""
AUDIENCE_PATH = "/audience"
"""Below it is what the audience may ask for; its own page is there with a slash."""
PRESENTERS_PATHS = frozenset({"/", "/feed"})
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


class Tokens(NamedTuple):
    """What opens the page's two addresses; None where one is to be drawn, or none is needed."""

    presenter: str | None = None
    audience: str | None = None


def fixed_tokens(environment: Mapping[str, str]) -> Tokens:
    """The tokens that the environment fixes, so that links outlast a restart.

    Raises `PlotfeedError`, without the token, where one is too short or would not fit in a link,
    or where both are the same.
    """
    tokens = Tokens(environment.get(TOKEN_VARIABLE), environment.get(AUDIENCE_VARIABLE))
    for variable, token in zip((TOKEN_VARIABLE, AUDIENCE_VARIABLE), tokens, strict=True):
        if token is not None and not FIXED_TOKEN.fullmatch(token):
            raise PlotfeedError(
                f"{variable}: expected 16 to 128 letters, digits, - and _, not what it holds"
            )
    if tokens.presenter is not None and tokens.presenter == tokens.audience:
        raise PlotfeedError(f"{AUDIENCE_VARIABLE}: expected another token than {TOKEN_VARIABLE}")
    return tokens


class PageAccess:
    """Decides about requests, given their headers by lower-case names."""

    def __init__(self, address: PageAddress, fixed: Tokens = Tokens()) -> None:  # noqa: B008
        """Tokens are drawn where they are needed: beyond loopback, and beside a fixed one."""
        self._address = address
        self.tokens = Tokens()
        if not address.is_loopback or any(fixed):
            self.tokens = Tokens(
                fixed.presenter or secrets.token_urlsafe(TOKEN_OCTETS),
                fixed.audience or secrets.token_urlsafe(TOKEN_OCTETS),
            )

    def cookie(self, role: Role) -> str:
        """The name of the cookie that keeps that role's token."""
        name = f"plotfeed-{self._address.port}"
        return name if role is Role.PRESENTER else f"{name}-audience"

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

    def role_with(self, token: str) -> Role | None:
        """Whose token that is; None if nobody's."""
        for role, own in zip((Role.PRESENTER, Role.AUDIENCE), self.tokens, strict=True):
            if own is not None and hmac.compare_digest(token.encode(), own.encode()):
                return role
        return None

    def may_ask(self, headers: Mapping[str, str], path: str) -> bool:
        """Says whether a request's cookies open what it asks for: a presenter's open everything."""
        if self.tokens.presenter is None:
            return True
        roles = {Role.PRESENTER} if path in PRESENTERS_PATHS else set(Role)
        return not roles.isdisjoint(self._roles_in(headers.get("cookie", "")))

    def _roles_in(self, cookies: str) -> Iterator[Role]:
        try:
            found = SimpleCookie(cookies)
        except CookieError:
            return
        for role in Role:
            morsel = found.get(self.cookie(role))
            if morsel is not None and self.role_with(morsel.value) is role:
                yield role


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
        listen_again(listener)
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
