"""Entries of the ledger: what sectors truly were, and what became of their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from plotfeed.feeds.messages.batch import Batch, edges
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Outgoing, records
from plotfeed.models.state import Columns, Ints, Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import LEDGER, protobuf_content_type
from plotfeed.proto.ledger_octets import MANY, LedgerOctets, ledger, sent_field
from plotfeed.proto.utc import iso_utc

CONTENT_TYPE = protobuf_content_type(LEDGER)

C = TypeVar("C", bound=Columns)

Kept = tuple[Batch, int]
"""A sector by its batch and row, of whose messages it is known what became of them."""


class LedgerWriter:
    """Makes entries of many sectors at once, which takes far less time than one by one."""

    def __init__(self, prefix: str) -> None:
        """Entries are for {prefix}/truth."""
        self._prefix, self._topic = prefix, f"{prefix}/truth"
        self._octets = LedgerOctets()

    def messages(self, kept: Sequence[Kept]) -> list[Message]:
        """An entry for each sector, in that order."""
        truths = self._truths(kept)
        sent = self._sent([batch.messages[row] for batch, row in kept])
        times: dict[int, str] = {}
        found = []
        for (batch, row), truth, messages in zip(kept, truths, sent, strict=True):
            of = batch.sectors
            sensor, scan = batch.sensors[of.sensor[row]], int(of.scan[row])
            index, end_ns = int(of.index[row]), int(of.end_ns[row])
            properties = (
                ("specversion", "1.0"),
                ("id", f"truth-{scan}-{index}"),
                ("source", f"{self._prefix}/{sensor}"),
                ("type", "plotfeed.truth"),
                ("time", times.get(end_ns) or times.setdefault(end_ns, iso_utc(end_ns))),
                ("sensor", sensor),
                ("scan", str(scan)),
                ("sector", str(index)),
            )
            payload = ledger(
                sensor,
                scan,
                index,
                truth=truth,
                sent=messages,
                link=batch.links[row],
                claims=batch.claims or b"",
            )
            found.append(
                Message(
                    topic=self._topic,
                    payload=payload,
                    content_type=CONTENT_TYPE,
                    due_utc_ns=end_ns,
                    properties=properties,
                )
            )
        return found

    def _truths(self, sectors: Sequence[Kept]) -> list[bytes]:
        """Looks and plots of each sector, as fields of its entry."""
        # Together where drones have the same names: some may have been forgotten meanwhile.
        of_names: dict[int, dict[int, list[int]]] = {}
        for place, (batch, _) in enumerate(sectors):
            of_batch = of_names.setdefault(id(batch.names), {})
            of_batch.setdefault(id(batch), []).append(place)
        found = [b""] * len(sectors)
        for of_batch in of_names.values():
            looks: list[Looks] = []
            plots: list[Plots] = []
            looks_in: list[int] = []
            plots_in: list[int] = []
            for places in of_batch.values():
                batch = sectors[places[0]][0]
                rows = _ints([sectors[place][1] for place in places])
                looks.append(_of_rows(batch.looks, batch.of_looks, rows, looks_in))
                plots.append(_of_rows(batch.plots, batch.of_plots, rows, plots_in))
            truths = self._octets.truths(
                Looks.joined(looks),
                edges(_ints(looks_in)),
                Plots.joined(plots),
                edges(_ints(plots_in)),
                names=batch.names,
            )
            in_order = [place for places in of_batch.values() for place in places]
            for place, truth in zip(in_order, truths, strict=True):
                found[place] = truth
        return found

    def _sent(self, sectors: Sequence[Sequence[Outgoing]]) -> Iterator[bytes]:
        """What became of the messages of each sector, as fields of its entry."""
        if len(sectors) < MANY:
            yield from (b"".join(map(sent_field, records(each))) for each in sectors)
            return
        are_plain = [all(map(_is_plain, each)) for each in sectors]
        plain = [
            one for each, is_plain in zip(sectors, are_plain, strict=True) if is_plain
            for one in each
        ]  # fmt: skip
        octets, ends = b"", [0]
        if plain:
            octets, places = self._octets.sent(
                [one.message.topic for one in plain],
                _ints([one.due_utc_ns for one in plain]),
                _ints([one.sent_utc_ns for one in plain]),
                _ints([len(one.message.payload) for one in plain]),
                _ints([one.number for one in plain]),
            )
            ends = places.tolist()
        first = 0
        for each, is_plain in zip(sectors, are_plain, strict=True):
            if is_plain:
                after = first + len(each)
                yield octets[ends[first] : ends[after]]
                first = after
            else:
                yield b"".join(map(sent_field, records(each)))


def _is_plain(one: Outgoing) -> bool:
    """Whether it left its link as it was handed to it, at once, for all destinations."""
    return (
        one.fate == pb.SENT
        and one.due_utc_ns == one.handed.due_utc_ns
        and not (one.copy or one.not_to)
        and one.flipped_bit is None
    )


def _ints(values: list[int]) -> Ints:
    return np.array(values, np.int64)


def _of_rows(columns: C, by: Ints, rows: Ints, lengths: list[int]) -> C:
    """What sectors in those rows, at least one, have of the columns; how much each is noted."""
    first, after = by[rows], by[rows + 1]
    lengths += (after - first).tolist()
    if (first[1:] == after[:-1]).all():
        return columns.between(int(first[0]), int(after[-1]))
    return columns.rows(np.concatenate(list(map(np.arange, first, after))))
