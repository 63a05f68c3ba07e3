"""The page, served from an event loop in a thread of its own, for tests that look at it."""

from __future__ import annotations

import http.client
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlsplit

from anyio.from_thread import BlockingPortal, start_blocking_portal
from support.chromium import wait_beside
from support.made_up_session import MadeUpSession
from support.waiting import PATIENCE_S
from websockets.sync.client import ClientConnection, connect

from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.updates import Controls
from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

LOOPBACK = PageAddress("127.0.0.1", 0)


@dataclass(frozen=True)
class Served:
    url: str
    server: PageServer
    loop: BlockingPortal

    @property
    def port(self) -> int:
        port = urlsplit(self.url).port
        assert port
        return port

    @property
    def view(self) -> View:
        """The page's view, whose methods run where the server does."""
        return cast("View", _InLoop(self))

    def call(self, function: Callable[[], Any]) -> Any:
        """What a function gives that must run where the server does."""
        return self.loop.call(function)

    def get(self, path: str = "/", **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Status, headers by lower-case names, body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            sent = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.putrequest("GET", path, skip_host="Host" in sent)
            for name, value in sent.items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            found = {name.lower(): value for name, value in answer.getheaders()}
            return answer.status, found, answer.read()
        finally:
            connection.close()

    def feed(
        self, *, origin: str | None = None, path: str = "/feed", **more: Any
    ) -> ClientConnection:
        """A viewer's WebSocket, from the page itself unless another origin is given."""
        host = f"127.0.0.1:{self.port}"
        return connect(
            f"ws://{host}{path}",
            origin=origin or f"http://{host}",  # type: ignore[arg-type] - a NewType of str
            compression=None,
            open_timeout=PATIENCE_S,
            max_size=None,
            **more,
        )


class _InLoop:
    def __init__(self, served: Served) -> None:
        self._served = served

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self._served.server._view, name)
        return lambda *told, **more: self._served.call(lambda: method(*told, **more))


@contextmanager
def served(
    view: View,
    controls: Controls,
    now_utc_ns: Callable[[], int],
    *,
    address: PageAddress = LOOPBACK,
    tokens: Tokens = Tokens(),  # noqa: B008 - it does not change
    playing: Callable[[], Coroutine[Any, Any, Any]] | None = None,
) -> Iterator[Served]:
    """Meanwhile `playing` runs in the same loop."""
    server = serving(address, view, controls, now_utc_ns, tokens=tokens)
    with start_blocking_portal() as loop, loop.wrap_async_context_manager(server) as page:
        plays = loop.start_task_soon(playing) if playing else None
        try:
            yield Served(page.url, page, loop)
        finally:
            if plays is not None:
                plays.cancel()


@contextmanager
def on_stage(stage: MadeUpSession, **more: Any) -> Iterator[Served]:
    """A stage that plays, and is the page's controls."""
    assert stage.view is not None
    with served(stage.view, stage, lambda: stage.now_ns, playing=stage.run, **more) as page:
        yield page


def wait_for_command(page: Page, stage: MadeUpSession, expected: dict[str, Any]) -> None:
    wait_beside(page, lambda: expected in stage.commands, f"{expected} never came")


def clock_button(page: Page, name: str) -> Locator:
    """A button of the clock: a replay has some of the same names."""
    group = page.get_by_role("group", name="Clock")
    return group.get_by_role("button", name=name, exact=True)
