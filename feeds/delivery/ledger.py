"""The ledger: whose plot is whose and what became of a sector's messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from plotfeed.feeds.messages.message import PROTOBUF, Message, attributes
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.batch import ledger


class Settled(Protocol):
    """A message, or a copy of one, of which it is known what became of it."""

    number: int
    copy: int

    def told(self) -> pb.Sent:
        """For the ledger."""


def told(settled: Sequence[Settled]) -> list[pb.Sent]:
    """What the ledger says of them, in the order in which they were handed to the link."""
    in_order = sorted(settled, key=lambda one: (one.number, one.copy))
    return [one.told() for one in in_order]


class LedgerEntry:
    """Collects what became of the messages that tell of one thing, such as a sector."""

    __slots__ = ("_closed", "_on_complete", "_settled", "_unsettled")

    def __init__(self, on_complete: Callable[[Sequence[Settled]], None]) -> None:
        self._settled: list[Settled] = []
        self._unsettled = 0
        self._closed = False
        self._on_complete = on_complete

    def expect(self) -> None:
        """Another message, or another copy of one, is on its way."""
        self._unsettled += 1

    def settle(self, settled: Settled) -> None:
        """It is known what became of one."""
        self._settled.append(settled)
        self._unsettled -= 1
        self._complete()

    def close(self) -> None:
        """No more will come."""
        self._closed = True
        self._complete()

    def _complete(self) -> None:
        if self._closed and not self._unsettled:
            self._on_complete(self._settled)


CONTENT_TYPE = f"{PROTOBUF}; messageType=plotfeed.v1.Ledger"


def ledger_message(
    prefix: str, report: SectorReport, drones: Sequence[str], sent: Sequence[pb.Sent], link: str
) -> Message:
    """An entry for {prefix}/truth; `drones` names them by index, `link` is its keys in JSON."""
    sector = report.sector
    return Message(
        topic=f"{prefix}/truth",
        payload=ledger(
            report.sensor,
            sector.scan,
            sector.index,
            looks=report.looks,
            plots=report.plots,
            drones=drones,
            sent=sent,
            link=link,
        ),
        content_type=CONTENT_TYPE,
        due_utc_ns=sector.end_ns,
        properties=attributes(
            f"{prefix}/{report.sensor}",
            "truth",
            f"{sector.scan}-{sector.index}",
            sector.end_ns,
            sensor=report.sensor,
            scan=sector.scan,
            sector=sector.index,
        ),
    )
