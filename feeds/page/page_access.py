"""Access to the page by host, origin and token: no other web site, and to each his own address."""

from __future__ import annotations

import hmac
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import ClassVar, NamedTuple

from plotfeed.feeds.console.posix import listen_again
from plotfeed.feeds.page.audience import Role
from plotfeed.feeds.transport.local_hosts import ServedAddress, drawn_token, fixed_token
from plotfeed.proto.errors import PlotfeedError

DEFAULT_PORT = 8590
TOKEN_VARIABLE = "PLOTFEED_PAGE_TOKEN"  # noqa: S105 - its name  # nosec B105
AUDIENCE_VARIABLE = "PLOTFEED_AUDIENCE_TOKEN"  # The same for the audience's address
# Below it is what the audience may ask for; its own page is there with a slash.
AUDIENCE_PATH = "/audience"
PRESENTERS_PATHS = frozenset({"/", "/feed"})


@dataclass(frozen=True, slots=True)
class PageAddress(ServedAddress):
    """Host and port at which the page is served."""

    option: ClassVar[str] = "--page"
    port: int = DEFAULT_PORT


class Tokens(NamedTuple):
    """What opens the page's two addresses; None where one is to be drawn, or none is needed."""

    presenter: str | None = None
    audience: str | None = None


def fixed_tokens(environment: Mapping[str, str]) -> Tokens:
    """The tokens that the environment fixes, so that links outlast a restart.

    Raises `PlotfeedError`, without the token, where one is too short or would not fit in a link,
    or where both are the same.
    """
    tokens = Tokens(*(fixed_token(environment, v) for v in (TOKEN_VARIABLE, AUDIENCE_VARIABLE)))
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
            self.tokens = Tokens(fixed.presenter or drawn_token(), fixed.audience or drawn_token())

    def cookie(self, role: Role) -> str:
        """The name of the cookie that keeps that role's token."""
        name = f"plotfeed-{self._address.port}"
        return name if role is Role.PRESENTER else f"{name}-audience"

    def host_is_ours(self, headers: Mapping[str, str]) -> bool:
        """Says whether a request was made to a name of this machine."""
        return self._address.host_is_ours(headers.get("host", ""))

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


# A connection whose other end takes nothing for so long is given up by the system, on Linux.
ABORT_MS = 10_000


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
