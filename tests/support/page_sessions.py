"""Real sessions with a page beside them, in the test's own event loop, and a viewer's end of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from support.waiting import PATIENCE_S
from websockets.asyncio.client import connect

from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.run_with_page import run_with_page
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import Session
from plotfeed.feeds.timing.clock import WallClock


class Begun(Observer):
    """The names of the scenes that ran."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.waiting: asyncio.Event = asyncio.Event()

    def begun(self, session: Session) -> None:
        self.names.append(session.scene.scene.name)
        self.waiting.set()

    async def wait(self) -> None:
        """For a session, since this was cleared."""
        async with asyncio.timeout(PATIENCE_S):
            await self.waiting.wait()


@asynccontextmanager
async def with_page(scene: Scene, broker: str = "none") -> AsyncIterator[tuple[Any, Begun]]:
    """The page's WebSocket, once a session has begun; all of it ends with this."""
    begun, stop, ready = Begun(), asyncio.Event(), asyncio.Event()
    urls: dict[str, str] = {}

    def on_ready(found: dict[str, str], _totals: Any) -> None:
        urls.update(found)
        ready.set()

    running = asyncio.create_task(
        run_with_page(
            PageAddress("127.0.0.1", 0),
            scene,
            clock=WallClock(),
            another_clock=lambda _scene: WallClock(),
            broker=broker,
            duration_s=None,
            stop=stop,
            observers=[begun],
            on_ready=on_ready,
        )
    )
    async with asyncio.timeout(PATIENCE_S):
        await ready.wait()
    await begun.wait()
    host = urls["page"].removeprefix("http://").rstrip("/")
    origin: Any = f"http://{host}"
    async with connect(f"ws://{host}/feed", origin=origin, max_size=None) as feed:
        yield feed, begun
        stop.set()
        async with asyncio.timeout(PATIENCE_S):
            await running
