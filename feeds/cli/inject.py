"""A recorded flight, or what a live source says, published over MQTT as telemetry."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from plotfeed.feeds.cli.options import InjectSettings, table_of
from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.option_fields import keys_given
from plotfeed.feeds.console.printed import say, show_last_status, show_status
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.engine.visibility import (
    HINDRANCES,
    LIMITS,
    Hindrance,
    cover_of,
    outside,
    shown_m,
)
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import publish
from plotfeed.feeds.scene.drones import FlightFile
from plotfeed.feeds.scene.fields import Height, Positive
from plotfeed.feeds.scene.telemetry_keys import FlownSpeed, TelemetrySource, Undulation
from plotfeed.feeds.session.loop import first_of
from plotfeed.feeds.telemetry.admission import MAX_SPEED_M_S
from plotfeed.feeds.telemetry.flights import read, smoothed
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions
from plotfeed.feeds.telemetry.flights.table import REFERENCE_WORDS
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.live_source import LiveSource
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.models.frames import LocalFrame, distance_m, geodetic_to_ecef
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc

log = logging.getLogger(__name__)

ANSWER_S = 1.0  # For what is retained to come after a subscription
STATUS_S = 6.0  # For the next status to come: a session says one every 5 s
MOST_REFUSALS_KEPT = 1000
MOST_SENSORS = 10_000
NEEDED = ("latitude_deg", "longitude_deg", "height_m", "range_max_m")  # Of a sensor's description


class SessionAnswers:
    """Hears a session on its prefix: that it runs, where its sensors stand, whom it refuses."""

    def __init__(self, prefix: str, drone: str) -> None:
        self._prefix, self._drone = prefix, drone
        self.topics = [f"{prefix}/{end}" for end in ("errors", "session", "fleet/+/session")]
        self.topics += [f"{prefix}/+/description", f"{prefix}/+/status"]
        self.refused = 0  # Reports of the drone of which the session has said that it refused them
        self.details: list[str] = []  # Why, of the first of them
        # Sessions that say so, by their topics: one, or those of the parts of a fleet.
        self._running: dict[str, dict[str, Any]] = {}
        self._sensors: dict[str, dict[str, Any]] = {}
        self._refused_by: Counter[str] | None = None
        self._before: Counter[str] | None = None
        self._statuses = 0
        self._news = asyncio.Event()

    def hear(self, topic: str, payload: bytes, _content_type: str | None) -> None:
        """Take what came on one of the topics; what no session would say is nothing."""
        kind = topic.rpartition("/")[2]
        self._news.set()
        try:
            told = json.loads(payload)
            if kind == "errors":
                if told.get("drone") == self._drone:
                    self.refused += 1
                    if len(self.details) < MOST_REFUSALS_KEPT:
                        self.details.append(str(told.get("detail")))
            elif kind == "session":
                self._running.pop(topic, None)
                if told["state"] == "RUNNING" and len(self._running) < MOST_SENSORS:
                    self._running[topic] = {
                        "scene": str(told["scene"]),
                        "sensors": frozenset(map(str, told["sensors"])),
                    }
            elif kind == "description" and len(self._sensors) < MOST_SENSORS:
                names = (*NEEDED, *(name for name in LIMITS if name in told))
                self._sensors[str(told["sensor"])] = {name: float(told[name]) for name in names}
            elif kind == "status":
                counts = told.get("refused_by_reason", {})
                self._refused_by = Counter({str(why): int(n) for why, n in counts.items()})
                self._statuses += 1
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            log.warning("%s: something came that no session says", topic)

    @property
    def scene(self) -> str | None:
        """The name of the scene that a session runs; None while none is heard."""
        return next((each["scene"] for each in self._running.values()), None)

    async def begin(self) -> None:
        """Wait a moment for what is retained, and note what was refused before.

        What is retained may be some seconds old: where anything was refused, the next one is heard.
        """
        running, known = self._running, self._sensors.keys()
        await self._news_until(
            ANSWER_S,
            lambda: bool(running) and all(known >= each["sensors"] for each in running.values()),
        )
        if self._refused_by:
            await self._next_status()
        self._before = self._refused_by

    async def end(self) -> None:
        """Wait for what the session says of the last reports, if one runs: its next status."""
        if self.scene is None:
            return
        await self._next_status()
        await asyncio.sleep(0.2)  # for errors, which may come behind it

    async def _next_status(self) -> None:
        known = self._statuses
        await self._news_until(STATUS_S, lambda: self._statuses > known or self.scene is None)

    async def _news_until(self, most_s: float, is_so: Callable[[], bool]) -> None:
        """Wait until that is so, but not for longer."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(most_s):
                while not is_so():
                    self._news.clear()
                    await self._news.wait()

    @property
    def refused_meanwhile(self) -> Counter[str]:
        """How many messages the session has refused since the beginning, for what, of whoever."""
        return (self._refused_by or Counter()) - (self._before or Counter())

    def nearest(
        self, reports: Sequence[PositionReport]
    ) -> tuple[str, float, float, Hindrance | None] | None:
        """The sensor that comes nearest to seeing a flight, how near that comes, how far it sees.

        With them, metres, what keeps the flight out of its cover, if anything does. Of sensors that
        it comes into the cover of, the one whose range it enters deepest; None if no sensor has
        said where it is. Heights of unknown reference are taken as they are.
        """
        best: tuple[Hindrance, str, float, float, Hindrance | None] | None = None
        places = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in reports])
        above = [r.altitude_reference is AltitudeReference.ABOVE_TAKEOFF for r in reports]
        for name, told in self._sensors.items():
            frame = LocalFrame(told["latitude_deg"], told["longitude_deg"], told["height_m"])
            latitude_deg, longitude_deg, altitude_m = places.T
            altitude_m = altitude_m + np.where(above, frame.height_m, 0.0)
            place_m = frame.from_ecef(geodetic_to_ecef(latitude_deg, longitude_deg, altitude_m))
            cover = cover_of(told)
            near_m, sees_m = float(distance_m(place_m).min()), cover.range_max_m
            hindrance = outside(cover, place_m)
            order = hindrance or Hindrance(len(HINDRANCES), sees_m - near_m, "")
            if best is None or order > best[0]:
                best = order, name, near_m, sees_m, hindrance
        return None if best is None else best[1:]


# Times as fast as it was flown: beyond it, reports would fall on the same nanosecond.
MAX_SPEED = 1000.0
CONNECT_S = 5.0
MOST_SKIPPED_TOLD, MOST_REFUSALS_TOLD = 5, 5


class InjectedFlight(FlightFile):
    """A file that is published, and what the session is told that the file does not say."""

    max_speed_m_s: FlownSpeed = MAX_SPEED_M_S
    rcs_m2: Positive | None = None


class InjectedSource(TelemetrySource):
    """A source whose reports are published, and what the session is told beside them."""

    takeoff_height_m: Height | None = None
    geoid_undulation_m: Undulation | None = None


T = TypeVar("T", InjectedFlight, InjectedSource)


def keys_of(kind: type[T], settings: InjectSettings, **stated: Any) -> T:
    """What `--set` says of what is published, beside what is `stated`; raises `PlotfeedError`."""
    named = {"url": str(stated.get("url")), "drone": "--drone"}
    tree = keys_given("--set", settings.changes) | stated
    return table_of(kind, tree, lambda key: named.get(key, f"--set {key}"))


def completed(keys: InjectedFlight | InjectedSource, report: PositionReport) -> PositionReport:
    """The report with what only the user knows: height above the ellipsoid, metres, and RCS."""
    if keys.rcs_m2 is not None:
        report = report._replace(rcs_m2=keys.rcs_m2)
    declared = {
        AltitudeReference.ABOVE_TAKEOFF: keys.takeoff_height_m,
        AltitudeReference.MEAN_SEA_LEVEL: keys.geoid_undulation_m,
    }
    above_m = declared.get(report.altitude_reference)
    if above_m is None:
        return report
    height_m = report.altitude_m + above_m
    return report._replace(altitude_m=height_m, altitude_reference=AltitudeReference.ELLIPSOID)


def publish_flight(path: Path, settings: InjectSettings, broker: BrokerAddress) -> int:
    """Publish the flight in a file at its own tempo; the exit code. Raises `PlotfeedError`."""
    keys = keys_of(InjectedFlight, settings, file=str(path))
    recorded = read(path, keys.made(FlightOptions, start_utc_ns=time.time_ns()))
    skipped = recorded.skipped[:MOST_SKIPPED_TOLD]
    if more := len(recorded.skipped) - len(skipped):
        skipped = (*skipped, f"and {more} more records skipped")
    for line in (*recorded.assumed, *skipped):
        say(f"plotfeed: {path}: {line}", err=True)
    flight = recorded if settings.raw else smoothed(recorded)
    duration_s = flight.duration_s / settings.speed
    say(f"{path}: {len(flight.reports)} reports, {duration_s:.0f} s to fly")
    for line in summary_lines(recorded):
        say(f"  {line}")
    return asyncio.run(_Injection(flight, keys, settings, broker).run())


def retimed(
    flight: Flight, *, speed: float = 1.0, start_utc_ns: int | None = None
) -> Iterator[PositionReport]:
    """Each report with the time at which it is due.

    The flight starts at `start_utc_ns`, or when it was flown. At speed 2 reports follow each
    other in half the time and their velocities are doubled, so that positions, times and
    velocities agree for whoever tracks them.
    """
    if not 0 < speed <= MAX_SPEED:
        raise PlotfeedError(f"speed is {speed:g}; expected more than 0 and at most {MAX_SPEED:g}")
    recorded_start_ns = flight.reports[0].t_utc_ns
    start_ns = recorded_start_ns if start_utc_ns is None else start_utc_ns

    def at_speed(report: PositionReport) -> PositionReport:
        since_ns = report.t_utc_ns - recorded_start_ns
        if speed == 1:
            return report._replace(t_utc_ns=start_ns + since_ns)
        east, north, up = report.velocity_enu_m_s
        return report._replace(
            t_utc_ns=start_ns + round(since_ns / speed),
            velocity_enu_m_s=(east * speed, north * speed, up * speed),
            velocity_accuracy_m_s=report.velocity_accuracy_m_s * speed,
        )

    return map(at_speed, flight.reports)


class _ToSession:
    """Reports on their way to a broker and its session, and what becomes of them."""

    def __init__(
        self,
        keys: InjectedFlight | InjectedSource,
        settings: InjectSettings,
        broker: BrokerAddress,
        drone: str = "",
    ) -> None:
        """`drone` is whose refusals are told of, one by one."""
        self._keys, self._settings = keys, settings
        self._encode, self._content_type = PositionReport.to_protobuf, PROTOBUF
        if settings.encoding == "json":
            self._encode, self._content_type = PositionReport.to_json, JSON
        self._answers = answers = SessionAnswers(settings.prefix, drone)
        self._link = MqttTransport(
            broker, "plotfeed-inject", subscribe=answers.topics, on_message=answers.hear
        )
        self._sent = self._undelivered = 0

    def _send(self, drone: str, report: PositionReport) -> None:
        message = Message(
            topic=f"{self._settings.prefix}/telemetry/{drone}",
            payload=self._encode(completed(self._keys, report)),
            content_type=self._content_type,
            due_utc_ns=report.t_utc_ns,
        )
        publish([self._link], [message], self)

    def _tell_meanwhile(self) -> int:
        """Say what the session has refused since the beginning, of whoever; how much."""
        meanwhile = self._answers.refused_meanwhile
        if meanwhile:
            reasons = ", ".join(f"{why} {n}" for why, n in meanwhile.most_common())
            say(f"plotfeed: meanwhile the session refused, of all that came: {reasons}", err=True)
        return meanwhile.total()

    def now_ns(self) -> int:
        """The time at which a report leaves, UTC."""
        return time.time_ns()

    def settled(self, one: Message) -> None:
        """Count what became of a report."""
        self._sent += one.delivered
        self._undelivered += not one.delivered


class _Injection(_ToSession):
    """A flight on its way to a broker, and what becomes of its reports."""

    def __init__(
        self, flight: Flight, keys: InjectedFlight, settings: InjectSettings, broker: BrokerAddress
    ) -> None:
        drone = settings.drone or re.sub(r"[\s/+#]", "-", flight.name)
        super().__init__(keys, settings, broker, drone)
        self._flight, self._drone, self._broker = flight, drone, broker
        if not (1 <= len(drone) <= 64 and drone.isprintable()) or set("/+#") & set(drone):
            raise PlotfeedError(
                f"--drone: {drone!a} is no name, the last level of a topic: expected 1 to 64 "
                "printable characters without /, + and #"
            )

    async def run(self) -> int:
        """Connect, send each report when it is due, and pass on what is said of them."""
        topic, answers = f"{self._settings.prefix}/telemetry/{self._drone}", self._answers
        if not topic.isprintable() or "+" in topic or "#" in topic:
            raise PlotfeedError(f"topic {topic!a}: expected printable characters without + and #")
        async with self._link.connected(CONNECT_S):
            await answers.begin()
            is_seen = self._tell_distance()
            await self._send_all()
            await self._link.drain()
            await answers.end()
        for line in answers.details[:MOST_REFUSALS_TOLD]:
            say(f"plotfeed: refused: {line}", err=True)
        say(
            f"{self._sent} reports sent to {self._broker} as {topic}, "
            f"{self._undelivered} undelivered, {answers.refused} refused"
        )
        if answers.scene is None:
            say("plotfeed: no session was there to take them in", err=True)
            return FAILED
        all_refused = self._tell_meanwhile() >= self._sent > 0
        is_taken_in = not (self._undelivered or answers.refused or all_refused)
        return 0 if is_taken_in and is_seen else FAILED

    def _tell_distance(self) -> bool:
        """Say how near the flight comes to a sensor; whether any can see it, as far as is known."""
        prefix, scene = self._settings.prefix, self._answers.scene
        if scene is None:
            text = (
                f"no session says on {prefix}/session that it runs: is it another broker or prefix?"
            )
            say(f"plotfeed: {text}", err=True)
            return True
        found = self._answers.nearest(self._flight.reports)
        if found is None:
            return True
        sensor, near_m, sees_m, hindrance = found
        if hindrance is None:
            far = f"{shown_m(near_m)} from {sensor}, which sees to {shown_m(sees_m)}"
            say(f"session of {scene}: the flight comes to {far}")
            return True
        why = f"by {sensor} at best: {hindrance.kind}: {hindrance.text}"
        say(f"plotfeed: no sensor can see the flight, {why}", err=True)
        return False

    async def _send_all(self) -> None:
        settings, clock = self._settings, None
        start_utc_ns = time.time_ns() if settings.shift else None
        try:
            for report in retimed(self._flight, speed=settings.speed, start_utc_ns=start_utc_ns):
                clock = clock or WallClock(report.t_utc_ns)
                await clock.sleep_until(report.t_utc_ns)
                self._send(self._drone, report)
        finally:
            if clock is not None:
                clock.close()


# A silence is a gap if it is longer than this, and than so many times the usual interval.
GAP_S, GAP_FACTOR = 5.0, 3.0
MOST_REASONS = 4


def summary_lines(flight: Flight) -> Iterator[str]:
    """The summary of a flight as it was recorded, a line for each thing."""
    reports = flight.reports
    first = reports[0]
    rows = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in reports])
    places_m: Floats = geodetic_to_ecef(*rows.T)
    length_km = float(np.linalg.norm(np.diff(places_m, axis=0), axis=1).sum()) / 1000
    away_km = float(np.linalg.norm(places_m - places_m[0], axis=1).max()) / 1000
    yield (
        f"path       {length_km:.3g} km, up to {away_km:.3g} km from {first.latitude_deg:.5f}, "
        f"{first.longitude_deg:.5f}, where it begins at {iso_utc(first.t_utc_ns)[:19]}Z"
    )
    heights_m = [report.altitude_m for report in reports]
    above = " and ".join(
        dict.fromkeys(REFERENCE_WORDS[report.altitude_reference] for report in reports)
    )
    yield f"heights    {min(heights_m):.1f} to {max(heights_m):.1f} m {above}"
    for stated in flight.stated:
        yield f"read as    {stated}"
    yield f"rate       {_rate(reports)}"
    if dropped := sum(flight.dropped.values()):
        most = Counter(flight.dropped).most_common(MOST_REASONS)
        told = ", ".join(f"{why} {n}" for why, n in most)
        told += ", and others" if len(flight.dropped) > len(most) else ""
        yield f"dropped    {dropped} of {dropped + len(reports)} records: {told}"


def _rate(reports: Sequence[PositionReport]) -> str:
    """How often it reports as a rule, and where it does not."""
    intervals_s = np.diff([report.t_utc_ns for report in reports]) / NS
    if not len(intervals_s):
        return "one report"
    usual_s = float(np.median(intervals_s))
    gaps_s = intervals_s[intervals_s > max(GAP_S, GAP_FACTOR * usual_s)]
    text = f"{1 / usual_s:.3g} Hz" if usual_s <= 1 else f"one each {usual_s:.3g} s"
    if not len(gaps_s):
        return f"{text}, without gaps"
    number = f"{len(gaps_s)} gaps" if len(gaps_s) > 1 else "1 gap"
    return f"{text}, {number}, the longest {gaps_s.max():.3g} s, not bridged"


MAX_DRONES_TOLD = 5
MAX_DRONES = 10_000  # That are told apart in the counts


def publish_source(url: str, settings: InjectSettings, broker: BrokerAddress) -> int:
    """Listen and publish; the exit code. Raises `PlotfeedError`."""
    if settings.speed != 1 or settings.shift or settings.raw:
        raise PlotfeedError(f"{url}: --speed, --now and --raw are for files")
    source = keys_of(InjectedSource, settings, url=url, drone=settings.drone)
    return asyncio.run(_Relay(source, settings, broker).run(settings.duration))


class _Relay(_ToSession):
    """Reports on their way from a source to a broker, and what becomes of them."""

    def __init__(
        self, source: InjectedSource, settings: InjectSettings, broker: BrokerAddress
    ) -> None:
        super().__init__(source, settings, broker)
        self._template = source.template
        self._source = LiveSource(
            source, now_utc_ns=time.time_ns, take=self._take, refuse=self._refuse
        )
        self._drones: dict[str, None] = {}
        self._refused: Counter[str] = Counter()
        self._details: dict[str, str] = {}

    async def run(self, duration_s: float | None) -> int:
        """Listen until the end of the source or of the time, or until stopped."""
        stop = asyncio.Event()
        async with contextlib.AsyncExitStack() as opened:
            opened.callback(self._source.close)
            await self._source.open()
            await opened.enter_async_context(self._link.connected(CONNECT_S))
            signals = opened.enter_context(stopped_by_signals(stop.set))
            await self._answers.begin()
            if self._answers.scene is None:
                prefix = self._settings.prefix
                say(f"plotfeed: no session says on {prefix}/session that it runs", err=True)
            say(f"listens to {self._source.name}, drones are {self._template}; stop: Ctrl-C")
            status = asyncio.create_task(show_status(self._line), name="status")
            try:
                await first_of(self._source.run(), stop.wait(), within_s=duration_s)
            finally:
                status.cancel()
                await asyncio.gather(status, return_exceptions=True)
            self._source.close()  # what came from now on would find the link at its end
            await self._link.drain()
            await self._answers.end()
        self._conclude()
        if signal.SIGINT in signals:
            return INTERRUPTED
        return FAILED if self._undelivered or not self._sent else 0

    def _line(self) -> str:
        return (
            f"drones {len(self._drones)}  reports {self._sent}  "
            f"not taken {self._refused.total()}  undelivered {self._undelivered}"
        )

    def _conclude(self) -> None:
        show_last_status(self._line())
        told = ", ".join(list(self._drones)[:MAX_DRONES_TOLD])
        more = len(self._drones) - MAX_DRONES_TOLD
        say(f"drones: {told or 'none'}{f' and {more} more' if more > 0 else ''}")
        for reason, number in self._refused.most_common(MOST_REFUSALS_TOLD):
            say(f"plotfeed: not taken: {reason} {number}: {self._details[reason]}", err=True)
        self._tell_meanwhile()

    def _take(self, drone: str, report: PositionReport) -> None:
        if len(self._drones) < MAX_DRONES:
            self._drones[drone] = None
        self._send(drone, report)

    def _refuse(self, drone: str, refused: Refused) -> None:
        self._refused[refused.reason] += refused.count
        whose = f"{drone}: " if drone else ""
        self._details.setdefault(refused.reason, whose + refused.detail)
