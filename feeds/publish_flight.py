"""A recorded flight published over MQTT as live telemetry."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import click

from plotfeed.feeds.altitude import AltitudeDatum
from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.clock import WallClock
from plotfeed.feeds.flights import Flight, FlightOptions, read, smoothed
from plotfeed.feeds.inject import schedule
from plotfeed.feeds.message import JSON, PROTOBUF, Message
from plotfeed.feeds.mqtt import MqttLink
from plotfeed.feeds.parcel import Parcel
from plotfeed.feeds.report import AltitudeReference, Report
from plotfeed.feeds.telemetry import encode_json, encode_protobuf
from plotfeed.proto.errors import PlotfeedError

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

    def settle(self, parcel: Parcel) -> None:
        self.sent += parcel.delivered
        self.undelivered += not parcel.delivered


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
            link.publish(Parcel(message, clock, 1, account.settle))
    finally:
        if clock is not None:
            clock.close()


def _completed(report: Report, datum: AltitudeDatum, rcs_m2: float | None) -> Report:
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
