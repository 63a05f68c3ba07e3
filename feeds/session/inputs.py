"""What comes into a session from outside: telemetry, and commands for sensors and for the clock."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.messages.message import JSON, Message
from plotfeed.feeds.scene.changes import ChangeError
from plotfeed.feeds.scene.commands import ClockCommand, Command, ControlError, command_of, parsed
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.sensor_task import SensorTask
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver
from plotfeed.feeds.timing.clock import Clock, WallClock
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS


class SessionInputs:
    """Takes in what it understands; of anything else it tells in a line, and counts it."""

    def __init__(
        self,
        scene: Scene,
        trajectories: Trajectories,
        *,
        clock: Clock,
        totals: SessionCounters,
        observers: Sequence[Observer],
        desks: Mapping[str, SensorTask],
        tell: Callable[[Message], None],
    ) -> None:
        """Refusals go to `tell`, commands for sensors to `desks`."""
        self._intake = TelemetryReceiver(scene, trajectories)
        self._control_topic = f"{scene.mqtt.prefix}/control"
        self._trajectories = trajectories
        self._clock = clock
        self._totals = totals
        self._observers = observers
        self._desks = desks
        self._tell = tell

    @property
    def topics(self) -> list[str]:
        """What there is to subscribe to."""
        return [self._intake.topic, self._control_topic]

    def take(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Take in telemetry or a command, as of that time."""
        for observer in self._observers:
            observer.took(topic, payload, content_type, t_utc_ns)
        if topic == self._control_topic:
            self._obey(payload, t_utc_ns)
            return
        refusal = self._intake.take(topic, payload, content_type, t_utc_ns)
        self._totals.telemetry = self._intake.taken
        self._totals.drones = len(self._trajectories.names)
        self._told(refusal)

    def overflowed(self, topic: str) -> None:
        """A message could not even wait to be taken in."""
        self._refuse(topic, Refused(Reason.FLOOD, "more than can be taken has come at once"))

    def ask(self, command: dict[str, Any], t_utc_ns: int) -> dict[str, Any]:
        """Do as asked, as of that time, and say what is in force; raises `PlotfeedError`.

        To whoever records the session it is a command like those that come in.
        """
        payload = json.dumps(command).encode()
        for observer in self._observers:
            observer.took(self._control_topic, payload, JSON, t_utc_ns)
        return self._control(command_of(command), t_utc_ns)

    def _control(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        if command.clock is not None:
            return self._control_clock(command.clock)
        desk = self._desks.get(command.sensor or "")
        if desk is None:
            known = ", ".join(self._desks)
            raise ControlError(f"sensor: there is no {command.sensor!r}; expected one of {known}")
        desk.control(None if command.reset else command.set, at_utc_ns)
        self._totals.controls += 1
        return {"sensor": desk.sensor.id, **desk.sensor.model_dump(mode="json", exclude_unset=True)}

    def _control_clock(self, command: ClockCommand) -> dict[str, Any]:
        clock = self._clock
        if not isinstance(clock, WallClock) or clock.is_real:
            raise ControlError("clock: real time cannot be held or hurried; run a simulated clock")
        if command.speed is not None:
            clock.set_speed(command.speed)
        if command.paused is not None:
            (clock.pause if command.paused else clock.resume)()
        if command.step_s is not None:
            clock.step(round(command.step_s * NS))
        self._totals.controls += 1
        return {"paused": clock.is_paused, "speed": clock.speed}

    def _obey(self, payload: bytes, at_utc_ns: int) -> None:
        """A command from the wire: done, or refused in a line."""
        try:
            self._control(parsed(payload), at_utc_ns)
        except (ControlError, ChangeError) as error:
            self._refuse(self._control_topic, Refused(Reason.CONTROL, str(error)))

    def _refuse(self, topic: str, refused: Refused) -> None:
        self._told(self._intake.refuse(topic, refused, self._clock.now_ns()))

    def _told(self, refusal: Message | None) -> None:
        self._totals.refused = self._intake.refused
        self._totals.last_refusal = self._intake.last_refusal
        if refusal is not None:
            self._tell(refusal)
