"""What comes into a session from outside: telemetry, and commands for sensors and for the clock."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import (
    ChangeError,
    ClockCommand,
    Command,
    ControlError,
    command_of,
    parsed,
)
from plotfeed.feeds.session.observer import SessionContext
from plotfeed.feeds.session.sensor_task import SensorTask
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.models.truth import Trajectories
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS


class SessionInputs:
    """Takes in what it understands; anything else is refused in a line, and counted."""

    def __init__(
        self,
        context: SessionContext,
        trajectories: Trajectories,
        sensor_tasks: Mapping[str, SensorTask],
        publish: Callable[[Message], None],
    ) -> None:
        """Refusals are published by `publish`."""
        self._telemetry = TelemetryReceiver(context.scene, trajectories)
        self._control_topic = f"{context.scene.mqtt.prefix}/control"
        self._trajectories = trajectories
        self._clock = context.clock
        self._totals = context.totals
        self._observers = context.observers
        self._sensor_tasks = sensor_tasks
        self._publish = publish

    @property
    def topics(self) -> list[str]:
        """What there is to subscribe to."""
        return [self._telemetry.topic, self._control_topic]

    def receive(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Take in telemetry or a command, as of that time."""
        for observer in self._observers:
            observer.received(topic, payload, content_type, t_utc_ns)
        if topic != self._control_topic:
            refusal = self._telemetry.take(topic, payload, content_type, t_utc_ns)
            self._totals.telemetry = self._telemetry.taken
            self._totals.drones = len(self._trajectories.names)
            self._count_refusals(refusal)
            return
        try:
            self._obey(parsed(payload), t_utc_ns)
        except (ControlError, ChangeError) as error:
            self._refuse(topic, Refused(Reason.CONTROL, str(error)))

    def refuse_for_want_of_room(self, topic: str) -> None:
        """A message could not even wait to be taken in."""
        self._refuse(topic, Refused(Reason.FLOOD, "more than can be taken has come at once"))

    def command(self, command: dict[str, Any], t_utc_ns: int) -> dict[str, Any]:
        """Do as asked, as of that time, and say what is in force; raises `PlotfeedError`.

        To whoever records the session it is a command like those that come in.
        """
        payload = json.dumps(command).encode()
        for observer in self._observers:
            observer.received(self._control_topic, payload, JSON, t_utc_ns)
        return self._obey(command_of(command), t_utc_ns)

    def _obey(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        if command.clock is not None:
            in_force = self._control_clock(command.clock)
        else:
            task = self._sensor_tasks.get(command.sensor or "")
            if task is None:
                known = ", ".join(self._sensor_tasks)
                raise ControlError(
                    f"sensor: there is no {command.sensor!r}; expected one of {known}"
                )
            task.control(None if command.reset else command.set, at_utc_ns)
            keys = task.sensor.model_dump(mode="json", exclude_unset=True)
            in_force = {"sensor": task.sensor.id, **keys}
        self._totals.controls += 1
        return in_force

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
        return {"paused": clock.is_paused, "speed": clock.speed}

    def _refuse(self, topic: str, refused: Refused) -> None:
        self._count_refusals(self._telemetry.refuse(topic, refused, self._clock.now_ns()))

    def _count_refusals(self, refusal: Message | None) -> None:
        self._totals.refused = self._telemetry.refused
        self._totals.last_refusal = self._telemetry.last_refusal
        if refusal is not None:
            self._publish(refusal)
