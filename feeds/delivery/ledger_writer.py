"""Entries of the ledger: what sectors truly were, and what became of their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate

import numpy as np

from plotfeed.feeds.delivery.delivery import SentTogether, Settled, records
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.models.state import Columns, Ints, Looks, Plots
from plotfeed.proto.content_types import protobuf_content_type
from plotfeed.proto.ledger_octets import MANY, LedgerOctets, ledger, sent_field
from plotfeed.proto.utc import iso_utc

CONTENT_TYPE = protobuf_content_type("plotfeed.v1.Ledger")

Kept = tuple[SectorReport, str, Settled]
"""A sector, its link's keys then in JSON, and what became of its messages."""


class LedgerWriter:
    """Makes entries of many sectors at once, which takes far less time than one by one."""

    def __init__(self, prefix: str, drones: Sequence[str]) -> None:
        """`drones` names them by index; they may become more. Entries are for {prefix}/truth."""
        self._prefix, self._topic = prefix, f"{prefix}/truth"
        self._octets = LedgerOctets(drones)

    def messages(self, kept: Sequence[Kept]) -> list[Message]:
        """An entry for each sector, in that order."""
        reports = [report for report, _, _ in kept]
        looks, plots = [r.looks for r in reports], [r.plots for r in reports]
        truths = self._octets.truths(
            Looks.joined(looks), _edges(looks), Plots.joined(plots), _edges(plots)
        )
        sent = self._sent([settled for _, _, settled in kept])
        times = {end_ns: iso_utc(end_ns) for end_ns in {r.sector.end_ns for r in reports}}
        found = []
        for (report, link, _), truth, messages in zip(kept, truths, sent, strict=True):
            sensor, sector = report.sensor, report.sector
            scan, index, end_ns = sector.scan, sector.index, sector.end_ns
            properties = (
                ("specversion", "1.0"),
                ("id", f"truth-{scan}-{index}"),
                ("source", f"{self._prefix}/{sensor}"),
                ("type", "plotfeed.truth"),
                ("time", times[end_ns]),
                ("sensor", sensor),
                ("scan", str(scan)),
                ("sector", str(index)),
            )
            found.append(
                Message(
                    topic=self._topic,
                    payload=ledger(sensor, scan, index, truth=truth, sent=messages, link=link),
                    content_type=CONTENT_TYPE,
                    due_utc_ns=end_ns,
                    properties=properties,
                )
            )
        return found

    def _sent(self, settled: Sequence[Settled]) -> Iterator[bytes]:
        """What became of the messages of each sector, as fields of its entry."""
        if len(settled) < MANY:
            yield from (b"".join(map(sent_field, records(each))) for each in settled)
            return
        together = [each for each in settled if isinstance(each, SentTogether)]
        messages = [message for each in together for message in each.messages]
        octets, ends = b"", [0]
        if messages:
            topics = [message.topic for message in messages]
            octets, places = self._octets.sent(
                topics,
                _ints([message.due_utc_ns for message in messages]),
                _ints([one.sent_utc_ns for one in together for _ in one.messages]),
                _ints([len(message.payload) for message in messages]),
                _ints([one.number + i for one in together for i in range(len(one.messages))]),
            )
            ends = places.tolist()
        first = 0
        for each in settled:
            if isinstance(each, SentTogether):
                after = first + len(each.messages)
                yield octets[ends[first] : ends[after]]
                first = after
            else:
                yield b"".join(map(sent_field, records(each)))


def _ints(values: list[int]) -> Ints:
    return np.array(values, np.int64)


def _edges(parts: Sequence[Columns]) -> Ints:
    return _ints([0, *accumulate(map(len, parts))])
