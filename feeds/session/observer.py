"""Whoever follows a session from within: a recorder, a page, a test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from plotfeed.feeds.delivery.outbox import Tap
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.loop import RecordedInputs
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.feeds.session.session import Session


class Observer:
    """Follows a whole session from within; every method returns soon, and none raises.

    What an observer does not care for, it leaves as it is here.
    """

    def begun(self, session: Session) -> None:
        """It stands, and its time begins."""

    def ended(self) -> None:
        """It is over."""

    def report(self, report: SectorReport) -> None:
        """A sector is reported now."""

    def account(self, report: SectorReport, sent: Sequence[pb.Sent]) -> None:
        """That became of its messages."""

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""

    def took(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Telemetry or a command was taken in, as of that time."""

    def before(self, message: Message) -> None:
        """A sensor hands a message to its link."""

    def after(self, message: Message, sent_utc_ns: int) -> None:
        """A message leaves."""

    def ledger(self, message: Message) -> None:
        """The ledger of a sector is complete, whether it is published or not."""

    @property
    def wants_ledger(self) -> bool:
        """Whether it must be written for this one, even if it is not published."""
        return cares(self, "ledger") or cares(self, "account")


@dataclass(frozen=True, slots=True, kw_only=True)
class Extras:
    """What a run may have besides its scene."""

    tap: Tap | None = None
    """Sees every message as it leaves."""
    observers: Sequence[Observer] = ()
    recorded: Callable[[Session], RecordedInputs] | None = None
    """Telemetry of a recording, to be taken in again."""
    metrics_port: int | None = None
    """Where Prometheus finds metrics, on loopback."""


def cares(observer: Observer, method: str) -> bool:
    """Whether an observer has that method of its own."""
    return getattr(type(observer), method) is not getattr(Observer, method)
