"""Entries of the ledger as columns: the one place where what an entry holds becomes arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any, Self

import numpy as np
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.models.state import Bools, Columns, Floats, Ints, Texts
from plotfeed.proto import plotfeed_pb2 as pb


@dataclass(frozen=True, kw_only=True)
class ToldLooks(Columns):
    """Looks, (n,), in the order of their entries; `emitted_utc_ns` is 0 where it is not told."""

    entry: Ints
    drone: Texts
    other: Texts
    t_utc_ns: Ints
    emitted_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    snr_db: Floats
    pd: Floats
    detected: Bools
    channel: Ints


@dataclass(frozen=True, kw_only=True)
class ToldPlots(Columns):
    """What is true of plots, (n,), in the order of their entries; NaN for what is not told."""

    entry: Ints
    drone: Texts
    other: Texts
    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    range_rate_m_s: Floats
    merged_drones: Texts
    """Tuples of names."""


@dataclass(frozen=True, kw_only=True)
class ToldMessages(Columns):
    """What became of messages, (n,)."""

    entry: Ints
    topic: Texts
    due_utc_ns: Ints
    link_due_utc_ns: Ints
    sent_utc_ns: Ints
    octets: Ints
    delivered: Bools
    fate: Ints
    number: Ints
    copy: Ints
    flipped_bit: Ints
    """-1 for none."""
    not_to: Texts
    """Tuples of names."""


@dataclass(frozen=True, kw_only=True)
class ToldEntries(Columns):
    """Entries, (n,): the sectors of a sensor; `payload` is the number of the message it was in."""

    payload: Ints
    sensor: Texts
    scan: Ints
    sector: Ints
    link: Texts
    """JSON of the link's keys, empty for none."""


@dataclass(frozen=True, slots=True)
class LedgerTables:
    """Entries of a ledger and, by their numbers in these, what they tell."""

    entries: ToldEntries
    looks: ToldLooks
    plots: ToldPlots
    messages: ToldMessages

    def __len__(self) -> int:
        return len(self.entries)

    def of(self, which: Ints) -> Self:
        """The entries at ascending indices, numbered anew."""
        if len(which) == len(self):
            return self
        anew = np.full(len(self), -1)
        anew[which] = np.arange(len(which))

        def kept(table: Any) -> Any:
            entry = anew[table.entry]
            return table.but(entry=entry).rows(entry >= 0)

        tables = (kept(table) for table in (self.looks, self.plots, self.messages))
        return type(self)(self.entries.rows(which), *tables)


def tables_of(payloads: Iterable[bytes]) -> LedgerTables:
    """What ledgers hold, in their order; of what is no ledger there is no entry."""
    entries: list[pb.Ledger] = []
    numbers: list[int] = []
    for number, payload in enumerate(payloads):
        try:
            entries.append(pb.Ledger.FromString(payload))
        except ProtobufDecodeError:
            continue
        numbers.append(number)
    looks, of_looks = _rows([entry.looks for entry in entries])
    plots, of_plots = _rows([entry.plots for entry in entries])
    sent, of_sent = _rows([entry.messages for entry in entries])
    return LedgerTables(
        ToldEntries(
            payload=np.array(numbers, np.int64),
            sensor=_objects(entry.sensor for entry in entries),
            scan=_ints(entries, "scan"),
            sector=_ints(entries, "sector"),
            link=_objects(entry.link for entry in entries),
        ),
        ToldLooks(
            entry=of_looks,
            drone=_objects(look.drone for look in looks),
            other=_objects(look.other for look in looks),
            t_utc_ns=_ints(looks, "time_utc_ns"),
            emitted_utc_ns=_ints(looks, "emitted_utc_ns"),
            snr_db=_reals(looks, "snr_db"),
            pd=_reals(looks, "pd"),
            detected=np.fromiter(map(attrgetter("detected"), looks), np.bool_, len(looks)),
            channel=_ints(looks, "channel"),
            **{name: _reals(looks, name) for name in GEOMETRY},
        ),
        ToldPlots(
            entry=of_plots,
            drone=_objects(plot.drone for plot in plots),
            other=_objects(plot.other for plot in plots),
            t_utc_ns=_ints(plots, "time_utc_ns"),
            merged_drones=_objects(tuple(plot.merged_drones) for plot in plots),
            **{name: _if_told(plots, name) for name in (*GEOMETRY, "range_rate_m_s")},
        ),
        ToldMessages(
            entry=of_sent,
            topic=_objects(one.topic for one in sent),
            delivered=np.fromiter(map(attrgetter("delivered"), sent), np.bool_, len(sent)),
            flipped_bit=np.array(
                [one.flipped_bit if one.HasField("flipped_bit") else -1 for one in sent], np.int64
            ),
            not_to=_objects(tuple(one.not_to) for one in sent),
            **{name: _ints(sent, name) for name in OF_SENT},
        ),
    )


GEOMETRY = ("range_m", "azimuth_deg", "elevation_deg")
OF_SENT = ("due_utc_ns", "link_due_utc_ns", "sent_utc_ns", "octets", "fate", "number", "copy")


def _rows(parts: Sequence[Any]) -> tuple[list[Any], Ints]:
    """All rows, and the number of the entry that each is of."""
    lengths = np.fromiter(map(len, parts), np.int64, len(parts))
    return list(chain.from_iterable(parts)), np.repeat(np.arange(len(parts)), lengths)


def _ints(rows: Sequence[Any], name: str) -> Ints:
    return np.fromiter(map(attrgetter(name), rows), np.int64, len(rows))


def _reals(rows: Sequence[Any], name: str) -> Floats:
    return np.fromiter(map(attrgetter(name), rows), np.float64, len(rows))


def _if_told(rows: Sequence[Any], name: str) -> Floats:
    told = [getattr(row, name) if row.HasField(name) else np.nan for row in rows]
    return np.array(told, np.float64)


def _objects(values: Iterable[Any]) -> Texts:
    held = list(values)
    column = np.empty(len(held), np.object_)
    column[:] = held
    return column
