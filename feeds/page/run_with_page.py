"""Sessions and replays one after the other, with one page beside them that follows and controls."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.change_control import told
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.scene_outline import Basemap, connections, load_basemap, pointing_of
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.session_switch import SessionSwitch
from plotfeed.feeds.page.shown import tracks_to_show
from plotfeed.feeds.page.updates import Controls, NoControls
from plotfeed.feeds.page.view import MAX_REASON, View, model_differs, tell_settings
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock, WallClock
from plotfeed.feeds.transport.brokers import Brokers, brokers_of
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.page.recorded_sectors import RecordedSession

MAX_MARKS = 100  # The newest are kept
TRUTH_EVERY_S = 0.1
# Commands that the session itself takes.
OF_SESSION = frozenset({"sensor", "clock", "story", "undo"})
CLOCK_CONTROLS = ("pause", "step", "speed")
REAL_TIME = "Pause, step and speed need a simulated clock: real time cannot be held or hurried."
NO_PACE = "A run as fast as possible has no pace to control."


class PageObserver(Observer):
    """Follows one session after the other, tells what changes when, and controls what runs."""

    def __init__(self, view: View, others: Controls | None = None) -> None:
        """`others` take commands that are not for a session's sensor or clock."""
        self._view = view
        self._others = others or NoControls()
        self._session: RunningSession | None = None
        self._basemap: Basemap | None = None
        self._before: tuple[Sensor, ...] = ()
        self._refusal = ""
        self._now_ns = 0
        self._marks: deque[dict[str, Any]] = deque(maxlen=MAX_MARKS)
        # Sensors that are otherwise, and since when, of which no command has told yet.
        self._unexplained: dict[str, int] = {}
        self._would_undo = ""

    def scene(self, basemap: Basemap | None) -> None:
        """The next session has that basemap."""
        self._basemap = basemap

    # What the session tells.

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""
        self._session = session
        self._refusal = ""
        self._view.scene(session.scene, self._basemap)
        self._view.unseen(session.totals.unseen)
        self._before = tuple(task.sensor for task in session.sensors.values())
        for sensor in self._before:
            self._tell_settings(sensor, new_model=True)
        self._marks.clear()
        self._unexplained.clear()
        self._tell_stories(session)
        self._tell_clock()

    def ended(self) -> None:
        """The session is over; the page shows what there was."""
        self._now_ns = self.now_utc_ns()
        self._session = None

    def settled(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """A sector's messages have their fates."""
        self._view.settled(batch, sent)

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""
        before = next((s for s in self._before if s.id == sensor.id), None)
        self._before = tuple(sensor if s.id == sensor.id else s for s in self._before)
        self._unexplained[sensor.id] = self.now_utc_ns()
        self._tell_settings(sensor, new_model=before is None or model_differs(before, sensor))

    def obeyed(self, command: Command, t_utc_ns: int) -> None:
        """What a command asked for is in force."""
        if self._session is not None and command.clock is None:
            kind = "change" if command.story is None else "story"
            self._mark(kind, self._words(self._session, command), t_utc_ns)
            self._unexplained.clear()
            self._tell_stories(self._session)

    # What the page asks.

    def now_utc_ns(self) -> int:
        """The session's time; the last one when none runs."""
        return self._now_ns if self._session is None else self._session.clock.now_ns()

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do as a viewer asks."""
        if self._session is None or command.keys().isdisjoint(OF_SESSION):
            return await self._others.apply(command)
        in_force = self._session.command(command)
        self._tell_clock()
        return in_force

    async def follow(self) -> None:
        """Tell the view what changes without anybody saying so, until cancelled."""
        while True:
            await asyncio.sleep(TRUTH_EVERY_S)
            if self._session is not None:
                self._look_at(self._session)

    def _look_at(self, session: RunningSession) -> None:
        now_ns = session.clock.now_ns()
        trajectories = session.trajectories
        state, classes = trajectories.state_at(now_ns), trajectories.signatures.target_class
        self._view.truth(now_ns, state, trajectories.names, classes)
        self._view.totals(session.totals)
        for sensor, at_utc_ns in self._unexplained.items():  # or by a task of SAPIENT
            self._mark("script", f"{sensor}: by its script", at_utc_ns)
        if self._unexplained:
            self._unexplained.clear()
            self._tell_stories(session)
        self._view.pointing(
            {
                name: pointing_of(task.sensor, pointed)
                for name, task in session.sensors.items()
                if (pointed := task.pointed) is not None
            }
        )
        if session.totals.last_refusal != self._refusal:
            self._refusal = session.totals.last_refusal
            self._view.tell(refusal=self._refusal[:MAX_REASON])
        self._tell_clock()

    def _tell_clock(self) -> None:
        """The clock's state, which control may have changed from elsewhere, for what is news."""
        if self._session is None:
            return
        clock, state = self._session.clock, {"kind": "instant", "paused": False, "speed": 1.0}
        refusals = dict.fromkeys(CLOCK_CONTROLS, NO_PACE)
        if isinstance(clock, WallClock):
            kind = "wall" if clock.is_real else "simulated"
            state = {"kind": kind, "paused": clock.is_paused, "speed": clock.speed}
            refusals = dict.fromkeys(CLOCK_CONTROLS, REAL_TIME) if clock.is_real else {}
        self._view.session({"clock": state, "refuses": refusals})

    def _mark(self, kind: str, words: str, at_utc_ns: int) -> None:
        self._marks.append({"t_utc_ms": at_utc_ns / 1e6, "kind": kind, "words": words})
        self._view.tell(marks=list(self._marks))

    def _words(self, session: RunningSession, command: Command) -> str:
        if command.undo:
            return f"Undone: {self._would_undo}"
        if command.story is not None:
            titles = {story.id: story.title for story, _ in session.changes.stories}
            words = titles.get(command.story) or command.story
            return f"{words}, taken back" if command.reset else words
        if command.drone is not None:
            happens = command.contingency.kind if command.contingency else "claim"
            return f"{command.drone}: {'as in the scene' if command.reset else happens}"
        return f"{command.sensor}: {told(command.set) if command.set else 'as in the scene'}"

    def _tell_stories(self, session: RunningSession) -> None:
        self._would_undo = session.changes.undoes
        stories = [
            {
                "id": story.id,
                "title": story.title or story.id,
                "text": story.text,
                "sensors": list(story.sets),
                "since_utc_ms": None if since_ns is None else since_ns / 1e6,
            }
            for story, since_ns in session.changes.stories
        ]
        self._view.tell(stories=stories, undoes=self._would_undo)

    def _tell_settings(self, sensor: Sensor, *, new_model: bool) -> None:
        tell_settings(self._view, sensor, self.now_utc_ns(), new_model=new_model)


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
    switch = SessionSwitch(scene, view, Path.cwd())
    observer = PageObserver(view, switch)

    def shown_utc_ns() -> int:
        return observer.now_utc_ns() if switch.replaying is None else switch.replaying.now_utc_ns

    async def pass_on() -> None:
        await stop.wait()
        switch.ending.set()

    server = PageServer(address, view, observer, shown_utc_ns, tokens=tokens)
    totals = SessionCounters()

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        on_ready({**urls, **server.urls}, totals)

    try:
        async with (
            alongside(pass_on(), "page-stop"),
            brokers_of(scene, broker) as brokers,
            serving(server),
            alongside(observer.follow(), "page-follow"),
        ):
            while True:
                recording = switch.begin()
                shown = switch.scene if recording is None else recording.scene
                told = connections(shown, brokers[1], sends_udp=recording is None)
                view.tell(connect=told)
                if stop.is_set():
                    switch.ending.set()
                if recording is not None:
                    await _replay(switch, recording, view, brokers)
                else:
                    observer.scene(_basemap_of(switch.scene))
                    now_utc_ns = observer.now_utc_ns
                    async with (
                        tracks_of(switch.scene, view, brokers, now_utc_ns),
                        _scored(switch.scene, view, brokers, now_utc_ns, clock) as scores,
                    ):
                        totals = await run_over(
                            brokers,
                            switch.scene,
                            clock=clock,
                            duration_s=duration_s,
                            stop=switch.ending,
                            observers=[*observers, *scores, observer, switch],
                            on_ready=ready,
                        )
                if stop.is_set() or not switch.goes_on:
                    return totals
                clock = another_clock(switch.scene)
    finally:
        server.close()


async def _replay(
    switch: SessionSwitch, recording: RecordedSession, view: View, brokers: Brokers
) -> None:
    """Replay in place of a session, with the map that is known if the scene is the same."""

    def shown_ns(t_utc_ns: int) -> int:
        return t_utc_ns if switch.replaying is None else switch.replaying.recorded_ns(t_utc_ns)

    basemap = _basemap_of(switch.scene) if recording.scene.text == switch.scene.text else None
    async with tracks_of(recording.scene, view, brokers, time.time_ns, shown_ns):
        await switch.replay(recording, brokers[0], basemap)


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
