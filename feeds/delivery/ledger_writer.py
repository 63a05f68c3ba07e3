"""Entries of the ledger: what sectors truly were, and what became of their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import TypeVar

import numpy as np

from plotfeed.feeds.delivery.delivery import SentTogether, Settled, records
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.models.state import Columns, Ints, Looks, Plots
from plotfeed.proto.content_types import LEDGER, protobuf_content_type
from plotfeed.proto.ledger_octets import MANY, LedgerOctets, ledger, sent_field
from plotfeed.proto.utc import iso_utc

CONTENT_TYPE = protobuf_content_type(LEDGER)

C = TypeVar("C", bound=Columns)

Kept = tuple[SectorReport, str, Settled]
"""A sector, its link's keys then in JSON, and what became of its messages."""


class LedgerWriter:
    """Makes entries of many sectors at once, which takes far less time than one by one."""

    def __init__(self, prefix: str) -> None:
        """Entries are for {prefix}/truth."""
        self._prefix, self._topic = prefix, f"{prefix}/truth"
        self._octets = LedgerOctets()

    def messages(self, kept: Sequence[Kept]) -> list[Message]:
        """An entry for each sector, in that order."""
        truths = self._truths([report for report, _, _ in kept])
        sent = self._sent([settled for _, _, settled in kept])
        times = {at: iso_utc(at) for at in {report.counts.due_utc_ns for report, _, _ in kept}}
        found = []
        for (report, link, _), truth, messages in zip(kept, truths, sent, strict=True):
            sensor, scan, end_ns = report.sensor, report.counts.scan, report.counts.due_utc_ns
            index = int(report.sighting.sectors.index[report.row])
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
                    payload=ledger(
                        sensor,
                        scan,
                        index,
                        truth=truth,
                        sent=messages,
                        link=link,
                        claims=report.claims,
                    ),
                    content_type=CONTENT_TYPE,
                    due_utc_ns=end_ns,
                    properties=properties,
                )
            )
        return found

    def _truths(self, reports: Sequence[SectorReport]) -> list[bytes]:
        """Looks and plots of each sector, as fields of its entry."""
        of_names: dict[int, list[int]] = {}
        for place, report in enumerate(reports):
            of_names.setdefault(id(report.sighting.names), []).append(place)
        if len(of_names) <= 1:
            return self._truths_by_names(reports)
        found = [b""] * len(reports)
        for places in of_names.values():  # some drones have been forgotten meanwhile
            truths = self._truths_by_names([reports[place] for place in places])
            for place, truth in zip(places, truths, strict=True):
                found[place] = truth
        return found

    def _truths_by_names(self, reports: Sequence[SectorReport]) -> list[bytes]:
        """Looks and plots as `_truths`, of sectors whose drones have the same names."""
        if not reports:
            return []
        places: dict[int, list[int]] = {}
        for place, report in enumerate(reports):
            places.setdefault(id(report.sighting), []).append(place)
        looks: list[Looks] = []
        plots: list[Plots] = []
        looks_in: list[int] = []
        plots_in: list[int] = []
        for together in places.values():
            sighting = reports[together[0]].sighting
            rows = _ints([reports[place].row for place in together])
            looks.append(_of_rows(sighting.looks, sighting.looks_by, rows, looks_in))
            plots.append(_of_rows(sighting.plots, sighting.plots_by, rows, plots_in))
        truths = self._octets.truths(
            Looks.joined(looks),
            _edges(looks_in),
            Plots.joined(plots),
            _edges(plots_in),
            names=reports[0].sighting.names,
        )
        in_order = [place for together in places.values() for place in together]
        found = [b""] * len(reports)
        for place, truth in zip(in_order, truths, strict=True):
            found[place] = truth
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


def _edges(lengths: list[int]) -> Ints:
    return _ints([0, *accumulate(lengths)])


def _of_rows(columns: C, by: Ints, rows: Ints, lengths: list[int]) -> C:
    """What sectors in those rows, at least one, have of the columns; how much each is noted."""
    first, after = by[rows], by[rows + 1]
    lengths += (after - first).tolist()
    if (first[1:] == after[:-1]).all():
        return columns.between(int(first[0]), int(after[-1]))
    return columns.rows(np.concatenate(list(map(np.arange, first, after))))
