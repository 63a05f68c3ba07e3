"""Sessions and replays one after the other, with one page beside them that follows and controls."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.page_sessions import PageSessions
from plotfeed.feeds.page.scene_outline import Basemap, connections, load_basemap
from plotfeed.feeds.page.server import serving
from plotfeed.feeds.page.shown import tracks_to_show
from plotfeed.feeds.page.view import MAX_REASON, View
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.brokers import Brokers, brokers_of
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.page.recorded_sectors import RecordedSession


@contextlib.asynccontextmanager
async def alongside(work: Coroutine[Any, Any, None], name: str) -> AsyncIterator[None]:
    """Do that work for as long as this lasts."""
    task = asyncio.create_task(work, name=name)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


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
    tokens: Tokens = Tokens(),  # noqa: B008 - it does not change
) -> SessionCounters:
    """Sessions and replays, as the page's viewers want it; the totals of the last session.

    `on_ready` is told of each session. Tokens that are not given are drawn where they are needed.
    Raises `PlotfeedError`. The brokers and the page outlast a session.
    """
    view = View()
    sessions = PageSessions(scene, view, Path.cwd())

    async def pass_on() -> None:
        await stop.wait()
        sessions.ending.set()

    totals = SessionCounters()
    async with (
        serving(address, view, sessions, sessions.now_utc_ns, tokens=tokens) as server,
        alongside(pass_on(), "page-stop"),
        brokers_of(scene, broker) as brokers,
        alongside(sessions.follow(), "page-follow"),
    ):

        def ready(urls: dict[str, str], totals: SessionCounters) -> None:
            on_ready({**urls, **server.urls}, totals)

        while True:
            recording = sessions.begin()
            shown = sessions.scene if recording is None else recording.scene
            told = connections(shown, brokers[1], sends_udp=recording is None)
            view.tell(connect=told)
            if stop.is_set():
                sessions.ending.set()
            if recording is not None:
                await _replay(sessions, recording, view, brokers)
            else:
                sessions.basemap = _basemap_of(sessions.scene)
                async with (
                    tracks_of(sessions.scene, view, brokers, sessions.now_utc_ns),
                    _scored(sessions.scene, view, brokers, sessions.now_utc_ns, clock) as scores,
                ):
                    totals = await run_over(
                        brokers,
                        sessions.scene,
                        clock=clock,
                        duration_s=duration_s,
                        stop=sessions.ending,
                        observers=[*observers, *scores, sessions],
                        on_ready=ready,
                    )
            if stop.is_set() or not sessions.goes_on:
                return totals
            clock = another_clock(sessions.scene)


async def _replay(
    sessions: PageSessions, recording: RecordedSession, view: View, brokers: Brokers
) -> None:
    """Replay in place of a session, with the map that is known if the scene is the same."""

    def shown_ns(t_utc_ns: int) -> int:
        return t_utc_ns if (replay := sessions.replaying) is None else replay.recorded_ns(t_utc_ns)

    is_same = recording.scene.text == sessions.scene.text
    basemap = _basemap_of(sessions.scene) if is_same else None
    async with tracks_of(recording.scene, view, brokers, time.time_ns, shown_ns):
        await sessions.replay(recording, brokers[0], basemap)


def _basemap_of(scene: Scene) -> Basemap | None:
    settings = scene.page.basemap
    if settings is None:
        return None
    name = settings if isinstance(settings, str) else settings.image
    return load_basemap(settings, scene.file(name), scene.scene.site)


@contextlib.asynccontextmanager
async def _scored(
    scene: Scene, view: View, brokers: Brokers, now_utc_ns: Callable[[], int], clock: Clock
) -> AsyncIterator[list[Observer]]:
    """Score the tracker under test, if the scene says where one publishes; who follows for it."""
    if scene.page.tracks_topic is None:
        yield []
        return
    from plotfeed.feeds.lab.live import LiveScore, scoring

    live = LiveScore()
    async with scoring(scene, brokers, live, now_utc_ns, clock=clock, on_score=view.score):
        yield [live]


@contextlib.asynccontextmanager
async def tracks_of(
    scene: Scene,
    view: View,
    brokers: Brokers,
    now_utc_ns: Callable[[], int],
    shown_ns: Callable[[int], int] = int,
) -> AsyncIterator[None]:
    """Show tracks of the tracker under test, from every broker of the session.

    What cannot be read is said on the page. `now_utc_ns` is the tracker's time; `shown_ns` of it
    the time that the page shows.
    """
    site, topic = site_frame(scene.scene.site), scene.page.tracks_topic

    def take(_topic: str, payload: bytes, content_type: str | None) -> None:
        try:
            view.tracks(tracks_to_show(payload, content_type, now_utc_ns(), site, shown_ns))
        except PlotfeedError as error:
            view.tell(track_problem=str(error)[:MAX_REASON])

    async with contextlib.AsyncExitStack() as receiving:
        for address in brokers[0] if topic is not None else ():
            link = MqttTransport(address, "plotfeed-page", subscribe=[str(topic)], on_message=take)
            await receiving.enter_async_context(alongside(link.run(), "page-tracks"))
        yield
