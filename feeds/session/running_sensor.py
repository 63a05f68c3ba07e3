"""A sensor in a session, beside its reports: its keys, its status, its way out.

Status, settings and description of a sensor are retained for whoever comes later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS, MissedScans
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.sensor_description import (
    description_message,
    description_of,
    mount_status,
    settings_message,
    status_message,
    status_of,
)
from plotfeed.feeds.link.counters import lateness_us
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import instants_ns, joined
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.outputs import Outputs
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.dwell_agenda import PointedBeams

STATUS_EVERY_NS = 5 * NS
# Sensors that tell of themselves in one tick, lest those of hundreds hold up a deadline.
STATUSES_AT_ONCE = 8


class RunningSensor:
    """A sensor of an engine, as it is now, and what a session tells of it."""

    def __init__(
        self,
        engine: Engine,
        i: int,
        outputs: Outputs,
        *,
        sea_level: SeaLevel,
        changed: Sequence[Callable[[Sensor], object]],
        start_ns: int,
    ) -> None:
        """Sensor `i` of the engine's; `changed` are told of it when its keys are others.

        It has one of the `outputs`, as of `start_ns`.
        """
        sensor = self.sensor = engine.sensors.sensors[i]  # As it is now
        self._description = description_of(engine.scene, sea_level, sensor)
        self._status = status_of(self._description)
        if_dead = status_of(self._description)
        self.outbox, self._announcer = outputs.of_sensor(sensor, if_dead, start_ns)
        self._engine, self._sensors, self._i = engine, engine.sensors, i
        self._prefix = engine.scene.mqtt.prefix
        self._sea_level, self._schedule = sea_level, outputs.schedule
        self._totals, self._changed = outputs.totals, changed
        self._since_ns = 0  # Since when its keys, and what control asks of them, are so
        self._scan = self._plots = 0  # The last one that was reported, and all so far

    def start(self, start_utc_ns: int, now_utc_ns: int) -> None:
        """Say what there is to say of the sensor, now and from now on; its script began before."""
        self._scan = self._sensors.upcoming.sector(self._i).scan
        self._since_ns = now_utc_ns
        for after_ns in instants_ns(self.sensor.event):
            at_utc_ns = start_utc_ns + after_ns
            if at_utc_ns >= now_utc_ns:
                self._schedule.put(at_utc_ns, partial(self._change_by_script, at_utc_ns))
        self._description.time_utc.FromNanoseconds(now_utc_ns)
        self._follow_script(now_utc_ns)
        self._publish_status(pb.SensorStatus.ONLINE)
        told_ns = now_utc_ns + self._i // STATUSES_AT_ONCE * AHEAD_NS + STATUS_EVERY_NS
        online = pb.SensorStatus.ONLINE
        self._repeat(told_ns, STATUS_EVERY_NS, lambda _: self._publish_status(online))
        self.outbox.send_past_link(self.settings, self.description)
        if (announcer := self._announcer) is not None:
            announcer.changed(self.sensor, now_utc_ns)
            send, every_ns = self.outbox.send_past_link, announcer.every_ns
            send(*announcer.opening(now_utc_ns))
            self._repeat(
                now_utc_ns + every_ns, every_ns, lambda t_ns: send(*announcer.regular(t_ns))
            )

    def end(self) -> None:
        """Say that the sensor is no longer there."""
        self.outbox.end()
        if self._announcer is not None:
            self.outbox.send_past_link(*self._announcer.closing(self.outbox.now_ns()))
        self._publish_status(pb.SensorStatus.OFFLINE)

    def reported(self, scan: int, plots: int) -> None:
        """A sector of that scan has been reported, with so many plots."""
        self._scan, self._plots = scan, self._plots + plots

    def missed(self, missed: MissedScans) -> None:
        """Count what was left out, since it was too late for that."""
        self._status.missed_scans += missed.scans
        self.outbox.counters.leave_out(missed.first_end_ns, missed.last_end_ns)

    def follow(self, at_utc_ns: int, *, since_ns: int | None = None) -> None:
        """Be as script and control have it then, and say so; something was asked of it.

        Control counts after that time; `since_ns` is given where it is so since another.
        """
        before, self._since_ns = self._description, since_ns or at_utc_ns + 1
        self._follow_script(at_utc_ns)
        self.outbox.send_past_link(self.settings)
        if self._description is not before:
            self.outbox.send_past_link(self.description)

    def _change_by_script(self, at_utc_ns: int) -> None:
        """Do what an event of the scene asks for, and say so if it changes anything."""
        if self._as_of(at_utc_ns) != self.sensor:
            self.follow(at_utc_ns, since_ns=at_utc_ns)

    def asked(self, payload: bytes, as_of_ns: int) -> None:
        """Do what somebody asks in the words of a format, and answer in them."""
        node = self.outbox.counters.sapient
        if self._announcer is None or node is None:
            return

        def control(change: Mapping[str, Any] | None) -> None:
            changes = self._engine.changes
            changes.control(self.sensor.id, change, as_of_ns)
            changes.take_changed()
            self.follow(as_of_ns)

        messages, is_done = self._announcer.answer(payload, as_of_ns, control)
        node.count("tasks" if is_done else "rejected")
        self.outbox.send_past_link(*messages)

    def _as_of(self, at_utc_ns: int) -> Sensor:
        return self._sensors.as_of(self._i, self._controlled, at_utc_ns)

    def _follow_script(self, at_utc_ns: int) -> None:
        """Be as script and control have it then, however late it is done."""
        sensor = self._as_of(at_utc_ns)
        if sensor == self.sensor:
            return
        self.sensor = sensor
        self._status.enabled = sensor.enabled
        described = description_of(self._engine.scene, self._sea_level, sensor)
        described.time_utc.CopyFrom(self._description.time_utc)
        if described != self._description:
            described.time_utc.FromNanoseconds(at_utc_ns)
            self._description = described
        if self._announcer is not None:
            self.outbox.send_past_link(*self._announcer.changed(sensor, at_utc_ns))
        for tell in self._changed:
            tell(sensor)

    def _repeat(self, due_utc_ns: int, every_ns: int, tell: Callable[[int], object]) -> None:
        """Call that then, with that time, and again whenever as long has passed."""

        def do() -> None:
            tell(due_utc_ns)
            self._repeat(due_utc_ns + every_ns, every_ns, tell)

        self._schedule.put(due_utc_ns, do)

    @property
    def _controlled(self) -> Mapping[str, Any]:
        """The keys that control has changed, over those of its script."""
        return joined(self._engine.changes.layers[self.sensor.id])

    @property
    def settings(self) -> Message:
        """The sensor's keys as they are now, as whoever comes later is told."""
        now_ns, sensor = self.outbox.now_ns(), self.sensor
        return settings_message(self._prefix, sensor, self._controlled, self._since_ns, now_ns)

    @property
    def description(self) -> Message:
        """What and where the sensor is and how it reports, as whoever comes later is told."""
        return description_message(self._prefix, self._description, self.outbox.now_ns())

    @property
    def status(self) -> pb.SensorStatus:
        """The sensor's status as it is now, but for its lateness."""
        status, counts, totals = self._status, self.outbox.counters, self._totals
        status.scan, status.plots = self._scan, self._plots
        status.refused, status.conflated = totals.refused, totals.conflated
        status.drones, status.forgotten = totals.drones, totals.forgotten
        status.refused_by_reason.update(totals.refused_by)
        status.flooded, status.late = totals.flooded, totals.late
        status.intake_behind_s = totals.intake_behind_s
        status.undelivered = counts.undelivered
        status.undelivered_to.update(counts.undelivered_to)
        status.lost, status.duplicated = counts.lost, counts.duplicated
        status.on_the_way, status.waiting = self.outbox.on_the_way, self.outbox.waiting
        status.enabled = self.sensor.enabled
        if (state := self._sensors.mount(self._i)) is not None:
            status.mount.CopyFrom(mount_status(self.sensor, state))
        if counts.sapient is not None:
            for told in pb.SapientStatus.DESCRIPTOR.fields:
                setattr(status.sapient, told.name, getattr(counts.sapient, told.name))
        return status

    @property
    def pointed(self) -> CuedState | PointedBeams | None:
        """Where its mount or beams pointed in the last scan; None where nothing turns."""
        return self._sensors.pointed(self._i)

    def _publish_status(self, state: pb.SensorStatus.State) -> None:
        status, late_ns = self.status, self.outbox.counters.lateness_ns
        status.state = state
        status.lateness_p50_us, status.lateness_p99_us = lateness_us(late_ns, 50, 99)
        late_ns.clear()
        now_ns = self.outbox.now_ns()
        self.outbox.send_past_link(status_message(self._prefix, status, now_ns))
