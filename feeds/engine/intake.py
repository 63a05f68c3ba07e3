"""What has come in for an engine and waits: telemetry, topic after topic in turn, and commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import ChangeError, Command, ControlError
from plotfeed.feeds.scene.report_formats import CUE_TOPIC
from plotfeed.feeds.scene.sensors.mount_keys import CueError
from plotfeed.feeds.telemetry.fair_queue import FairQueue, Turn
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.proto.content_types import PROTOBUF

if TYPE_CHECKING:
    from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports

Input = tuple[str, bytes, str | None]  # Topic, payload and content type of what came in
# Told of an input, and as of when it was taken in.
Received = Callable[[str, bytes, str | None, int], object]

# Ends of topics on which changes are asked for; on others, sensors answer.
CHANGING = ("/control", f"/{CUE_TOPIC}")
# Messages that are taken in together before it is asked whether there is time for more.
AT_ONCE = 128
MAX_COMMANDS = 1_000  # That wait
MAX_REFUSED_BEFORE = 1_000  # Drones and reasons that are told apart between two ticks


class Intake:
    """Has an engine take in what it understands; all else is refused in a line, and counted."""

    def __init__(
        self,
        engine: Engine,
        totals: SessionCounters,
        publish: Callable[[Message], object],
        *,
        received: Sequence[Received] = (),
        obeyed: Callable[[Command, int], object] = lambda *_: None,
        mapped: MappedReports | None = None,
        others: frozenset[str] = frozenset(),
        leads: bool = True,
    ) -> None:
        """Refusals are published by `publish`.

        `received` are told of all that is taken in, `obeyed` of each command that was done, from
        when on. `mapped` makes reports of what other systems publish. `others` are sensors of which
        other engines hear the same, and answer what is asked of them; of what is refused the one
        that `leads` tells.
        """
        self._others, self._leads = others, leads
        self._reports = FairQueue()
        self._commands = FairQueue(MAX_COMMANDS, limit_of_topic=MAX_COMMANDS)
        self._commands.know(engine.control_topic)  # whatever sensors are asked meanwhile
        self._engine, self._telemetry = engine, engine.telemetry
        self._telemetry.welcome = self._reports.know
        self._telemetry.part_with = self._reports.forget
        self._totals, self._publish = totals, publish
        self._received, self._obeyed, self._mapped = received, obeyed, mapped
        self._root = engine.telemetry.topic.removesuffix("+")
        self._refused_before: dict[tuple[str, str], tuple[Refused, int]] = {}

    def __len__(self) -> int:
        """How many messages wait."""
        return len(self._reports) + len(self._commands)

    @property
    def given_up(self) -> int:
        """How many found no room, or gave way to later ones."""
        return self._reports.given_up + self._commands.given_up

    def queue(self, topic: str, payload: bytes, content_type: str | None) -> None:
        """Let wait what has come in, or drop it if too much of its topic waits already.

        Of mapped topics the content type is the UTC nanosecond at which it came.
        """
        queue = self._commands if self._engine.is_command(topic) else self._reports
        queue.put(topic, payload, content_type)

    def refuse_later(self, topic: str, refused: Refused) -> None:
        """Refuse at the next tick what a live source could not make a message of."""
        key = topic, refused.reason
        if key not in self._refused_before and len(self._refused_before) >= MAX_REFUSED_BEFORE:
            key = "", refused.reason
        _, number = self._refused_before.get(key, (refused, 0))
        self._refused_before[key] = refused, number + refused.count

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
                turns = self._reports.take(AT_ONCE)
                if self._mapped is not None:
                    turns = self._as_drones(self._mapped, turns, as_of_ns)
                self._take_telemetry(turns, as_of_ns)
                is_enough = is_enough or until()
            if is_enough:
                break
        for queue in (self._commands, self._reports):
            for topic, number in queue.dropped.items():  # what could not even wait
                refused = Refused(Reason.FLOOD, f"{number} more have come than can wait")
                self._refuse(topic, refused, as_of_ns, number)
                self._totals.flooded += number
            queue.dropped.clear()
        self._totals.intake_behind_s = max(self._reports.behind_s(), self._commands.behind_s())

    def keep_up(self, as_of_ns: int) -> None:
        """Forget drones of which nothing has come for long; tell what live sources refused."""
        self._telemetry.forget_gone(as_of_ns)
        self._count()
        for (topic, _), (refused, number) in self._refused_before.items():
            self._refuse(topic, refused, as_of_ns, number)
        self._refused_before.clear()

    def receive(self, inputs: Sequence[Input], as_of_ns: int) -> None:
        """Take in telemetry and commands together, as of that time, whatever else waits."""
        for topic, together in groupby(inputs, key=itemgetter(0)):
            turn = (topic, [(payload, content_type) for _, payload, content_type in together])
            is_command = self._engine.is_command(topic)
            (self._take_commands if is_command else self._take_telemetry)([turn], as_of_ns)

    def _tell(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        for received in self._received:
            for topic, waited in turns:
                for payload, content_type in waited:
                    received(topic, payload, content_type, as_of_ns)

    def _as_drones(self, mapped: MappedReports, turns: Sequence[Turn], as_of_ns: int) -> list[Turn]:
        """What has come as drones would have published it, of mapped topics by their mappings."""
        found = []
        for topic, waited in turns:
            for payload, content_type in waited:
                came_ns = int(content_type or 0) if mapped.maps(topic) else as_of_ns
                heard = mapped.hear(topic, payload, came_ns)
                if heard is None:
                    found.append((topic, [(payload, content_type)]))
                    continue
                self._reports.know(topic)
                of_drone = self._root + heard.drone if heard.drone else topic
                if isinstance(heard.said, Refused):
                    self.refuse_later(of_drone, heard.said)
                else:
                    found.append((of_drone, [(heard.said.to_protobuf(), PROTOBUF)]))
        return found

    def _take_telemetry(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        self._tell(turns, as_of_ns)
        for refusal in self._telemetry.take_together(turns, as_of_ns):
            if self._leads:
                self._publish(refusal)
        self._count()

    def _take_commands(self, turns: Sequence[Turn], as_of_ns: int) -> None:
        self._tell(turns, as_of_ns)
        engine = self._engine
        for topic, commands in turns:
            for payload, _ in commands:
                told = self._leads
                try:
                    if self._others:
                        sensor = engine.asked_of(topic, payload)
                        if sensor in self._others:
                            continue  # whose it is answers
                        told = told or sensor in engine.changes.layers
                    command = engine.command(topic, payload, as_of_ns)
                    if command is not None:
                        self._obeyed(command, as_of_ns)
                    self._totals.controls += topic.endswith(CHANGING)
                except (ControlError, ChangeError, CueError) as error:
                    refused = Refused(Reason.CONTROL, str(error))
                    self._refuse(topic, refused, as_of_ns, told=told)

    def _refuse(
        self, topic: str, refused: Refused, as_of_ns: int, number: int = 1, told: bool | None = None
    ) -> None:
        refusal = self._telemetry.refuse(topic, refused, as_of_ns, number)
        self._count()
        if refusal is not None and (self._leads if told is None else told):
            self._publish(refusal)

    def _count(self) -> None:
        """Count what telemetry has brought so far."""
        totals, telemetry = self._totals, self._telemetry
        totals.telemetry, totals.conflated = telemetry.taken, telemetry.conflated
        totals.late = telemetry.refusals[Reason.LATE]
        totals.drones = len(self._engine.trajectories)
        totals.forgotten = telemetry.forgotten
        totals.refused_by, totals.refused = telemetry.refusals, telemetry.refused
        totals.last_refusal = telemetry.last_refusal
