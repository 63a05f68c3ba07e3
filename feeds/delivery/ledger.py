"""The ledger: whose plot is whose and what became of a sector's messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from plotfeed.feeds.delivery.counters import ClientCounters, SessionCounters
from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.timing.clock import Clock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.batch import ledger
from plotfeed.proto.content_types import protobuf_content_type

OnComplete = Callable[[list[Delivery]], object]
"""Given all deliveries of an entry, each of them settled."""


class LedgerEntry:
    """Owns and counts the deliveries that tell of one thing, such as a sector."""

    __slots__ = ("_closed", "_counters", "_deliveries", "_on_complete", "_totals", "_unsettled")

    def __init__(
        self, counters: ClientCounters, totals: SessionCounters, on_complete: OnComplete | None
    ) -> None:
        self._counters = counters
        self._totals = totals
        self._on_complete = on_complete
        self._deliveries: list[Delivery] = []
        self._unsettled = 0
        self._closed = False

    def deliver(
        self, message: Message, clock: Clock, transports: int, number: int, copy: int = 0
    ) -> Delivery:
        """Another message, or another copy of one, that is on its way from now on."""
        delivery = Delivery(message, clock, transports, self, number=number, copy=copy)
        self._deliveries.append(delivery)
        self._unsettled += 1
        return delivery

    def settled(self, delivery: Delivery) -> None:
        """The fate of one of its deliveries is known."""
        self._counters.settle(delivery.fate, delivery.copy, delivery.lateness_ns)
        self._totals.settle(delivery.fate, delivery.copy, delivery.lateness_ns)
        self._unsettled -= 1
        if self._closed and not self._unsettled:
            self._complete()

    def close(self) -> None:
        """No more will come."""
        self._closed = True
        if not self._unsettled:
            self._complete()

    def _complete(self) -> None:
        deliveries, self._deliveries = self._deliveries, []
        if self._on_complete is not None:
            self._on_complete(deliveries)


def records(deliveries: Sequence[Delivery]) -> list[pb.Sent]:
    """What the ledger says of them, in the order in which they were handed to the link."""
    return [one.record() for one in sorted(deliveries, key=lambda one: (one.number, one.copy))]


CONTENT_TYPE = protobuf_content_type("plotfeed.v1.Ledger")


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
