"""A recorded flight published over MQTT as live telemetry: when each report is due."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from plotfeed.feeds.cli.flight_summary import summary_lines
from plotfeed.feeds.cli.inject_settings import InjectSettings
from plotfeed.feeds.cli.session_answers import SessionAnswers
from plotfeed.feeds.console import FAILED
from plotfeed.feeds.console.option_fields import keys_given
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.engine.visibility import shown_m
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Outgoing, publish
from plotfeed.feeds.scene.drones import FlightFile
from plotfeed.feeds.scene.fields import Height, Positive
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.scene.telemetry_keys import FlownSpeed, TelemetrySource, Undulation
from plotfeed.feeds.telemetry.admission import MAX_SPEED_M_S
from plotfeed.feeds.telemetry.decode_reports import encode_json, encode_protobuf
from plotfeed.feeds.telemetry.flights import read, smoothed
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.errors import PlotfeedError

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
    tree = keys_given("--set", settings.changes) | stated
    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        key, text = next(iter(problems_of(error, tree)))
        where = {"url": stated.get("url"), "drone": "--drone"}.get(key, f"--set {key}")
        raise PlotfeedError(f"{where}: {text}") from None


def completed(keys: InjectedFlight | InjectedSource, report: PositionReport) -> PositionReport:
    """The report with what only the user knows: height above the ellipsoid, metres, and RCS."""
    if keys.rcs_m2 is not None:
        report = replace(report, rcs_m2=keys.rcs_m2)
    declared = {
        AltitudeReference.ABOVE_TAKEOFF: keys.takeoff_height_m,
        AltitudeReference.MEAN_SEA_LEVEL: keys.geoid_undulation_m,
    }
    above_m = declared.get(report.altitude_reference)
    if above_m is None:
        return report
    height_m = report.altitude_m + above_m
    return replace(report, altitude_m=height_m, altitude_reference=AltitudeReference.ELLIPSOID)


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
            return replace(report, t_utc_ns=start_ns + since_ns)
        velocity, accuracy = report.velocity_enu_m_s, report.velocity_accuracy_m_s
        if velocity is not None:
            east, north, up = velocity
            velocity = east * speed, north * speed, up * speed
        return replace(
            report,
            t_utc_ns=start_ns + round(since_ns / speed),
            velocity_enu_m_s=velocity,
            velocity_accuracy_m_s=None if accuracy is None else accuracy * speed,
        )

    return map(at_speed, flight.reports)


class _Injection:
    """A flight on its way to a broker, and what becomes of its reports."""

    def __init__(
        self, flight: Flight, keys: InjectedFlight, settings: InjectSettings, broker: BrokerAddress
    ) -> None:
        self._flight, self._keys = flight, keys
        self._settings, self._broker = settings, broker
        drone = settings.drone or re.sub(r"[\s/+#]", "-", flight.name)
        self._topic = f"{settings.prefix}/telemetry/{drone}"
        self._sent = self._undelivered = 0
        if not (1 <= len(drone) <= 64 and drone.isprintable()) or set("/+#") & set(drone):
            raise PlotfeedError(
                f"--drone: {drone!a} is no name, the last level of a topic: expected 1 to 64 "
                "printable characters without /, + and #"
            )
        self._answers = SessionAnswers(settings.prefix, drone)

    async def run(self) -> int:
        """Connect, send each report when it is due, and pass on what is said of them."""
        topic, answers = self._topic, self._answers
        if not topic.isprintable() or "+" in topic or "#" in topic:
            raise PlotfeedError(f"topic {topic!a}: expected printable characters without + and #")
        link = MqttTransport(
            self._broker, "plotfeed-inject", subscribe=answers.topics, on_message=answers.hear
        )
        async with link.connected(CONNECT_S):
            await answers.begin()
            is_seen = self._tell_distance()
            await self._send_all(link)
            await link.drain()
            await answers.end()
        for line in answers.details[:MOST_REFUSALS_TOLD]:
            say(f"plotfeed: refused: {line}", err=True)
        say(
            f"{self._sent} reports sent to {self._broker} as {topic}, "
            f"{self._undelivered} undelivered, {answers.refused} refused"
        )
        return 0 if self._is_taken_in() and is_seen else FAILED

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

    def _is_taken_in(self) -> bool:
        """Whether the session took the reports in, by what it says; if not, say why."""
        if self._answers.scene is None:
            say("plotfeed: no session was there to take them in", err=True)
            return False
        meanwhile = self._answers.refused_meanwhile
        if meanwhile:
            reasons = ", ".join(f"{why} {n}" for why, n in meanwhile.most_common())
            say(f"plotfeed: meanwhile the session refused, of all that came: {reasons}", err=True)
        all_refused = self._sent > 0 and meanwhile.total() >= self._sent
        return not (self._undelivered or self._answers.refused or all_refused)

    async def _send_all(self, link: MqttTransport) -> None:
        settings, encode, content_type = self._settings, encode_protobuf, PROTOBUF
        if settings.encoding == "json":
            encode, content_type = encode_json, JSON
        start_utc_ns = time.time_ns() if settings.shift else None
        clock: WallClock | None = None
        try:
            for report in retimed(self._flight, speed=settings.speed, start_utc_ns=start_utc_ns):
                clock = clock or WallClock(report.t_utc_ns)
                await clock.sleep_until(report.t_utc_ns)
                message = Message(
                    topic=self._topic,
                    payload=encode(completed(self._keys, report)),
                    content_type=content_type,
                    due_utc_ns=report.t_utc_ns,
                )
                publish([link], [Outgoing(message, client=self, transports=1)])
        finally:
            if clock is not None:
                clock.close()

    def now_ns(self) -> int:
        """The time at which a report leaves, UTC."""
        return time.time_ns()

    def settled(self, one: Outgoing) -> None:
        """Count what became of a report."""
        self._sent += one.delivered
        self._undelivered += not one.delivered
