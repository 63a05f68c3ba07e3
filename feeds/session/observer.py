"""Whoever follows a session, as a recorder or a page does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.timing.clock import Clock
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.feeds.engine.change_control import ChangeControl
    from plotfeed.feeds.engine.intake import Intake
    from plotfeed.feeds.session.running_sensor import RunningSensor


class RunningSession(Protocol):
    """What observers may see of a session, and ask of it."""

    scene: Scene
    clock: Clock
    totals: SessionCounters
    trajectories: Trajectories
    sensors: Mapping[str, RunningSensor]
    changes: ChangeControl
    intake: Intake  # What has come in, and waits to be taken in; takes what observers hand in, too

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


class Tap(Observer):
    """Calls a function with every message and the time at which it leaves."""

    def __init__(self, on_message: Callable[[Message, int], object]) -> None:
        self._on_message = on_message

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        """A message leaves."""
        self._on_message(message, sent_utc_ns)


def who_care(observers: Sequence[Observer], method: str) -> list[Callable[..., Any]]:
    """The bound methods of that name, of all observers that have it of their own."""
    usual = getattr(Observer, method)
    return [getattr(each, method) for each in observers if getattr(type(each), method) is not usual]
