"""Access to the page by host, origin and token, and how much an audience is shown.

No other web site has any, and each role has its own address.
"""

from __future__ import annotations

import hmac
import json
import socket
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from http.cookies import CookieError, SimpleCookie
from typing import Any, ClassVar, NamedTuple

from plotfeed.feeds.console.posix import listen_again
from plotfeed.feeds.console.printed import in_short
from plotfeed.feeds.transport.local_hosts import ServedAddress, drawn_token, fixed_token
from plotfeed.proto.errors import PlotfeedError

KEPT_ACTIONS = 40
MAX_NAME, MAX_WORDS = 40, 160  # Characters of a viewer's name, and of what he did
# Counts that say what only the truth knows.
TRUE_TOTALS = frozenset({"drones", "forgotten", "looks", "false_alarms", "telemetry", "refused"})
GIFTS = ("truth", "controls")


class Role(StrEnum):
    """The address by which a viewer came: presenter or audience."""

    PRESENTER = "presenter"
    AUDIENCE = "audience"


class Audience:
    """What the presenter has given the audience, and a log of what was done."""

    def __init__(self) -> None:
        self.truth = False
        self.controls = False
        self._numbers = dict.fromkeys(Role, 0)
        self._actions: deque[dict[str, Any]] = deque(maxlen=KEPT_ACTIONS)

    @property
    def news(self) -> dict[str, bool]:
        """What is given, as every page is told."""
        return {gift: getattr(self, gift) for gift in GIFTS}

    @property
    def actions(self) -> list[dict[str, Any]]:
        """The log, the oldest action first."""
        return list(self._actions)

    def called(self, role: Role) -> str:
        """What the next viewer of that role is called."""
        self._numbers[role] += 1
        return f"{role} {self._numbers[role]}"

    def log(self, t_utc_ns: int, who: str, command: Mapping[str, Any]) -> None:
        """Somebody did that."""
        what = words_of(command)
        self._actions.append({"t_utc_ms": t_utc_ns // 1_000_000, "who": who, "what": what})

    def check_look(self, role: Role, *, truth: bool) -> None:
        """Raise `PlotfeedError` if who has that role may not see the truth that he asks for."""
        if truth and role is Role.AUDIENCE and not self.truth:
            raise PlotfeedError("the audience sees no truth unless the presenter gives it")

    def check_command(self, role: Role, command: Mapping[str, Any]) -> None:
        """Raise `PlotfeedError` if who has that role may not ask for that."""
        if role is Role.PRESENTER:
            return
        if "audience" in command:
            raise PlotfeedError("only the presenter says what the audience may do")
        if not self.controls:
            raise PlotfeedError("the audience has no controls unless the presenter gives them")

    def give(self, asked: object) -> None:
        """Give or take what a presenter's command says; raises `PlotfeedError`."""
        if not isinstance(asked, dict) or not asked or asked.keys() - set(GIFTS):
            raise PlotfeedError(f"audience: expected {' or '.join(GIFTS)}")
        if not all(isinstance(given, bool) for given in asked.values()):
            raise PlotfeedError("audience: expected true or false")
        for gift, given in asked.items():
            setattr(self, gift, given)


def name_in(text: object) -> str:
    """A viewer's name of himself, as it may be shown; raises `PlotfeedError`."""
    if not isinstance(text, str):
        raise PlotfeedError("look: expected a name in words")
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:MAX_NAME]


def words_of(command: Mapping[str, Any]) -> str:
    """A command in a few words."""
    asked = dict(command)
    if "sensor" in asked:
        told = f"{asked.pop('sensor')}: {', '.join(_leaves(asked))}"
    else:
        told = ", ".join(
            f"{subject}: {', '.join(_leaves(tree))}"
            if isinstance(tree, dict)
            else ", ".join(_leaves({subject: tree}))
            for subject, tree in asked.items()
        )
    return told[:MAX_WORDS]


def _leaves(tree: object, path: str = "") -> list[str]:
    """Every value of a tree, after the keys that lead there."""
    if isinstance(tree, dict) and tree:
        keys = (
            (f"{path} {key}" if path and path != "set" else str(key), tree[key]) for key in tree
        )
        return [leaf for path, below in keys for leaf in _leaves(below, path)]
    said = tree if isinstance(tree, str) else json.dumps(in_short(tree))
    return [path if tree is True else f"{path} {said}".strip()]


def without_truth(told: Mapping[str, Any]) -> dict[str, Any]:
    """News as the audience has them, as long as it is not given the truth."""
    shown = dict(told)
    if "totals" in told:
        shown["totals"] = {k: v for k, v in told["totals"].items() if k not in TRUE_TOTALS}
    if "details" in told:
        shown["details"] = {
            sensor: {**of, "detections": None} for sensor, of in told["details"].items()
        }
    if "scene" in told:
        shown["scene"] = {**told["scene"], "about": {**told["scene"]["about"], "look_for": []}}
    if "refusal" in told:
        shown["refusal"] = None
    return shown


# Keys of news that the audience has otherwise.
CONCEALS = frozenset({"totals", "details", "scene", "refusal"})


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
