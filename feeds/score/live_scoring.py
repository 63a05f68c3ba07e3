"""Scores a session while it runs: has the score told and published every second."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.score.live_score import LiveScore
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.outputs import Brokers, brokers_of
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.content_types import JSON

EVERY_S = 1.0
TOPIC = "score"
"""Behind the prefix; no sensor may have that name, since it is one level."""
OnScore = Callable[[dict[str, Any]], None]


def is_scored(scene: Scene) -> bool:
    """Whether the scene says where a tracker under test publishes."""
    return scene.page.tracks_topic is not None


@contextlib.asynccontextmanager
async def scoring(
    scene: Scene,
    brokers: Brokers,
    live: LiveScore,
    now_utc_ns: Callable[[], int],
    *,
    clock: Clock,
    on_score: OnScore | None = None,
) -> AsyncIterator[None]:
    """Score a session meanwhile, if its scene has a tracker under test.

    The score is published with the truth, and where that is not, only `on_score` is told.
    """
    addresses, _ = brokers
    if not is_scored(scene) or not addresses:
        yield
        return
    links = [MqttTransport(each, "plotfeed-score") for each in addresses if scene.mqtt.truth]
    outbox = Outbox(clock, links)

    async def tell() -> None:
        number = 0
        while True:
            await asyncio.sleep(EVERY_S)
            now_ns = now_utc_ns()
            found = live.score(now_ns)
            if found is None:
                continue
            number += 1
            if on_score is not None:
                on_score(found)
            message = score_message(scene.mqtt.prefix, found, number, now_ns)
            outbox.send_past_link(message)

    tasks = [asyncio.create_task(link.run(), name="score-link") for link in links]
    tasks.append(asyncio.create_task(tell(), name="score"))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def score_message(prefix: str, score: dict[str, Any], number: int, now_utc_ns: int) -> Message:
    """A score as it is published."""
    return Message(
        topic=f"{prefix}/{TOPIC}",
        payload=json.dumps(score).encode(),
        content_type=JSON,
        due_utc_ns=now_utc_ns,
        properties=attributes(prefix, TOPIC, str(number), now_utc_ns),
    )


async def run_scored(
    scene: Scene,
    *,
    clock: Clock,
    broker: str | None,
    duration_s: float | None,
    stop: asyncio.Event,
    observers: Sequence[Observer],
    on_ready: Callable[[dict[str, str], SessionCounters], None],
) -> SessionCounters:
    """Run a scene and score its tracker meanwhile, without a page; raises `PlotfeedError`."""
    live = LiveScore()
    async with (
        brokers_of(scene, broker) as brokers,
        scoring(scene, brokers, live, clock.now_ns, clock=clock),
    ):
        return await run_over(
            brokers,
            scene,
            clock=clock,
            duration_s=duration_s,
            stop=stop,
            observers=[*observers, live],
            on_ready=on_ready,
        )
