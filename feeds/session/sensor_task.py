"""A station at work in a session: sector after sector on the agenda, and its status."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from plotfeed.feeds.delivery.counters import SessionCounters, lateness_us
from plotfeed.feeds.delivery.ledger import LedgerEntry, Settled
from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.formats import Announcer
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.scene.changes import changed
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import in_force, instants_ns
from plotfeed.feeds.sensing.emulated_sensor import AHEAD_NS, EmulatedSensor
from plotfeed.feeds.session.status import settings_message, status_message
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.timing.schedule import ActionKind, Schedule
from plotfeed.models.beam.scan import Sector
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

STATUS_EVERY_NS = 5 * NS


class SectorWatcher(Protocol):
    """Follows a session from within: a page, say. It must return soon, and never raise."""

    def report(self, report: SectorReport) -> None:
        """A sector is reported now."""

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""


KeepLedger = Callable[[SectorReport, Sequence[Settled], str], None]
"""Given a sector, its messages, all settled, and the link's keys then in JSON."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionContext:
    """What all desks of a session share."""

    prefix: str
    clock: Clock
    agenda: Schedule
    totals: SessionCounters
    keep_ledger: KeepLedger
    watchers: Sequence[SectorWatcher] = ()


class SensorTask:
    """Does a station's reports when they are due, and keeps its account."""

    def __init__(
        self,
        station: EmulatedSensor,
        outbox: Outbox,
        office: SessionContext,
        herald: Announcer | None = None,
    ) -> None:
        self.outbox = outbox
        self.sensor = station.sensor
        """As it is now."""
        self._scripted = station.sensor
        self._controlled: dict[str, Any] = {}
        self._station = station
        self._office = office
        self._herald = herald
        self._status = pb.SensorStatus(sensor=station.sensor.id)
        self._link = json_of(station.sensor.link)
        self._start_ns = 0

    def open(self, start_utc_ns: int) -> None:
        """Begin with the first whole sector after that time."""
        self._start_ns = start_utc_ns
        sector = self._station.sector_at(start_utc_ns)
        if sector.start_ns < start_utc_ns:
            sector = self._station.next_sector(sector)
        self._status.scan = sector.scan
        for after_ns in instants_ns(self._scripted.event):
            at_utc_ns = start_utc_ns + after_ns
            self._office.agenda.put(at_utc_ns, partial(self._renew, at_utc_ns))
        self._renew(start_utc_ns)
        self._plan(sector)
        self._tell_status(start_utc_ns)
        self._tell_settings()
        if self._herald is not None:
            self._send_all(self._herald.opening(start_utc_ns))
            self._plan_herald(start_utc_ns + self._herald.every_ns, self._herald)

    def close(self) -> None:
        """Say that the sensor is no longer there."""
        self.outbox.end()
        if self._herald is not None:
            self._send_all(self._herald.closing(self._office.clock.now_ns()))
        self._publish_status(pb.SensorStatus.OFFLINE)

    def control(self, changes: Mapping[str, Any] | None, at_utc_ns: int) -> None:
        """Change those keys from that time on, or with None none any more; raises `ChangeError`."""
        before, self._controlled = self._controlled, {}
        if changes is not None:
            self._controlled = _over(before, changes)
        try:
            self._renew(at_utc_ns)
        except Exception:
            self._controlled = before
            raise
        self._tell_settings()

    def _renew(self, at_utc_ns: int) -> None:
        """Be as script and control have it then, however late it is done."""
        scripted = in_force(self._scripted.event, at_utc_ns - self._start_ns)
        sensor = changed(self._scripted, *scripted, self._controlled)
        if sensor == self.sensor:
            return
        self._station.change(sensor)
        if sensor.link != self.sensor.link:
            self.outbox.change(sensor.link or LinkSettings(), at_utc_ns)
            self._link = json_of(sensor.link)
        self.sensor = sensor
        self._status.enabled = sensor.enabled
        for watcher in self._office.watchers:
            watcher.settings(sensor)

    def _plan(self, sector: Sector) -> None:
        ahead_ns = min(AHEAD_NS, sector.end_ns - sector.start_ns)
        self._office.agenda.put(sector.end_ns - ahead_ns, partial(self._prepare, sector))

    def _prepare(self, sector: Sector) -> None:
        now_ns = self._office.clock.now_ns()
        if now_ns - sector.end_ns > self._station.period_ns:
            sector = self._skip_to(now_ns, sector)
        if self.sensor.enabled:
            report = self._station.report(sector)
            self.outbox.make_ready(report.messages)
            self._office.agenda.put(sector.end_ns, partial(self._send, report), ActionKind.SENDING)
        self._plan(self._station.next_sector(sector))

    def _send(self, report: SectorReport) -> None:
        link = self._link
        account = LedgerEntry(lambda settled: self._office.keep_ledger(report, settled, link))
        self.outbox.send_together(report.messages, account)
        account.close()
        self._status.scan = report.sector.scan
        self._status.plots += len(report.plots)
        self._office.totals.add(report)
        for watcher in self._office.watchers:
            watcher.report(report)

    def _skip_to(self, now_ns: int, sector: Sector) -> Sector:
        """The last sector that has ended: what was missed is counted, never sent in a burst."""
        last = self._station.sector_at(now_ns - (sector.end_ns - sector.start_ns))
        self._status.missed_scans += last.scan - sector.scan
        self._office.totals.missed_scans += last.scan - sector.scan
        return last

    def _tell_status(self, due_utc_ns: int) -> None:
        self._publish_status(pb.SensorStatus.ONLINE)
        next_ns = due_utc_ns + STATUS_EVERY_NS
        self._office.agenda.put(next_ns, partial(self._tell_status, next_ns))

    def _plan_herald(self, due_utc_ns: int, herald: Announcer) -> None:
        def tell() -> None:
            self._send_all(herald.regular(due_utc_ns))
            self._plan_herald(due_utc_ns + herald.every_ns, herald)

        self._office.agenda.put(due_utc_ns, tell)

    def _send_all(self, messages: Sequence[Message]) -> None:
        self.outbox.send_past_link(*messages)

    def _tell_settings(self) -> None:
        self.outbox.send_past_link(self.settings)

    @property
    def settings(self) -> Message:
        """The sensor's keys as they are now, as whoever comes later is told."""
        now_ns = self._office.clock.now_ns()
        return settings_message(self._office.prefix, self.sensor, self._controlled, now_ns)

    @property
    def health(self) -> pb.SensorStatus:
        """The sensor's status as it is now, but for its lateness."""
        status, counts = self._status, self.outbox.counts
        status.refused = self._office.totals.refused
        status.undelivered = counts.undelivered
        status.lost = counts.lost
        status.duplicated = counts.duplicated
        status.on_the_way = self.outbox.on_the_way
        status.waiting = self.outbox.waiting
        status.enabled = self.sensor.enabled
        return status

    def _publish_status(self, state: pb.SensorStatus.State) -> None:
        status, counts = self.health, self.outbox.counts
        status.state = state
        status.lateness_p50_us, status.lateness_p99_us = lateness_us(counts.lateness_ns, 50, 99)
        counts.lateness_ns.clear()
        now_ns = self._office.clock.now_ns()
        self.outbox.send_past_link(status_message(self._office.prefix, status, now_ns))


def _over(before: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes over earlier ones, kept as changes: what takes a key away stays in."""
    result = dict(before)
    for key, value in changes.items():
        earlier = result.get(key)
        if isinstance(value, Mapping) and isinstance(earlier, Mapping) and "kind" not in value:
            result[key] = _over(earlier, value)
        else:
            result[key] = value
    return result


def json_of(link: LinkSettings | None) -> str:
    """A link's keys for the ledger, without those that have their defaults; empty for none."""
    return "" if link is None else link.model_dump_json(exclude_defaults=True)
