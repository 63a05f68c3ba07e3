"""A page beside sessions and replays, a viewer's end of it, and what a client hears of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from support.page_updates import Frame, read_frame
from support.waiting import PATIENCE_S
from websockets.asyncio.client import connect

from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.run_with_page import run_with_page
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import Session
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.testing import MqttMessage, MqttReceiver

TRACKS = "lab/track_reports"
SESSION_S = 20
Act = Callable[["Viewer", MqttReceiver, "Begun"], Any]


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


def feed_of(url: str) -> connect:
    """The WebSocket of the page at that address, as the page itself opens it."""
    host = url.removeprefix("http://").rstrip("/")
    origin: Any = f"http://{host}"
    return connect(f"ws://{host}/feed", origin=origin, max_size=None, compression=None)


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
    async with feed_of(urls["page"]) as feed:
        yield feed, begun
        stop.set()
        async with asyncio.timeout(PATIENCE_S):
            await running


class Viewer:
    """A page's end of the feed, which keeps what it is shown."""

    def __init__(self, feed: Any) -> None:
        self._feed = feed
        self.frames: list[Frame] = []
        self.session: dict[str, Any] = {}
        self.scene = ""

    async def ask(self, **command: Any) -> dict[str, Any]:
        await self._feed.send(json.dumps({"number": 7, "command": command}))
        async with asyncio.timeout(PATIENCE_S):
            while (answer := await self._heard()) is None or answer.get("number") != 7:
                pass
        return answer

    async def done(self, **command: Any) -> Any:
        answer = await self.ask(**command)
        assert answer["ok"], answer
        return answer["in_force"]

    async def until(self, holds: Callable[[], Any]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not holds():
                await self._heard()

    async def settled(self, client: MqttReceiver) -> int:
        """How many messages have come once no more do; what left before a pause has come by then.

        What is shown meanwhile is read: who reads nothing is cut off.
        """
        count = -1
        while count != len(client.heard):
            count = len(client.heard)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.3):
                    await self.until(lambda: False)
        return count

    async def load(self, name: str = "session.mcap") -> None:
        """Until it plays."""
        await self.done(replay={"load": name})
        await self.until(lambda: self.replay.get("position_s", 0) > 0)

    @property
    def replay(self) -> dict[str, Any]:
        found: dict[str, Any] = self.session.get("replay", {})
        return found

    @property
    def is_at_end(self) -> bool:
        return (
            bool(self.replay["paused"]) and self.replay["position_s"] == self.replay["duration_s"]
        )

    async def _heard(self) -> dict[str, Any] | None:
        heard = await self._feed.recv()
        if isinstance(heard, str):
            return dict(json.loads(heard))
        self.frames.append(read_frame(heard))
        self.session = self.frames[-1].news.get("session", self.session)
        self.scene = self.frames[-1].news.get("scene", {"name": self.scene})["name"]
        return None


def of_lab(client: MqttReceiver, since: int = 0) -> list[MqttMessage]:
    return [m for m in client.heard[since:] if m.topic.startswith("lab/") and m.topic != TRACKS]
