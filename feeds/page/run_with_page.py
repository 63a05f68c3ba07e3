"""Runs sessions with the page beside them."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.page.attach import PageObserver, following, hearing_tracks
from plotfeed.feeds.page.basemap import Basemap, load_basemap
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.session_switch import SessionSwitch
from plotfeed.feeds.page.tracker_tracks import TrackNews
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorded_session import RecordedSession
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.brokers import Brokers, brokers_of
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock


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
    stage = SessionSwitch(scene, view, Path.cwd())
    observer = PageObserver(view, stage)
    server = PageServer(address, view, observer, lambda: _shown_utc_ns(stage, observer))
    stopping = asyncio.create_task(_pass_on(stop, stage.ending), name="page-stop")
    told, totals = False, SessionCounters()

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        nonlocal told
        if not told:
            on_ready({**urls, "page": server.url}, totals)
        told = True

    try:
        async with brokers_of(scene, broker) as brokers, serving(server), following(observer):
            while True:
                recording = stage.begin()
                if stop.is_set():
                    stage.ending.set()
                if recording is not None:
                    await _replay(stage, recording, view, brokers)
                else:
                    observer.scene(_basemap_of(stage.scene))
                    async with _tracks_of(stage.scene, view, brokers, observer.now_utc_ns):
                        totals = await run_over(
                            brokers,
                            stage.scene,
                            clock=clock,
                            duration_s=duration_s,
                            stop=stage.ending,
                            observers=[*observers, observer, stage],
                            on_ready=ready,
                        )
                if stop.is_set() or not stage.goes_on:
                    return totals
                clock = another_clock(stage.scene)
    finally:
        stopping.cancel()
        server.close()


async def _replay(
    stage: SessionSwitch, recording: RecordedSession, view: View, brokers: Brokers
) -> None:
    """In place of a session; its map is known where its scene is that of the session before."""

    def shown(tracks: TrackNews) -> TrackNews:
        return tracks if stage.show is None else stage.show.shown_tracks(tracks)

    basemap = _basemap_of(stage.scene) if recording.scene.text == stage.scene.text else None
    async with _tracks_of(recording.scene, view, brokers, time.time_ns, shown):
        await stage.replay(recording, brokers[0], basemap)


def _shown_utc_ns(stage: SessionSwitch, observer: PageObserver) -> int:
    return observer.now_utc_ns() if stage.show is None else stage.show.now_utc_ns


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
    """Tracks of the tracker under test, from every broker of the session."""
    async with contextlib.AsyncExitStack() as hearing:
        topic, (addresses, _) = scene.page.tracks_topic, brokers
        if topic is not None:
            for address in addresses:
                tracks = hearing_tracks(view, scene, address, topic, now_utc_ns, shown=shown)
                await hearing.enter_async_context(tracks)
        yield
