"""A viewer's end of a page that replays, and what a client hears of the replay."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

from support.page_sessions import Begun
from support.page_updates import Frame, read_frame
from support.waiting import PATIENCE_S

from plotfeed.testing import MqttMessage, MqttReceiver

TRACKS = "lab/track_reports"
SESSION_S = 20
Act = Callable[["Viewer", MqttReceiver, Begun], Any]


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


async def settled(client: MqttReceiver) -> int:
    """How many messages have come once no more do: what left before a pause has come by then."""
    count = -1
    while count != len(client.heard):
        count = len(client.heard)
        await asyncio.sleep(0.3)
    return count
