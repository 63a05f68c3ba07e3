"""The page of a fleet: its scene, what its broker delivers, and how its parts do."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.fleet.fleet_watch import FleetWatch, gap_words
from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.page_sessions import CLOCK_CONTROLS, REAL_TIME
from plotfeed.feeds.page.recorded_sectors import nobody_s
from plotfeed.feeds.page.run_with_page import alongside, tracks_of
from plotfeed.feeds.page.scene_outline import connections
from plotfeed.feeds.page.server import serving
from plotfeed.feeds.page.updates import NoControls
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorded_plots import plot_topics
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import DecodeError

EVERY_S = 1.0
LAST_GAPS = 5
PAGE_LIBRARIES = ("starlette", "uvicorn", "websockets")
NO_COMMANDS = "A fleet takes no commands from its page."
REFUSES = dict.fromkeys(CLOCK_CONTROLS, REAL_TIME) | dict.fromkeys(
    ("restart", "record", "scene", "replay", "sensor", "story"), NO_COMMANDS
)


@contextlib.asynccontextmanager
async def shown_on_page(
    address: PageAddress, watch: FleetWatch, tokens: Tokens
) -> AsyncIterator[dict[str, str]]:
    """The page of that fleet meanwhile; its addresses. Raises `PlotfeedError`."""
    for library in PAGE_LIBRARIES:
        need_extra(library, "the page", "page")
    view, scene = View(), watch.scene
    view.scene(scene)
    for sensor in scene.sensor:
        view.settings(sensor, watch.now_utc_ns)
    clock = {"kind": "wall", "paused": False, "speed": 1.0}
    view.session({"clock": clock, "refuses": REFUSES})
    view.tell(connect=connections(scene, {"MQTT": str(watch.link.address)}))
    async with (
        serving(address, view, NoControls(), lambda: watch.now_utc_ns, tokens=tokens) as server,
        alongside(_tell(view, watch), "page-fleet"),
        _heard(view, watch),
    ):
        yield server.urls


@contextlib.asynccontextmanager
async def _heard(view: View, watch: FleetWatch) -> AsyncIterator[None]:
    """Show plots and tracks that come from the broker, each plot by one of its formats."""
    scene, address = watch.scene, watch.link.address
    readers = {}
    for sensor in scene.sensor:
        told = (row for row in FORMATS.values() if row.name in sensor.report)
        row = next((row for row in told if row.facts.topic in plot_topics()), None)
        if row is not None and row.plots_in is not None:
            readers[f"{scene.mqtt.prefix}/{sensor.id}/{row.facts.topic}"] = sensor.id, row.plots_in

    def take(topic: str, payload: bytes, _content_type: str | None) -> None:
        (sensor, read), now_ns = readers[topic], watch.now_utc_ns
        with contextlib.suppress(DecodeError):
            plots = read(payload, now_ns)
            times_ns = [now_ns if t_ns is None else t_ns for t_ns in plots.t_utc_ns]
            timed = plots.but(t_utc_ns=np.array(times_ns, np.int64))
            view.delivered(sensor, nobody_s(timed), now_ns)

    plots_link = MqttTransport(address, "plotfeed-page", subscribe=[*readers], on_message=take)
    tracks = tracks_of(scene, view, ([address], {}), lambda: watch.now_utc_ns)
    async with tracks, alongside(plots_link.run(), "page-plots"):
        yield


async def _tell(view: View, watch: FleetWatch) -> None:
    while True:
        news = watch.news()
        gaps = news["gaps"]
        lasting = {"gaps": len(gaps), "last_gaps": [*map(gap_words, gaps[-LAST_GAPS:])][::-1]}
        view.tell(fleet={"takeovers": news["takeovers"], "parts": news["parts"], **lasting})
        await asyncio.sleep(EVERY_S)
