"""A recorded flight published over MQTT as live telemetry: when each report is due."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import click

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.telemetry.decode_reports import encode_json, encode_protobuf
from plotfeed.feeds.telemetry.flights import read, smoothed
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, PositionReport
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttLink
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.errors import PlotfeedError

MAX_SPEED = 1000.0
"""Times as fast as it was flown: beyond it, reports would fall on the same nanosecond."""


def schedule(
    flight: Flight, *, speed: float = 1.0, start_utc_ns: int | None = None
) -> Iterator[tuple[int, PositionReport]]:
    """Each report with the time at which it is due, which is also the time that it then bears.

    The flight starts at `start_utc_ns`, or when it was flown. At speed 2 reports follow each
    other in half the time and their velocities are doubled, so that positions, times and
    velocities agree for whoever tracks them.
    """
    if not 0 < speed <= MAX_SPEED:
        raise PlotfeedError(f"speed is {speed:g}; expected more than 0 and at most {MAX_SPEED:g}")
    return (_shifted(report, flight, speed, start_utc_ns) for report in flight.reports)


def _shifted(
    report: PositionReport, flight: Flight, speed: float, start_utc_ns: int | None
) -> tuple[int, PositionReport]:
    recorded_start_ns = flight.reports[0].t_utc_ns
    start_ns = recorded_start_ns if start_utc_ns is None else start_utc_ns
    since_ns = report.t_utc_ns - recorded_start_ns
    due_utc_ns = start_ns + (since_ns if speed == 1 else round(since_ns / speed))
    return due_utc_ns, _hastened(replace(report, t_utc_ns=due_utc_ns), speed)


def _hastened(report: PositionReport, speed: float) -> PositionReport:
    """The report of a drone that flies that many times as fast."""
    if speed == 1:
        return report
    velocity, accuracy = report.velocity_enu_m_s, report.velocity_accuracy_m_s
    if velocity is not None:
        east, north, up = velocity
        velocity = east * speed, north * speed, up * speed
    return replace(
        report,
        velocity_enu_m_s=velocity,
        velocity_accuracy_m_s=None if accuracy is None else accuracy * speed,
    )


log = logging.getLogger(__name__)

CONNECT_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFeed:
    """How to publish a flight."""

    broker: BrokerAddress
    prefix: str = "plotfeed"
    drone: str | None = None
    speed: float = 1.0
    shift: bool = False
    """Whether the flight's time begins now; otherwise its reports keep the time of the file."""
    encoding: Literal["protobuf", "json"] = "protobuf"
    raw: bool = False
    takeoff_height_m: float | None = None
    geoid_undulation_m: float | None = None
    rcs_m2: float | None = None


def publish_flight(path: Path, options: FlightOptions, feed: FlightFeed) -> int:
    """Publish the flight in a file at its own tempo; the exit code. Raises `PlotfeedError`."""
    recorded = read(path, replace(options, start_utc_ns=time.time_ns()))
    for line in (*recorded.assumed, *_some(recorded.skipped)):
        click.echo(f"plotfeed: {path}: {line}", err=True)
    flight = recorded if feed.raw else smoothed(recorded)
    click.echo(
        f"{path}: {len(flight.reports)} reports, {flight.duration_s / feed.speed:.0f} s to fly"
    )
    return asyncio.run(_publish(flight, feed))


def _some(lines: tuple[str, ...], at_most: int = 5) -> tuple[str, ...]:
    if len(lines) <= at_most:
        return lines
    return (*lines[:at_most], f"and {len(lines) - at_most} more records skipped")


@dataclass(slots=True)
class _Account:
    """What has become of the reports."""

    sent: int = 0
    undelivered: int = 0

    def settled(self, delivery: Delivery) -> None:
        self.sent += delivery.delivered
        self.undelivered += not delivery.delivered


async def _publish(flight: Flight, feed: FlightFeed) -> int:
    """Connect, send each report when it is due, and pass on what is said of them."""
    drone = feed.drone or flight.name.replace(" ", "-")
    topic = f"{feed.prefix}/telemetry/{drone}"
    if not topic.isprintable() or "+" in topic or "#" in topic:
        raise PlotfeedError(f"topic {topic!a}: expected printable characters without + and #")
    refusals: list[str] = []

    def heard(_topic: str, payload: bytes, _content_type: str | None) -> None:
        _note_refusal(payload, drone, refusals)

    link = MqttLink(
        feed.broker,
        "plotfeed-inject",
        subscribe=[f"{feed.prefix}/errors"],
        on_message=heard,
    )
    account = _Account()
    running = asyncio.create_task(link.run(), name="link[inject]")
    try:
        await link.wait_until_up(CONNECT_S)
        await _send_all(flight, feed, drone, link, account)
        await link.drain()
        await asyncio.sleep(0.2)  # for what is said of the last ones
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    for line in refusals[:5]:
        click.echo(f"plotfeed: refused: {line}", err=True)
    told = f"{account.sent} reports sent to {feed.broker} as {feed.prefix}/telemetry/{drone}"
    click.echo(f"{told}, {account.undelivered} undelivered, {len(refusals)} refused")
    return 1 if account.undelivered or refusals else 0


async def _send_all(
    flight: Flight, feed: FlightFeed, drone: str, link: MqttLink, account: _Account
) -> None:
    """Every report when it is due."""
    start_utc_ns = time.time_ns() if feed.shift else None
    encode, content_type = (
        (encode_json, JSON) if feed.encoding == "json" else (encode_protobuf, PROTOBUF)
    )
    datum = AltitudeDatum(feed.takeoff_height_m, feed.geoid_undulation_m)
    clock: WallClock | None = None
    try:
        for due_utc_ns, report in schedule(flight, speed=feed.speed, start_utc_ns=start_utc_ns):
            clock = clock or WallClock(due_utc_ns)
            await clock.sleep_until(due_utc_ns)
            message = Message(
                topic=f"{feed.prefix}/telemetry/{drone}",
                payload=encode(_completed(report, datum, feed.rcs_m2)),
                content_type=content_type,
                due_utc_ns=due_utc_ns,
            )
            link.publish(Delivery(message, clock, 1, account))
    finally:
        if clock is not None:
            clock.close()


def _completed(
    report: PositionReport, datum: AltitudeDatum, rcs_m2: float | None
) -> PositionReport:
    """With what the command line knows beyond the file: heights above the ellipsoid, the RCS."""
    if rcs_m2 is not None:
        report = replace(report, rcs_m2=rcs_m2)
    declared = {
        AltitudeReference.ABOVE_TAKEOFF: datum.takeoff_height_m,
        AltitudeReference.MEAN_SEA_LEVEL: datum.geoid_undulation_m,
    }
    if declared.get(report.altitude_reference) is None:
        return report
    return replace(
        report, altitude_m=datum.height_m(report), altitude_reference=AltitudeReference.ELLIPSOID
    )


def _note_refusal(payload: bytes, drone: str, refusals: list[str]) -> None:
    try:
        refusal = json.loads(payload)
        if refusal.get("drone") == drone:
            refusals.append(str(refusal.get("detail")))
    except (ValueError, AttributeError):
        log.warning("something that is no refusal came on the topic of errors")
