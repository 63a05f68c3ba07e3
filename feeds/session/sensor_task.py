"""What sends in a session: sensors, sector after sector, and drones that tell of themselves.

Status, settings and description of a sensor are retained for whoever comes later.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS, MissedScans
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.formats import Announcer
from plotfeed.feeds.link.lateness import lateness_us
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.scene.changes import Layers, instants_ns, joined
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import SessionContext
from plotfeed.feeds.session.sensor_description import mount_status, status_of
from plotfeed.feeds.telemetry.receiver import to_json
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS, iso_utc

if TYPE_CHECKING:
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.dwell_agenda import PointedBeams

STATUS_EVERY_NS = 5 * NS
STATUSES_AT_ONCE = 8
"""Sensors that tell of themselves in one tick, lest those of hundreds hold up a deadline."""


class SensorTask:
    """A sensor in a session, beside its reports: its keys, its status, its way out."""

    def __init__(
        self,
        engine: Engine,
        i: int,
        outbox: Outbox,
        context: SessionContext,
        announcer: Announcer | None = None,
    ) -> None:
        """Sensor `i` of the engine's."""
        self.outbox = outbox
        self.sensor = engine.sensors.sensors[i]
        """As it is now."""
        self._engine, self._sensors, self._i = engine, engine.sensors, i
        self._context = context
        self._prefix = context.scene.mqtt.prefix
        self._announcer = announcer
        self._describer = context.describer
        self._description = context.describer.description(self.sensor)
        self._status = status_of(self._description)

    def start(self, start_utc_ns: int, now_utc_ns: int) -> None:
        """Say what there is to say of the sensor, now and from now on; its script began before."""
        self._status.scan = self._sensors.next_sector(self._i).scan
        for after_ns in instants_ns(self.sensor.event):
            at_utc_ns = start_utc_ns + after_ns
            if at_utc_ns >= now_utc_ns:
                change = partial(self._change_by_script, at_utc_ns)
                self._context.schedule.put(at_utc_ns, change)
        self._description.time_utc.FromNanoseconds(now_utc_ns)
        self._follow_script(now_utc_ns)
        self._publish_status(pb.SensorStatus.ONLINE)
        later_ns = self._i // STATUSES_AT_ONCE * AHEAD_NS
        self._plan_status(now_utc_ns + later_ns + STATUS_EVERY_NS)
        self.outbox.send_past_link(self.settings, self.description)
        if self._announcer is not None:
            self._announcer.changed(self.sensor, now_utc_ns)
            self.outbox.send_past_link(*self._announcer.opening(now_utc_ns))
            self._plan_announcement(now_utc_ns + self._announcer.every_ns, self._announcer)

    def end(self) -> None:
        """Say that the sensor is no longer there."""
        self.outbox.end()
        if self._announcer is not None:
            now_ns = self._context.clock.now_ns()
            self.outbox.send_past_link(*self._announcer.closing(now_ns))
        self._publish_status(pb.SensorStatus.OFFLINE)

    def reported(self, scan: int, plots: int) -> None:
        """A sector of that scan has been reported, with so many plots."""
        self._status.scan = scan
        self._status.plots += plots

    def missed(self, missed: MissedScans) -> None:
        """Count what was left out, since it was too late for that."""
        self._status.missed_scans += missed.scans
        self.outbox.counters.leave_out(missed.first_end_ns, missed.last_end_ns)

    def follow(self, at_utc_ns: int) -> None:
        """Be as script and control have it then, and say so; something was asked of it."""
        before = self._description
        self._follow_script(at_utc_ns)
        self._tell_change(before)

    def _change_by_script(self, at_utc_ns: int) -> None:
        """Do what an event of the scene asks for, and say so if it changes anything."""
        sensor, before = self.sensor, self._description
        self._follow_script(at_utc_ns)
        if self.sensor is not sensor:
            self._tell_change(before)

    def _tell_change(self, before: pb.SensorDescription) -> None:
        self.outbox.send_past_link(self.settings)
        if self._description is not before:
            self.outbox.send_past_link(self.description)

    def asked(self, payload: bytes, as_of_ns: int) -> None:
        """Do what somebody asks in the words of a format, and answer in them."""
        node = self.outbox.counters.sapient
        if self._announcer is None or node is None:
            return
        reply = self._announcer.answer(payload, as_of_ns, partial(self._control, as_of_ns))
        node.count("tasks" if reply.accepted else "rejected")
        self.outbox.send_past_link(*reply.messages)

    def _control(self, at_utc_ns: int, change: Mapping[str, Any] | None) -> None:
        """Change those keys from that time on, or with None none any more; raises `ChangeError`."""
        changes = self._engine.changes
        changes.control(self.sensor.id, change, at_utc_ns)
        changes.take_changed()
        self.follow(at_utc_ns)

    def _follow_script(self, at_utc_ns: int) -> None:
        """Be as script and control have it then, however late it is done."""
        sensor = self._sensors.as_of(self._i, joined(self._layers), at_utc_ns)
        if sensor == self.sensor:
            return
        self.sensor = sensor
        self._status.enabled = sensor.enabled
        described = self._describer.description(sensor)
        described.time_utc.CopyFrom(self._description.time_utc)
        if described != self._description:
            described.time_utc.FromNanoseconds(at_utc_ns)
            self._description = described
        if self._announcer is not None:
            news = self._announcer.changed(sensor, at_utc_ns)
            self.outbox.send_past_link(*news)
        for observer in self._context.observers:
            observer.settings(sensor)

    def _plan_status(self, due_utc_ns: int) -> None:
        def report() -> None:
            self._publish_status(pb.SensorStatus.ONLINE)
            self._plan_status(due_utc_ns + STATUS_EVERY_NS)

        self._context.schedule.put(due_utc_ns, report)

    def _plan_announcement(self, due_utc_ns: int, announcer: Announcer) -> None:
        def announce() -> None:
            self.outbox.send_past_link(*announcer.regular(due_utc_ns))
            self._plan_announcement(due_utc_ns + announcer.every_ns, announcer)

        self._context.schedule.put(due_utc_ns, announce)

    @property
    def _layers(self) -> Layers:
        return self._engine.changes.layers[self.sensor.id]

    @property
    def settings(self) -> Message:
        """The sensor's keys as they are now, as whoever comes later is told."""
        now_ns = self._context.clock.now_ns()
        return settings_message(self._prefix, self.sensor, joined(self._layers), now_ns)

    @property
    def description(self) -> Message:
        """What and where the sensor is and how it reports, as whoever comes later is told."""
        now_ns = self._context.clock.now_ns()
        source, sensor = f"{self._prefix}/{self.sensor.id}", self.sensor.id
        payload = to_json(self._description)
        return retained_message(source, "description", payload, now_ns, sensor=sensor)

    @property
    def status(self) -> pb.SensorStatus:
        """The sensor's status as it is now, but for its lateness."""
        status, counts = self._status, self.outbox.counters
        totals = self._context.totals
        status.refused, status.conflated = totals.refused, totals.conflated
        status.drones, status.forgotten = totals.drones, totals.forgotten
        status.refused_by_reason.update(totals.refused_by)
        status.flooded, status.late = totals.flooded, totals.late
        status.intake_behind_s = totals.intake_behind_s
        status.undelivered = counts.undelivered
        status.undelivered_to.update(counts.undelivered_to)
        status.lost = counts.lost
        status.duplicated = counts.duplicated
        status.on_the_way = self.outbox.on_the_way
        status.waiting = self.outbox.waiting
        status.enabled = self.sensor.enabled
        if (state := self._sensors.cueing.state_of(self._i)) is not None:
            status.mount.CopyFrom(mount_status(self.sensor, state))
        if counts.sapient is not None:
            node = counts.sapient
            for told in pb.SapientStatus.DESCRIPTOR.fields:
                setattr(status.sapient, told.name, getattr(node, told.name))
        return status

    @property
    def pointed(self) -> CuedState | PointedBeams | None:
        """Where its mount or beams pointed in the last scan; None where nothing turns."""
        return self._sensors.pointed(self._i)

    def _publish_status(self, state: pb.SensorStatus.State) -> None:
        status, counts = self.status, self.outbox.counters
        status.state = state
        status.lateness_p50_us, status.lateness_p99_us = lateness_us(counts.lateness_ns, 50, 99)
        counts.lateness_ns.clear()
        now_ns = self._context.clock.now_ns()
        self.outbox.send_past_link(status_message(self._prefix, status, now_ns))


def status_message(prefix: str, status: pb.SensorStatus, now_utc_ns: int) -> Message:
    """A sensor's status."""
    status.time_utc.FromNanoseconds(now_utc_ns)
    sensor = status.sensor
    return retained_message(
        f"{prefix}/{sensor}", "status", to_json(status), now_utc_ns, sensor=sensor
    )


def settings_message(
    prefix: str, sensor: Sensor, controlled: Mapping[str, Any], now_utc_ns: int
) -> Message:
    """What a sensor's keys are at the moment, and which of them control has changed."""
    said = {
        "sensor": sensor.id,
        "time_utc": iso_utc(now_utc_ns),
        "controlled": controlled,
        "in_force": sensor.model_dump(mode="json", exclude_unset=True, exclude={"event"}),
    }
    payload, source = json.dumps(said).encode(), f"{prefix}/{sensor.id}"
    return retained_message(source, "settings", payload, now_utc_ns, sensor=sensor.id)
