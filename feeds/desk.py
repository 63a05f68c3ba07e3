"""A station at work in a session: sector after sector on the agenda, and its status."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from plotfeed.feeds.agenda import Agenda
from plotfeed.feeds.clock import Clock
from plotfeed.feeds.cloud_events import attributes
from plotfeed.feeds.intake import to_json
from plotfeed.feeds.message import JSON, Message
from plotfeed.feeds.outbox import LATENESS_KEPT, Outbox, lateness_us
from plotfeed.feeds.station import SectorReport, Station
from plotfeed.feeds.times import NS
from plotfeed.models.scan import Sector
from plotfeed.models.state import FALSE_ALARM
from plotfeed.proto import plotfeed_pb2 as pb

STATUS_EVERY_NS = 5 * NS
AHEAD_NS = 10_000_000
"""A sector is worked out this long before its messages are due, so that only sending is left."""


@dataclass(slots=True)
class Totals:
    """What a session has done so far."""

    drones: int = 0
    scan: int = 0
    looks: int = 0
    plots: int = 0
    false_alarms: int = 0
    messages: int = 0
    undelivered: int = 0
    missed_scans: int = 0
    telemetry: int = 0
    refused: int = 0
    last_refusal: str = ""
    lateness_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATENESS_KEPT))

    def add(self, report: SectorReport, sent: Sequence[pb.Sent]) -> None:
        """Count one sector and the messages that told of it."""
        self.scan = max(self.scan, report.sector.scan)
        self.looks += len(report.looks)
        self.plots += len(report.plots)
        self.false_alarms += int((report.plots.drone == FALSE_ALARM).sum())
        self.messages += len(sent)
        self.undelivered += sum(not s.delivered for s in sent)
        self.lateness_ns.extend(s.sent_utc_ns - s.due_utc_ns for s in sent)


def status_message(prefix: str, status: pb.SensorStatus, now_utc_ns: int) -> Message:
    """A sensor's status, retained for whoever comes later."""
    status.time_utc.FromNanoseconds(now_utc_ns)
    source = f"{prefix}/{status.sensor}"
    return Message(
        topic=f"{source}/status",
        payload=to_json(status),
        content_type=JSON,
        due_utc_ns=now_utc_ns,
        properties=attributes(source, "status", str(now_utc_ns), now_utc_ns, sensor=status.sensor),
        retain=True,
        qos=1,
    )


class Herald(Protocol):
    """Says of a sensor, in a format that has words for it, that it comes, is there, and goes."""

    every_ns: int
    """From one regular message to the next."""

    def opening(self, now_utc_ns: int) -> list[Message]:
        """Before anything else, on every connection."""

    def regular(self, now_utc_ns: int) -> list[Message]:
        """As long as it works."""

    def closing(self, now_utc_ns: int) -> list[Message]:
        """At the end."""


class Desk:
    """Does a station's reports when they are due, and keeps its account."""

    def __init__(
        self,
        station: Station,
        outbox: Outbox,
        *,
        prefix: str,
        clock: Clock,
        agenda: Agenda,
        totals: Totals,
        keep_ledger: Callable[[SectorReport, Sequence[pb.Sent]], None],
        herald: Herald | None = None,
    ) -> None:
        self.outbox = outbox
        self._station = station
        self._prefix = prefix
        self._clock = clock
        self._agenda = agenda
        self._totals = totals
        self._keep_ledger = keep_ledger
        self._herald = herald
        self._status = pb.SensorStatus(sensor=station.sensor.id)

    def open(self, start_utc_ns: int) -> None:
        """Begin with the first whole sector after that time."""
        sector = self._station.sector_at(start_utc_ns)
        if sector.start_ns < start_utc_ns:
            sector = self._station.next_sector(sector)
        self._status.scan = sector.scan
        self._plan(sector)
        self._tell_status(start_utc_ns)
        if self._herald is not None:
            self._send_all(self._herald.opening(start_utc_ns))
            self._plan_herald(start_utc_ns + self._herald.every_ns, self._herald)

    def close(self) -> None:
        """Say that the sensor is no longer there."""
        if self._herald is not None:
            self._send_all(self._herald.closing(self._clock.now_ns()))
        self._publish_status(pb.SensorStatus.OFFLINE)

    def _plan(self, sector: Sector) -> None:
        ahead_ns = min(AHEAD_NS, sector.end_ns - sector.start_ns)
        self._agenda.put(sector.end_ns - ahead_ns, partial(self._prepare, sector))

    def _prepare(self, sector: Sector) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - sector.end_ns > self._station.period_ns:
            sector = self._skip_to(now_ns, sector)
        report = self._station.report(sector)
        self._agenda.put(sector.end_ns, partial(self._send, report))
        self._plan(self._station.next_sector(sector))

    def _send(self, report: SectorReport) -> None:
        sent = [self.outbox.send(message) for message in report.messages]
        self._keep_ledger(report, sent)
        self._status.scan = report.sector.scan
        self._status.plots += len(report.plots)
        self._totals.add(report, sent)

    def _skip_to(self, now_ns: int, sector: Sector) -> Sector:
        """The last sector that has ended: what was missed is counted, never sent in a burst."""
        last = self._station.sector_at(now_ns - (sector.end_ns - sector.start_ns))
        self._status.missed_scans += last.scan - sector.scan
        self._totals.missed_scans += last.scan - sector.scan
        return last

    def _tell_status(self, due_utc_ns: int) -> None:
        self._publish_status(pb.SensorStatus.ONLINE)
        next_ns = due_utc_ns + STATUS_EVERY_NS
        self._agenda.put(next_ns, partial(self._tell_status, next_ns))

    def _plan_herald(self, due_utc_ns: int, herald: Herald) -> None:
        def tell() -> None:
            self._send_all(herald.regular(due_utc_ns))
            self._plan_herald(due_utc_ns + herald.every_ns, herald)

        self._agenda.put(due_utc_ns, tell)

    def _send_all(self, messages: Sequence[Message]) -> None:
        for message in messages:
            self.outbox.send(message)

    def _publish_status(self, state: pb.SensorStatus.State) -> None:
        status = self._status
        status.state = state
        status.refused = self._totals.refused
        status.undelivered = self.outbox.undelivered
        status.lateness_p50_us, status.lateness_p99_us = lateness_us(
            self.outbox.lateness_ns, 50, 99
        )
        self.outbox.lateness_ns.clear()
        self.outbox.send(status_message(self._prefix, status, self._clock.now_ns()))
