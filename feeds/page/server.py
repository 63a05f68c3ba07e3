"""Serves the page from within a session's own event loop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING

from plotfeed.feeds.page.page_access import (
    AUDIENCE_PATH,
    PageAccess,
    PageAddress,
    Tokens,
    listening,
)
from plotfeed.feeds.page.updates import Controls, Viewer
from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    import uvicorn


UPDATE_EVERY_S = 0.1
log = logging.getLogger("plotfeed")


class PageServer:
    """A view, served at an address."""

    def __init__(
        self,
        address: PageAddress,
        view: View,
        controls: Controls,
        now_utc_ns: Callable[[], int],
        tokens: Tokens,
    ) -> None:
        self.viewers: set[Viewer] = set()
        self._server: uvicorn.Server | None = None
        self._view = view
        self._controls = controls
        self._now_utc_ns = now_utc_ns
        self._socket = listening(address)
        port = self._socket.getsockname()[1]
        self._address = PageAddress(address.host, port)
        self._access = PageAccess(self._address, tokens)

    @property
    def url(self) -> str:
        """The presenter's address, with the token if one is needed."""
        return self._address.url("/", self._access.tokens.presenter)

    @property
    def audience_url(self) -> str:
        """The audience's address, with the token if one is needed."""
        return self._address.url(f"{AUDIENCE_PATH}/", self._access.tokens.audience)

    @property
    def urls(self) -> dict[str, str]:
        """What to tell people: the audience's address where it needs a token of its own."""
        told = {"page": self.url}
        return told | ({"audience": self.audience_url} if self._access.tokens.audience else {})

    async def serve(self) -> None:
        """Serve whoever comes, until `end`; those who come early wait until it is loaded."""
        self._server = await asyncio.to_thread(self._loaded)
        await self._server.serve([self._socket])

    async def end(self, serving: asyncio.Task[None]) -> None:
        """Serve nobody any more, and give up the address."""
        if self._server is None:
            serving.cancel()
        else:
            self._server.should_exit = True
        for viewer in self.viewers:
            viewer.start_again()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await asyncio.wait_for(serving, 2.0)
        self._socket.close()

    def _loaded(self) -> uvicorn.Server:
        """Load the application, in a thread: a session does not wait for the page's libraries."""
        from plotfeed.feeds.page.application import Application

        application = Application(
            self.viewers, self._view, self._controls, self._now_utc_ns, self.audience_url
        )
        return application.server(self._access)

    async def publish(self) -> None:
        """Offer an update to every viewer, ten times a second on absolute deadlines."""
        due_s = time.monotonic()
        while True:
            due_s = max(due_s + UPDATE_EVERY_S, time.monotonic())
            await asyncio.sleep(due_s - time.monotonic())
            update = self._view.update(self._now_utc_ns(), time.monotonic())
            for viewer in self.viewers:
                if update.is_snapshot:
                    viewer.start_again()
                else:
                    viewer.offer(update)


@contextlib.asynccontextmanager
async def serving(
    address: PageAddress,
    view: View,
    controls: Controls,
    now_utc_ns: Callable[[], int],
    *,
    tokens: Tokens = Tokens(),  # noqa: B008 - it does not change
) -> AsyncIterator[PageServer]:
    """The view at that address for as long as this lasts; raises `PageError` if it is not free.

    `now_utc_ns` tells the session's time; tokens that are not given are drawn if needed. What goes
    wrong with the page later stops nobody.
    """
    server = PageServer(address, view, controls, now_utc_ns, tokens)
    serve, publish = (
        asyncio.create_task(work, name="page") for work in (server.serve(), server.publish())
    )
    for task in (serve, publish):
        task.add_done_callback(_told_of_failure)
    try:
        yield server
    finally:
        publish.cancel()
        await server.end(serve)


def _told_of_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        log.warning("the page is gone: %r", task.exception())
