"""Whoever follows a session, as a recorder or a page does, and what its own parts share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.bounded_queue import QueueStatistics
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.story_keys import StoryState
from plotfeed.feeds.session.sensor_description import SensorDescriber
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.timing.schedule import Schedule
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.dwell_agenda import PointedBeams

Input = tuple[str, bytes, str | None]
"""Topic, payload and content type of what came in."""


class RunningSensor(Protocol):
    """What observers may see of a sensor at work."""

    @property
    def sensor(self) -> Sensor:
        """The sensor's keys as they are now."""

    @property
    def settings(self) -> Message:
        """The sensor's keys as they are now, as whoever comes later is told."""

    @property
    def description(self) -> Message:
        """What and where the sensor is and how it reports, as whoever comes later is told."""

    @property
    def status(self) -> pb.SensorStatus:
        """The sensor's status as it is now, but for its lateness."""

    @property
    def pointed(self) -> CuedState | PointedBeams | None:
        """Where its mount or beams pointed in the last scan; None where nothing turns."""


class RunningChanges(Protocol):
    """What observers may see of what was asked of a session."""

    @property
    def stories(self) -> Sequence[StoryState]:
        """What can happen at a word, and what has."""

    @property
    def undoes(self) -> str:
        """What would be undone next, in words; empty for nothing."""


class RunningSession(Protocol):
    """What observers may see of a session, and ask of it."""

    @property
    def scene(self) -> Scene:
        """What runs."""

    @property
    def clock(self) -> Clock:
        """The session's time."""

    @property
    def totals(self) -> SessionCounters:
        """Counts, which grow."""

    @property
    def trajectories(self) -> Trajectories:
        """Where its drones are."""

    @property
    def sensor_tasks(self) -> Mapping[str, RunningSensor]:
        """Sensors by their names."""

    @property
    def changes(self) -> RunningChanges:
        """What was asked of it."""

    @property
    def input_queue(self) -> QueueStatistics:
        """What has come in, and waits to be taken in."""

    def receive(self, inputs: Sequence[Input], t_utc_ns: int) -> None:
        """Take in telemetry and commands together, as of that time."""

    def command(self, command: dict[str, Any]) -> dict[str, Any]:
        """Do now what might have come in as a command, and say what is in force.

        Raises `PlotfeedError`.
        """


class Observer:
    """Follows a whole session from within; every method returns soon, and none raises.

    What an observer does not care for, it leaves as it is here.
    """

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""

    def ended(self) -> None:
        """The session is over."""

    def before_due(self, due_utc_ns: int) -> None:
        """What is due at that time is done next."""

    def next_input_ns(self) -> int | None:
        """Time as of which it hands in something next, before what is due then; None for never."""
        return None

    def report(self, batch: Batch) -> None:
        """A batch of one sector leaves now."""

    def settled(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """What became of the messages of a batch of one sector is known."""

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""

    def received(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Telemetry or a command was taken in, as of that time."""

    def tracked(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """The tracker under test published something, where the scene says that it does."""

    def obeyed(self, command: Command, t_utc_ns: int) -> None:
        """What a command asked for is in force, as of that time."""

    def before_link(self, message: Message) -> None:
        """A sensor hands a message to its link."""

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        """A message leaves."""

    def ledger(self, message: Message) -> None:
        """The ledger of a sector is complete, whether it is published or not."""

    @property
    def wants_ledger(self) -> bool:
        """Whether it must be written for this one, even if it is not published."""
        return cares(self, "ledger") or cares(self, "settled")


class Tap(Observer):
    """Calls a function with every message and the time at which it leaves."""

    def __init__(self, on_message: Callable[[Message, int], object]) -> None:
        self._on_message = on_message

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        """A message leaves."""
        self._on_message(message, sent_utc_ns)


def cares(observer: Observer, method: str) -> bool:
    """Whether an observer has that method of its own."""
    return getattr(type(observer), method) is not getattr(Observer, method)


KeepLedger = Callable[[Batch, int], None]
"""Given a batch and the row of a sector, when it is known what became of all its messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionContext:
    """A session's scene, its time, its counts, and who follows it."""

    scene: Scene
    clock: Clock
    schedule: Schedule
    totals: SessionCounters
    observers: Sequence[Observer]
    describer: SensorDescriber
    keep_ledger: KeepLedger | None
    """None where nobody is to have it."""

    @property
    def tracker_topics(self) -> Sequence[str]:
        """The topic of the tracker under test, a sensor's or a foreign one, if it is followed."""
        topic = self.scene.page.tracks_topic
        is_followed = any(cares(observer, "tracked") for observer in self.observers)
        return (topic,) if topic and is_followed else ()
