"""What comes into a session from outside: telemetry, and commands for sensors and for the clock."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.formats import inboxes_of
from plotfeed.feeds.messages.bounded_queue import QueueStatistics
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import (
    ChangeError,
    ClockCommand,
    Command,
    ControlError,
    check_octets,
    command_of,
    parsed,
)
from plotfeed.feeds.scene.report_formats import CUE_TOPIC
from plotfeed.feeds.scene.sensors.mount_keys import CueError
from plotfeed.feeds.session.observer import Input, SessionContext, cares
from plotfeed.feeds.session.sensor_task import SensorTask
from plotfeed.feeds.telemetry.fair_queue import FairQueue, Turn
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS

AT_ONCE = 128
"""Messages that are taken in together before it is asked whether there is time for more."""
MAX_COMMANDS = 1_000
"""That wait."""
MAX_REFUSED_BEFORE = 1_000
"""Drones and reasons that are told apart between two ticks."""


class SessionInputs:
    """Takes in what it understands; anything else is refused in a line, and counted."""

    def __init__(
        self,
        context: SessionContext,
        engine: Engine,
        sensor_tasks: Mapping[str, SensorTask],
        publish: Callable[[Message], None],
        obey: Callable[[Command, int], dict[str, Any]],
        *,
        others: frozenset[str] = frozenset(),
        leads: bool = True,
    ) -> None:
        """Refusals are published by `publish`; `obey` does what commands ask, but for the clock.

        `others` are sensors of which other sessions hear the same, and answer what is asked of
        them; of what is refused the one that `leads` tells.
        """
        self._others, self._leads = others, leads
        self._reports = FairQueue()
        self._commands = FairQueue(MAX_COMMANDS, limit_of_topic=MAX_COMMANDS)
        self._engine, self._telemetry = engine, engine.telemetry
        self._telemetry.welcome, self._telemetry.part_with = (
            self._reports.know,
            self._reports.forget,
        )
        prefix = context.scene.mqtt.prefix
        self._control_topic = f"{prefix}/control"
        self._commands.know(self._control_topic)  # whatever sensors are asked meanwhile
        self._inboxes = inboxes_of(context.scene)
        every = [*self._inboxes, *engine.cue_topics]
        self._inbox_ends = tuple(sorted({_end_of(prefix, topic) for topic in every}))
        self._clock = context.clock
        self._totals = context.totals
        self._received = [o.received for o in context.observers if cares(o, "received")]
        self._obeyed = [o.obeyed for o in context.observers if cares(o, "obeyed")]
        self._sensor_tasks, self._obey_of_scene = sensor_tasks, obey
        self._publish = publish
        self._refused_before: dict[tuple[str, str], tuple[Refused, int]] = {}

    @property
    def topics(self) -> list[str]:
        """What there is to subscribe to."""
        prefix = self._control_topic.rpartition("/")[0]
        inboxes = [f"{prefix}/+{end}" for end in self._inbox_ends]
        return [self._telemetry.topic, self._control_topic, *inboxes]

    def __len__(self) -> int:
        """How many messages wait."""
        return len(self._reports) + len(self._commands)

    def statistics(self) -> QueueStatistics:
        """What has come in, and waits to be taken in."""
        reports, commands = self._reports.statistics(), self._commands.statistics()
        return QueueStatistics(
            **{name: getattr(reports, name) + getattr(commands, name) for name in reports.__slots__}
        )

    def behind_s(self) -> float:
        """How long the oldest message has waited, seconds; 0 if none waits."""
        return max(self._reports.behind_s(), self._commands.behind_s())

    def queue(self, topic: str, payload: bytes, content_type: str | None) -> None:
        """Let wait what has come in, or drop it if too much of its topic waits already."""
        queue = self._commands if self._is_command(topic) else self._reports
        queue.put(topic, payload, content_type)

    def refuse_later(self, topic: str, refused: Refused) -> None:
        """Refuse at the next tick what a live source could not make a message of."""
        key = topic, refused.reason
        if key not in self._refused_before and len(self._refused_before) >= MAX_REFUSED_BEFORE:
            key = "", refused.reason
        _, number = self._refused_before.get(key, (refused, 0))
        self._refused_before[key] = refused, number + 1

    def take_in(self, as_of_ns: int, until: Callable[[], bool]) -> None:
        """Take in what waits, as of that time: commands first, then topic after topic.

        Between some and the next, `until` is asked whether it is enough; the rest keeps its place.
        However many commands there are, some telemetry is taken in.
        """
        while len(self):
            is_enough = False
            if self._commands:
                self._take_commands([self._commands.take_one()], as_of_ns)
                is_enough = until()
            # Telemetry when all commands are done, or when there are more than there is time for.
            if self._reports and bool(self._commands) == is_enough:
                self._take_telemetry(self._reports.take(AT_ONCE), as_of_ns)
                is_enough = is_enough or until()
            if is_enough:
                break
        self._refuse_dropped(as_of_ns)
        self._totals.intake_behind_s = self.behind_s()

    def keep_up(self, as_of_ns: int) -> None:
        """Forget drones of which nothing has come for long; tell what live sources refused."""
        self._telemetry.forget_gone(as_of_ns)
        self._count_drones()
        for (topic, _), (refused, number) in self._refused_before.items():
            self._refuse(topic, refused, as_of_ns, number)
        self._refused_before.clear()

    def receive(self, inputs: Sequence[Input], as_of_ns: int) -> None:
        """Take in telemetry and commands together, as of that time, whatever else waits."""
        for topic, together in groupby(inputs, key=itemgetter(0)):
            turn = (topic, [(payload, content_type) for _, payload, content_type in together])
            take = self._take_commands if self._is_command(topic) else self._take_telemetry
            take([turn], as_of_ns)

    def _tell(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        for received in self._received:
            for topic, waited in turns:
                for payload, content_type in waited:
                    received(topic, payload, content_type, as_of_ns)

    def _take_telemetry(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        self._tell(turns, as_of_ns)
        for refusal in self._telemetry.take_together(turns, as_of_ns):
            if self._leads:
                self._publish(refusal)
        totals = self._totals
        totals.telemetry, totals.conflated = self._telemetry.taken, self._telemetry.conflated
        totals.late = self._telemetry.refusals[Reason.LATE]
        self._count_drones()
        self._count()

    def _take_commands(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        self._tell(turns, as_of_ns)
        for topic, commands in turns:
            if topic != self._control_topic and self._sensor_of(topic) in self._others:
                continue  # whose it is answers
            for payload, _ in commands:
                told = self._leads
                try:
                    if topic == self._control_topic:
                        command = parsed(payload)
                        if command.sensor in self._others:
                            continue
                        told = told or command.sensor in self._sensor_tasks
                        self._obey(command, as_of_ns)
                    elif topic.endswith(f"/{CUE_TOPIC}"):
                        self._engine.cue(topic, payload, as_of_ns)
                        self._totals.controls += 1
                    else:
                        self._ask(topic, payload, as_of_ns)
                except (ControlError, ChangeError, CueError) as error:
                    self._refuse(topic, Refused(Reason.CONTROL, str(error)), as_of_ns, told=told)

    def _is_command(self, topic: str) -> bool:
        return topic == self._control_topic or topic.endswith(self._inbox_ends)

    def _ask(self, topic: str, payload: bytes, as_of_ns: int) -> None:
        """Have a sensor answer what is asked of it in the words of a format."""
        sensor = self._inboxes.get(topic)
        if sensor is None:
            known = ", ".join(self._inboxes.values())
            raise ControlError(f"there is no sensor that takes this; expected one of {known}")
        check_octets(payload)
        self._sensor_tasks[sensor].asked(payload, as_of_ns)

    def _refuse_dropped(self, as_of_ns: int) -> None:
        """Count what could not even wait to be taken in, and tell of it by topic."""
        for queue in (self._commands, self._reports):
            for topic, number in queue.dropped.items():
                refused = Refused(Reason.FLOOD, f"{number} more have come than can wait")
                self._refuse(topic, refused, as_of_ns, number)
                self._totals.flooded += number
            queue.dropped.clear()

    def command(self, command: dict[str, Any], t_utc_ns: int) -> dict[str, Any]:
        """Do as asked, as of that time, and say what is in force; raises `PlotfeedError`.

        To whoever records the session it is a command like those that come in.
        """
        payload = json.dumps(command).encode()
        for received in self._received:
            received(self._control_topic, payload, JSON, t_utc_ns)
        return self._obey(command_of(command), t_utc_ns)

    def _obey(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        if command.clock is not None:
            in_force = self._control_clock(command.clock)
        else:
            in_force = self._obey_of_scene(command, at_utc_ns)
        for obeyed in self._obeyed:
            obeyed(command, at_utc_ns)
        self._totals.controls += 1
        return in_force

    def _control_clock(self, command: ClockCommand) -> dict[str, Any]:
        clock = self._clock
        if not isinstance(clock, WallClock) or clock.is_real or self._others:
            raise ControlError("clock: real time cannot be held or hurried; run a simulated clock")
        if command.speed is not None:
            clock.set_speed(command.speed)
        if command.paused is not None:
            (clock.pause if command.paused else clock.resume)()
        if command.step_s is not None:
            clock.step(round(command.step_s * NS))
        return {"paused": clock.is_paused, "speed": clock.speed}

    def _sensor_of(self, topic: str) -> str:
        return topic.removeprefix(self._control_topic.rpartition("/")[0] + "/").partition("/")[0]

    def _refuse(
        self,
        topic: str,
        refused: Refused,
        as_of_ns: int,
        number: int = 1,
        told: bool | None = None,
    ) -> None:
        refusal = self._telemetry.refuse(topic, refused, as_of_ns, number)
        self._count()
        if refusal is not None and (self._leads if told is None else told):
            self._publish(refusal)

    def _count_drones(self) -> None:
        self._totals.drones = len(self._engine.trajectories)
        self._totals.forgotten = self._telemetry.forgotten

    def _count(self) -> None:
        self._totals.refused_by = self._telemetry.refusals
        self._totals.refused = self._telemetry.refused
        self._totals.last_refusal = self._telemetry.last_refusal


def _end_of(prefix: str, topic: str) -> str:
    """A topic without prefix and sensor."""
    return "/" + topic.removeprefix(f"{prefix}/").partition("/")[2]
