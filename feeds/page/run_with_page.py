"""Sessions and replays one after the other, with one page beside them all."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.page_observer import PageObserver, alongside
from plotfeed.feeds.page.scene_outline import Basemap, load_basemap
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.session_switch import SessionSwitch
from plotfeed.feeds.page.tracker_tracks import TrackNews, decode_tracks
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorded_session import RecordedSession
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.outputs import Brokers, brokers_of
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import PlotfeedError


async def run_with_page(
    address: PageAddress,
    scene: Scene,
    *,
    clock: Clock,
    another_clock: Callable[[Scene], Clock],
    broker: str | None,
    duration_s: float | None,
    stop: asyncio.Event,
    observers: Sequence[Observer],
    on_ready: Callable[[dict[str, str], SessionCounters], None],
) -> SessionCounters:
    """Sessions and replays, as the page's viewers want it; the totals of the last session.

    Raises `PlotfeedError`. The brokers and the page outlast a session.
    """
    view = View()
    switch = SessionSwitch(scene, view, Path.cwd())
    observer = PageObserver(view, switch)
    server = PageServer(address, view, observer, lambda: _shown_utc_ns(switch, observer))
    stopping = asyncio.create_task(_pass_on(stop, switch.ending), name="page-stop")
    told, totals = False, SessionCounters()

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        nonlocal told
        if not told:
            on_ready({**urls, "page": server.url}, totals)
        told = True

    try:
        async with (
            brokers_of(scene, broker) as brokers,
            serving(server),
            alongside(observer.follow(), "page-follow"),
        ):
            while True:
                recording = switch.begin()
                if stop.is_set():
                    switch.ending.set()
                if recording is not None:
                    await _replay(switch, recording, view, brokers)
                else:
                    observer.scene(_basemap_of(switch.scene))
                    async with _tracks_of(switch.scene, view, brokers, observer.now_utc_ns):
                        totals = await run_over(
                            brokers,
                            switch.scene,
                            clock=clock,
                            duration_s=duration_s,
                            stop=switch.ending,
                            observers=[*observers, observer, switch],
                            on_ready=ready,
                        )
                if stop.is_set() or not switch.goes_on:
                    return totals
                clock = another_clock(switch.scene)
    finally:
        stopping.cancel()
        server.close()


async def _replay(
    switch: SessionSwitch, recording: RecordedSession, view: View, brokers: Brokers
) -> None:
    """Replay in place of a session, with the map that is known if the scene is the same."""

    def shown(tracks: TrackNews) -> TrackNews:
        return tracks if switch.replaying is None else switch.replaying.shown_tracks(tracks)

    basemap = _basemap_of(switch.scene) if recording.scene.text == switch.scene.text else None
    async with _tracks_of(recording.scene, view, brokers, time.time_ns, shown):
        await switch.replay(recording, brokers[0], basemap)


def _shown_utc_ns(switch: SessionSwitch, observer: PageObserver) -> int:
    return observer.now_utc_ns() if switch.replaying is None else switch.replaying.now_utc_ns


async def _pass_on(stop: asyncio.Event, ending: asyncio.Event) -> None:
    await stop.wait()
    ending.set()


def _basemap_of(scene: Scene) -> Basemap | None:
    if scene.page.basemap is None:
        return None
    return load_basemap(scene.page.basemap, scene.folder, scene.scene.site)


@contextlib.asynccontextmanager
async def _tracks_of(
    scene: Scene,
    view: View,
    brokers: Brokers,
    now_utc_ns: Callable[[], int],
    shown: Callable[[TrackNews], TrackNews] = lambda tracks: tracks,
) -> AsyncIterator[None]:
    """Show tracks of the tracker under test, from every broker of the session."""
    async with contextlib.AsyncExitStack() as receiving:
        topic, (addresses, _) = scene.page.tracks_topic, brokers
        if topic is not None:
            for address in addresses:
                tracks = receiving_tracks(view, scene, address, topic, now_utc_ns, shown=shown)
                await receiving.enter_async_context(tracks)
        yield


@contextlib.asynccontextmanager
async def receiving_tracks(
    view: View,
    scene: Scene,
    address: BrokerAddress,
    topic: str,
    now_utc_ns: Callable[[], int],
    *,
    shown: Callable[[TrackNews], TrackNews] = lambda tracks: tracks,
) -> AsyncIterator[None]:
    """Show the tracks that come on a topic; what cannot be read is said on the page.

    `now_utc_ns` is the tracker's time; `shown` are its tracks at the times that the page shows.
    """
    site = site_frame(scene.scene.site)

    def take(_topic: str, payload: bytes, _content_type: str | None) -> None:
        try:
            view.tracks(shown(decode_tracks(payload, now_utc_ns(), site)))
        except PlotfeedError as error:
            view.track_problem(str(error))

    link = MqttTransport(address, "plotfeed-page", subscribe=[topic], on_message=take)
    async with alongside(link.run(), "page-tracks"):
        yield
