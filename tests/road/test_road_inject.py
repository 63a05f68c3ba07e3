"""Logs of flights injected over a real broker into sessions that run by the clock on the wall.

Some sessions at once, each with its own embedded broker and a process of its own that injects.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from dataclasses import dataclass

import numpy as np
import pytest_asyncio
from support.brokers import free_port
from support.given_flights import EVERY_FLIGHT, FLIGHTS, GivenFlight
from support.waiting import until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.session.session import run
from plotfeed.models.frames import aer_to_enu
from plotfeed.testing import Feed, FeedTable, staring

SPEED = 20
STALE_S = 0.3  # It does not fly straight on for long when nothing comes any more
SHORT_S = 12.0  # A flight that takes less is injected to its end
AT_ONCE = 3  # Sessions, each with a process that injects twenty times as fast as was flown
LOOKS = 90  # At the least: on a busy machine a flight is injected again until there are so many


@dataclass(frozen=True, eq=False)
class Live:
    """What left, what the session counted, and how often `inject` came to its end."""

    road: Feed
    totals: SessionCounters
    ended: int


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def sessions() -> dict[str, Live]:
    room = asyncio.Semaphore(AT_ONCE)

    async def flown(flight: GivenFlight) -> Live:
        async with room:
            return await _live(flight, free_port())

    flights = [flown(flight) for flight in FLIGHTS]
    files = (flight.file for flight in FLIGHTS)
    return dict(zip(files, await asyncio.gather(*flights), strict=True))


async def _live(flight: GivenFlight, port: int) -> Live:
    messages: list[Message] = []
    stop = asyncio.Event()
    injecting: list[asyncio.Task[int]] = []

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        injecting.append(asyncio.create_task(_inject(flight, urls["MQTT"], totals, stop)))

    sensor = {"id": "radar", "scan": staring(0.1)}
    scene = flight.scene(
        sensor,
        seed=111,
        mqtt={"port": port},
        telemetry={"stale_after_s": STALE_S, "max_speed_m_s": 1000.0, **flight.datum},
    )
    totals = await run(
        scene, stop=stop, tap=lambda message, _: messages.append(message), on_ready=ready
    )
    return Live(Feed(messages), totals, await injecting[0])


async def _inject(
    flight: GivenFlight, broker: str, totals: SessionCounters, stop: asyncio.Event
) -> int:
    """Run the command until there are looks enough, a short flight to its end; stop the session."""
    more = ["--set", f"altitude_reference={flight.reference.value}"] if flight.reference else []
    is_short, ended = flight.flight.duration_s / SPEED < SHORT_S, 0
    try:
        while totals.looks < LOOKS:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                *("-m", "plotfeed.feeds.cli", "inject", str(flight.log)),
                *("--broker", broker, "--drone", "d", "--now", "--speed", str(SPEED), *more),
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
            )
            telling = asyncio.create_task(process.communicate())
            await until(
                lambda: telling.done() or (not is_short and totals.looks >= LOOKS)  # noqa: B023
            )
            if not telling.done():
                process.terminate()
            told, _ = await telling
            assert process.returncode in (0, -signal.SIGTERM), told.decode()
            ended += process.returncode == 0
    finally:
        stop.set()
    return ended


def detections(sessions: dict[str, Live], flight: GivenFlight) -> FeedTable:
    plots = sessions[flight.file].road.plots()
    return plots.rows(plots.drone == "d")


@EVERY_FLIGHT
def test_every_report_is_taken(sessions: dict[str, Live], flight: GivenFlight) -> None:
    live = sessions[flight.file]
    assert live.totals.refused == 0, live.totals.last_refusal
    assert live.totals.telemetry > 100
    assert live.totals.undelivered == 0
    if flight.flight.duration_s / SPEED < SHORT_S:
        assert live.totals.telemetry == live.ended * len(flight.flight.reports) > 0


@EVERY_FLIGHT
def test_the_drone_is_taken_to_be_on_the_path_that_was_recorded(
    sessions: dict[str, Live], flight: GivenFlight
) -> None:
    """In space, whatever the hour: a report that comes late leaves it flying straight on."""
    plots = detections(sessions, flight)
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    path = flight.path(np.arange(0, flight.flight.duration_s, 0.1))
    apart_m = np.array([np.linalg.norm(path - place, axis=1).min() for place in true])
    assert np.median(apart_m) < 2
    assert np.quantile(apart_m, 0.9) < 10
    extent_m = np.ptp(path, axis=0).max()
    assert np.ptp(true, axis=0).max() > min(extent_m / 4, 60)
