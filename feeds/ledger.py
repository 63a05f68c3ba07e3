"""The ledger as messages: of a sector, whose plot is whose and what became of its messages."""

from __future__ import annotations

from collections.abc import Sequence

from plotfeed.feeds.cloud_events import attributes
from plotfeed.feeds.message import PROTOBUF, Message
from plotfeed.feeds.station import SectorReport
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.batch import ledger

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
