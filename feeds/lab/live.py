"""Scores a session and its feeds while it runs, and publishes the score every second."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.engine.simulation import (
    SimulatedLooks,
    SimulatedPlots,
    SimulatedSensor,
    of_sectors,
)
from plotfeed.feeds.formats import carries_plots
from plotfeed.feeds.formats.told_tracks import ToldTrack, tracks_in
from plotfeed.feeds.lab.scoring import ScoreSettings
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.brokers import Brokers, brokers_of
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.state import OTHER, Floats
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc

if TYPE_CHECKING:
    from plotfeed.models.residuals import Check

# What judges is loaded a second after a session has begun, which does not wait for it.

WINDOW_S = 60  # Over which means are told; a score is worked out every second
SEEN_NS = 10 * NS  # A drone that no sensor has looked at for so long is not missed
MOST_TRACKS = 5000
MOST_LATENCIES = 2000
MOST_SENSORS = 16  # Whose feeds are checked
# After which checks of a feed begin anew; each block is called wrong at `FALSE_RATE` at most.
BLOCK_NS = 600 * NS
MOST_LOOKS = 20_000  # Of one sensor in a block; what comes then is left out
EVERY_SECONDS = 5  # Feeds are checked


class _LastReport(NamedTuple):
    """The last report of a track."""

    t_utc_ns: int
    place_m: Floats
    velocity_m_s: Floats


class LiveScore(Observer):
    """Follows a session and takes what its tracker publishes; `score` says how both do."""

    def __init__(self) -> None:
        self._settings = ScoreSettings()
        self._session: RunningSession | None = None
        self._forget()

    def _forget(self) -> None:
        self._tracks: dict[str, _LastReport] = {}
        self._looked_ns: dict[int, int] = {}
        self._latencies_s: deque[tuple[int, float]] = deque(maxlen=MOST_LATENCIES)
        self._window: deque[dict[str, float]] = deque(maxlen=WINDOW_S)
        self._unreadable = self._reports = self._seconds = 0
        self._problem = ""
        self._feeds: dict[str, _FeedSoFar] = {}
        self._checked: dict[str, Sequence[Check]] = {}

    # What the session tells.

    def begun(self, session: RunningSession) -> None:
        """Begin anew with it."""
        self._forget()
        self._session = session
        self._site = site_frame(session.scene.scene.site)

    def ended(self) -> None:
        """There is nothing more to score."""
        self._session = None

    def settled(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """Keep whom a sensor looked at, and of what was delivered the plots."""
        session = self._session
        if session is None or batch.sensor not in session.sensors:
            return
        for drone in np.unique(batch.looks.drone).tolist():
            self._looked_ns[drone] = batch.due_utc_ns
        carriers = [message for message in sent if carries_plots(message.topic)]
        if any(not message.delivered for message in carriers):
            return
        feed = self._feeds.get(batch.sensor)
        if feed is None:
            if len(self._feeds) >= MOST_SENSORS:
                return
            feed = self._feeds[batch.sensor] = _FeedSoFar(since_ns=0)
        feed.take(batch)

    def settings(self, sensor: Sensor) -> None:
        """What a sensor's feed said by other keys counts no more."""
        if self._session is not None and sensor.id in self._feeds:
            self._feeds[sensor.id] = _FeedSoFar(since_ns=self._session.clock.now_ns())
            self._checked.pop(sensor.id, None)

    # What the tracker tells.

    def tracked(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:  # noqa: ARG002
        """Take a message of the tracker's; what cannot be read is counted."""
        if self._session is None:
            return
        try:
            told = tracks_in(payload, content_type or "", t_utc_ns, self._site, self._refuse)
        except PlotfeedError as error:
            self._refuse(str(error))
            return
        for each in told[:MOST_TRACKS]:
            self._hear(each, t_utc_ns)

    def _refuse(self, reason: str) -> None:
        self._unreadable += 1
        self._problem = reason

    def _hear(self, told: ToldTrack, received_utc_ns: int) -> None:
        t_utc_ns = received_utc_ns if told.t_utc_ns is None else told.t_utc_ns
        late_s = (received_utc_ns - t_utc_ns) / NS
        height_m = self._site.height_m if np.isnan(told.height_m) else told.height_m
        is_place = abs(told.latitude_deg) <= 90 and abs(told.longitude_deg) <= 360
        if not is_place or not np.isfinite(height_m) or late_s < -self._settings.future_s:
            is_place = is_place and bool(np.isfinite(height_m))
            self._refuse("a track of the future" if is_place else "a track nowhere")
            return
        self._reports += 1
        self._latencies_s.append((received_utc_ns, late_s))
        if told.ended or (told.tentative and not self._settings.counts_tentative):
            self._tracks.pop(told.name, None)
            return
        before = self._tracks.get(told.name)
        if before is not None and before.t_utc_ns > t_utc_ns:
            return
        if before is None and len(self._tracks) >= MOST_TRACKS:
            return
        place = geodetic_to_ecef(told.latitude_deg, told.longitude_deg, height_m)
        velocity = np.nan_to_num(np.array(told.velocity_enu_m_s[:2], np.float64))
        self._tracks[told.name] = _LastReport(t_utc_ns, self._site.from_ecef(place)[:2], velocity)

    # What is asked.

    def score(self, now_utc_ns: int) -> dict[str, Any] | None:
        """The score as of now; None where nothing runs. To be asked once a second."""
        from plotfeed.feeds.lab.judge import FALSE_RATES, check_json
        from plotfeed.models.residuals import always_valid

        session = self._session
        if session is None:
            return None
        now, drones, tracks = self._figures(session, now_utc_ns)
        self._window.append(now)
        there = {name: [s[name] for s in self._window if np.isfinite(s[name])] for name in now}
        self._seconds += 1
        if self._seconds % EVERY_SECONDS == 0:
            self._check_feeds(session, now_utc_ns)
        rate, checks = FALSE_RATES["claimed"], []
        count = sum(map(len, self._checked.values()))
        for sensor, found in self._checked.items():
            for each in found:
                wrong = always_valid(each, rate / count)
                told = replace(each, sensor=sensor, wrong=wrong)
                checks.append(check_json(told, "claimed"))
        values: dict[str, Any] = finite(
            {
                "time_utc": iso_utc(now_utc_ns),
                "tracks_topic": session.scene.page.tracks_topic,
                "cutoff_m": self._settings.cutoff_m,
                "dimensions": 2,
                "drones": drones,
                "tracks": tracks,
                "reports": self._reports,
                "unreadable": self._unreadable,
                "problem": self._problem or ("" if self._reports else "no tracks have come"),
                "now": now,
                "window_s": len(self._window),
                "window": {n: float(np.mean(of)) if of else None for n, of in there.items()},
                "feed_false_rate": rate,
                "feed": checks,
            }
        )
        return values

    def _figures(self, session: RunningSession, now_ns: int) -> tuple[dict[str, float], int, int]:
        settings = self._settings
        state, names = session.trajectories.state_at(now_ns), session.trajectories.names
        recent = [
            OTHER not in names[d] and now_ns - self._looked_ns.get(d, 0) <= SEEN_NS
            for d in state.drone.tolist()
        ]
        truth_m = self._site.from_ecef(state.position_ecef_m[np.array(recent, np.bool_)])[:, :2]
        oldest_ns = now_ns - round(settings.stale_s * NS)
        self._tracks = {n: t for n, t in self._tracks.items() if t.t_utc_ns >= oldest_ns}
        places = [
            each.place_m + each.velocity_m_s * ((now_ns - each.t_utc_ns) / NS)
            for each in self._tracks.values()
        ]
        tracks_m = np.array(places, np.float64).reshape(-1, 2)
        far_m = np.linalg.norm(truth_m[:, None] - tracks_m[None], axis=2)
        from plotfeed.models.track_metrics import set_score

        found = set_score(far_m, settings.cutoff_m, settings.order)
        paired, m, n = len(found.rows), len(truth_m), len(tracks_m)
        errors_m = far_m[found.rows, found.columns]
        since_ns = now_ns - WINDOW_S * NS
        while self._latencies_s and self._latencies_s[0][0] < since_ns:
            self._latencies_s.popleft()
        late_s = np.array([late for _, late in self._latencies_s])
        figures = {
            "gospa_m": found.gospa_m(settings.order),
            "ospa_m": found.ospa_m,
            "completeness": paired / m if m else np.nan,
            "spuriousness": (n - paired) / n if n else np.nan,
            "position_error_m": float(np.sqrt(np.mean(errors_m**2))) if paired else np.nan,
            "latency_s": float(np.median(late_s)) if len(late_s) else np.nan,
            "latency_p95_s": float(np.quantile(late_s, 0.95)) if len(late_s) else np.nan,
        }
        if not self._reports:  # of a tracker that nobody has heard there is no figure
            figures = dict.fromkeys(figures, np.nan)
        return figures, m, n

    def _check_feeds(self, session: RunningSession, now_ns: int) -> None:
        """Check those of which there is news."""
        from plotfeed.feeds.lab.judge import FeedTally, simulated_feed

        for name, feed in self._feeds.items():
            if feed.began_ns is not None and now_ns - feed.began_ns > BLOCK_NS:
                self._feeds[name] = _FeedSoFar(since_ns=0)
            elif feed.is_news:
                seen, tally = feed.seen(session.sensors[name].sensor), FeedTally("claimed")
                seen = replace(seen, drones=session.trajectories.names)
                tally.take(simulated_feed(session.scene, seen, feed.sectors))
                self._checked[name] = tally.checks()


class _FeedSoFar:
    """What came of one sensor since a block began."""

    def __init__(self, *, since_ns: int) -> None:
        """Sectors that were worked out before are not of it."""
        self.is_news = False
        self.began_ns: int | None = None  # When the first of its sectors was due
        self.sectors = 0  # That were taken, empty ones too
        self._since_ns = since_ns
        self._looks: list[SimulatedLooks] = []
        self._plots: list[SimulatedPlots] = []
        self._count = 0

    def take(self, batch: Batch) -> None:
        """Take a sector whose plots were delivered."""
        of = batch.sector
        if self._count >= MOST_LOOKS or max(of.end_ns - AHEAD_NS, of.start_ns) < self._since_ns:
            return
        if self.began_ns is None:
            self.began_ns = batch.due_utc_ns
        looks, plots, sectors = batch.looks, batch.plots, batch.sectors
        self._looks.append(of_sectors(SimulatedLooks, looks, batch.looks_by, sectors))
        self._plots.append(of_sectors(SimulatedPlots, plots, batch.plots_by, sectors))
        self.sectors += 1
        self._count += len(looks) + len(plots)
        self.is_news = True

    def seen(self, sensor: Any) -> SimulatedSensor:
        """All of it."""
        self.is_news = False
        self._looks = [SimulatedLooks.joined(self._looks)]
        self._plots = [SimulatedPlots.joined(self._plots)]
        return SimulatedSensor(sensor=sensor, looks=self._looks[0], plots=self._plots[0])


EVERY_S = 1.0
TOPIC = "score"  # Behind the prefix; no sensor may have that name, since it is one level
OnScore = Callable[[dict[str, Any]], None]


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
    """Score a session meanwhile, if it has a broker that a tracker under test may publish at.

    The score is published with the truth, and where that is not, only `on_score` is told.
    """
    addresses, _ = brokers
    if not addresses:
        yield
        return
    links = [MqttTransport(each, "plotfeed-score") for each in addresses if scene.mqtt.truth]
    outbox = Outbox(clock, links)

    async def tell() -> None:
        number = 0
        await asyncio.sleep(EVERY_S)
        for name in ("plotfeed.feeds.lab.judge", "scipy.optimize"):  # longer than a tick may be
            await asyncio.to_thread(import_module, name)
        while True:
            await asyncio.sleep(EVERY_S)
            now_ns = now_utc_ns()
            found = live.score(now_ns)
            if found is None:
                continue
            number += 1
            if on_score is not None:
                on_score(found)
            prefix = scene.mqtt.prefix
            message = Message(
                topic=f"{prefix}/{TOPIC}",
                payload=json.dumps(found).encode(),
                content_type=JSON,
                due_utc_ns=now_ns,
                properties=attributes(prefix, TOPIC, str(number), now_ns),
            )
            outbox.send_past_link(message)

    working = *(link.run() for link in links), tell()
    tasks = [asyncio.create_task(work, name="score") for work in working]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


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
