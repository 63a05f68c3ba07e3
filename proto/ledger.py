"""The ledger as columns: written from structures of arrays, read into tables.

A message is a `LedgerBatch`, whose packed fields are NumPy's own octets. Recordings of earlier
versions have a `Ledger` a sector instead, a row for each look, plot and message: it is read too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from typing import Any, Self, TypeVar

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError as ProtobufDecodeError
from numpy.typing import NDArray

from plotfeed.models.state import (
    FALSE_ALARM,
    OTHER,
    Bools,
    Columns,
    Floats,
    Ints,
    Looks,
    Plots,
    Texts,
    endless,
)
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.ledger_pb2 import LedgerBatch, PlotColumns
from plotfeed.proto.units import decibels
from plotfeed.proto.varint import varint

# Of the octets of columns, as protobuf packs them; a boolean, or a number below 128, is one octet.
_DTYPES: Mapping[int, np.dtype[Any]] = {
    FieldDescriptor.TYPE_DOUBLE: np.dtype("<f8"),
    FieldDescriptor.TYPE_SFIXED64: np.dtype("<i8"),
    FieldDescriptor.TYPE_SFIXED32: np.dtype("<i4"),
    FieldDescriptor.TYPE_BOOL: np.dtype("?"),
    FieldDescriptor.TYPE_ENUM: np.dtype("u1"),
}
_LENGTH_DELIMITED = 2
UNREADABLE = (ProtobufDecodeError, ValueError)


def _tag(field: Any) -> bytes:
    return varint(field.number << 3 | _LENGTH_DELIMITED)


_PARTS: Mapping[str, tuple[bytes, Mapping[str, tuple[bytes, np.dtype[Any]]]]] = {
    part.name: (
        _tag(part),
        {field.name: (_tag(field), _DTYPES[field.type]) for field in part.message_type.fields},
    )
    for part in LedgerBatch.DESCRIPTOR.fields
    if part.message_type is not None and not part.is_repeated
}

C = TypeVar("C", bound=Columns)
# Columns by the names of their fields; None for one that is left out.
Written = Mapping[str, NDArray[Any] | Sequence[int] | None]


def ledger_octets(
    texts: Mapping[str, Iterable[str]], parts: Mapping[str, Written], claims: Sequence[pb.Claim]
) -> bytes:
    """A serialised `LedgerBatch` of those lists of texts and those columns, by field."""
    lists: dict[str, Any] = {**texts, "claims": claims}
    octets = [LedgerBatch(**lists).SerializeToString()]
    for name, columns in parts.items():
        tag, fields = _PARTS[name]
        packed: list[bytes] = []
        for field, column in columns.items():
            if column is not None and len(column):
                field_tag, dtype = fields[field]
                data = np.ascontiguousarray(column, dtype).tobytes()
                packed += (field_tag, varint(len(data)), data)
        part = b"".join(packed)
        octets += (tag, varint(len(part)), part)
    return b"".join(octets)


def places_of(names: Sequence[str], *columns: Ints) -> tuple[list[str], Ints]:
    """The names at the places in some columns, each once, and where each of all stands among them.

    The latter is (n+1,), so that the place -1 stays -1.
    """
    is_used = np.zeros(len(names) + 1, np.bool_)
    for column in columns:
        is_used[column] = True
    is_used[-1] = False
    used = np.flatnonzero(is_used)
    place = np.full(len(is_used), -1)
    place[used] = np.arange(len(used))
    return [names[i] for i in used.tolist()], place


def truth_columns(
    looks: Looks, plots: Plots, names: Sequence[str]
) -> tuple[list[str], dict[str, Written]]:
    """Columns of looks and of what is true of plots, and the names that they point at."""
    merged = [] if plots.merged_drones is None else plots.merged_drones.tolist()
    of_merged = np.array([*chain.from_iterable(merged)], np.int64)
    targets, place = places_of(names, looks.drone, plots.drone, of_merged)
    of_looks = {
        "target": place[looks.drone],
        "time_utc_ns": looks.t_utc_ns,
        "range_m": looks.range_m,
        "azimuth_deg": looks.azimuth_deg,
        "elevation_deg": looks.elevation_deg,
        "snr_db": decibels(looks.snr),
        "pd": looks.pd,
        "detected": looks.detected,
        "channel": looks.channel if looks.channel.any() else None,
        "emitted_utc_ns": looks.emitted_utc_ns,
    }
    is_caused = plots.drone != FALSE_ALARM
    of_plots = {
        "target": place[plots.drone],
        "time_utc_ns": plots.t_utc_ns,
        "range_m": np.where(is_caused, plots.true_range_m, np.nan),
        "azimuth_deg": np.where(is_caused, plots.true_azimuth_deg, np.nan),
        "elevation_deg": np.where(is_caused, plots.true_elevation_deg, np.nan),
        "range_rate_m_s": plots.true_range_rate_m_s,
        "merged_plot": np.repeat(np.arange(len(merged)), [*map(len, merged)]) if merged else None,
        "merged_target": place[of_merged],
    }
    return targets, {"looks": of_looks, "plots": of_plots}


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
    """What is true of plots, (n,), in the order of their entries; NaN for what is not told.

    `merged_drones` has tuples of names.
    """

    entry: Ints
    drone: Texts
    other: Texts
    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    range_rate_m_s: Floats
    merged_drones: Texts


@dataclass(frozen=True, kw_only=True)
class ToldMessages(Columns):
    """What became of messages, (n,); `flipped_bit` is -1 for none, `not_to` has tuples of names."""

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
    not_to: Texts


@dataclass(frozen=True, kw_only=True)
class ToldEntries(Columns):
    """Entries, (n,): the sectors of a sensor; `payload` is the number of the message it was in.

    `link` is JSON of the link's keys, empty for none.
    """

    payload: Ints
    sensor: Texts
    scan: Ints
    sector: Ints
    link: Texts


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

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All entries of the parts, at least one, in their order."""
        if len(parts) == 1:
            return parts[0]
        firsts = np.cumsum([0, *map(len, parts[:-1])]).tolist()

        def all_of(name: str) -> Any:
            tables = [getattr(part, name) for part in parts]
            moved = [t.but(entry=t.entry + n) for t, n in zip(tables, firsts, strict=True)]
            return type(tables[0]).joined(moved)

        entries = ToldEntries.joined([part.entries for part in parts])
        return cls(entries, all_of("looks"), all_of("plots"), all_of("messages"))


def tables_of(payloads: Iterable[bytes]) -> LedgerTables:
    """What messages of the ledger hold, in their order; of what is none there is no entry."""
    parts: list[LedgerTables] = []
    old: list[tuple[int, pb.Ledger]] = []
    for number, payload in enumerate(payloads):
        try:
            batch = LedgerBatch.FromString(payload)
            if not batch.HasField("sectors"):
                old.append((number, pb.Ledger.FromString(payload)))
                continue
            found = _tables_in(batch, number)
        except UNREADABLE:
            continue
        if old:
            parts.append(_tables_of_rows(old))
            old = []
        parts.append(found)
    if old or not parts:
        parts.append(_tables_of_rows(old))
    return LedgerTables.joined(parts)


def entries_in(payload: bytes) -> list[pb.Ledger]:
    """What a message of the ledger holds, as a `Ledger` for each sector; raises `DecodeError`."""
    try:
        batch = LedgerBatch.FromString(payload)
        if not batch.HasField("sectors"):
            return [pb.Ledger.FromString(payload)]
        told = _tables_in(batch, 0)
        n = len(told)
        of_claims = _of_sectors(batch.sectors.claims_end, n, len(batch.claims)).tolist()
    except UNREADABLE as error:
        raise DecodeError(f"no ledger: {error}") from None
    entries = [pb.Ledger(**row) for row in rows_told(told.entries, pb.Ledger)]
    for table, kind, name in (
        (told.looks, pb.Look, "looks"),
        (told.plots, pb.PlotTruth, "plots"),
        (told.messages, pb.Sent, "messages"),
    ):
        for entry, row in zip(table.entry.tolist(), rows_told(table, kind), strict=True):
            getattr(entries[entry], name).add(**row)
    for entry, claim in zip(of_claims, batch.claims, strict=True):
        entries[entry].claims.append(claim)
    return entries


def rows_told(table: Columns, kind: Any) -> Iterator[dict[str, Any]]:
    """What each row of a table tells in a message of that kind, by the names of its fields."""
    names = [name for name in vars(table) if name not in ("entry", "payload")]
    absent = [ABSENT.get((kind.DESCRIPTOR.name, name)) for name in names]
    for row in zip(*(vars(table)[name].tolist() for name in names), strict=True):
        yield {
            FIELDS.get(name, name): value
            for name, value, nothing in zip(names, row, absent, strict=True)
            if nothing is None or value == value != nothing  # noqa: PLR0124 - NaN is not
        }


def _tables_in(batch: LedgerBatch, number: int) -> LedgerTables:
    """The tables of a message with that number; raises `ValueError` where it contradicts itself."""
    of, looks, plots, sent = batch.sectors, batch.looks, batch.plots, batch.messages
    n, n_looks, n_plots = len(of.sensor), len(looks.target), len(plots.target)
    n_sent, n_missed = len(sent.topic), len(sent.missed_message)
    names = np.array([*batch.targets, ""], np.object_)
    is_other = np.array([OTHER in name for name in names.tolist()], np.bool_)
    drones, others = np.where(is_other, "", names), np.where(is_other, names, "")
    looked_at, caused_by = _places(looks.target, names), _places(plots.target, names)
    merged = names[_places(plots.merged_target, names)]
    missed = _texts(sent.missed_destination, batch.destinations, n_missed)
    due = "link_due_utc_ns" if sent.link_due_utc_ns else "due_utc_ns"
    return LedgerTables(
        _table(
            ToldEntries,
            of,
            n,
            payload=endless(number, np.int64)[:n],
            sensor=_texts(of.sensor, batch.sensors, n),
            link=_texts(of.link, batch.links, n),
        ),
        _table(
            ToldLooks,
            looks,
            n_looks,
            entry=_of_sectors(of.looks_end, n, n_looks),
            drone=drones[looked_at],
            other=others[looked_at],
        ),
        _table(
            ToldPlots,
            plots,
            n_plots,
            entry=_of_sectors(of.plots_end, n, n_plots),
            drone=drones[caused_by],
            other=others[caused_by],
            merged_drones=_tuples(n_plots, plots.merged_plot, merged),
        ),
        _table(
            ToldMessages,
            sent,
            n_sent,
            entry=_of_sectors(of.messages_end, n, n_sent),
            topic=_texts(sent.topic, batch.topics, n_sent),
            link_due_utc_ns=_column(sent, due, n_sent),
            delivered=_column(sent, "fate", n_sent) == pb.SENT,
            not_to=_tuples(n_sent, sent.missed_message, missed),
        ),
    )


_DTYPES_OF = {"Ints": np.int64, "Bools": np.bool_, "Floats": np.float64, "Texts": np.object_}
FIELDS = {
    "t_utc_ns": "time_utc_ns"
}  # Fields of messages that columns of tables have another name of
# What stands for a field that is left out; else it is 0.
ABSENT: Mapping[tuple[str, str], float] = {
    **{
        (message.DESCRIPTOR.name, name): np.nan
        for message in (PlotColumns, pb.PlotTruth)
        for name in ("range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s")
    },
    ("MessageColumns", "flipped_bit"): -1,
    ("Sent", "flipped_bit"): -1,
    ("Look", "emitted_utc_ns"): 0,
}


def _table(kind: type[C], part: Any, length: int, **known: NDArray[Any]) -> C:
    """A table of the columns of a part, so long, beside those that are known."""
    names = (each.name for each in fields(kind) if each.name not in known)
    return kind(**known, **{name: _column(part, name, length) for name in names})


def _column(part: Any, name: str, length: int) -> NDArray[Any]:
    """A column as tables have it; where it is left out, all of its rows are alike."""
    field = part.DESCRIPTOR.fields_by_name[FIELDS.get(name, name)]
    values = getattr(part, field.name)
    kinds = {FieldDescriptor.TYPE_DOUBLE: np.float64, FieldDescriptor.TYPE_BOOL: np.bool_}
    dtype = kinds.get(field.type, np.int64)
    if not values:
        return endless(ABSENT.get((part.DESCRIPTOR.name, name), 0), dtype)[:length]
    if len(values) != length:
        raise ValueError(f"{len(values)} of {field.name}, expected {length}")
    return np.asarray(values, dtype)


def _places(values: Sequence[int], texts: Texts) -> Ints:
    """Places in some texts, of which -1 is the last."""
    places = np.asarray(values, np.int64)
    if len(places) and not -1 <= places.min() <= places.max() < len(texts):
        raise ValueError(f"a place beyond {len(texts)} texts")
    return places


def _texts(values: Sequence[int], texts: Sequence[str], length: int) -> Texts:
    """The texts at so many places, empty at -1."""
    if len(values) != length:
        raise ValueError(f"{len(values)} places, expected {length}")
    held = np.array([*texts, ""], np.object_)
    return held[_places(values, held)]


def _of_sectors(ends: Sequence[int], sectors: int, rows: int) -> Ints:
    """The sector of each row."""
    until = np.asarray(ends, np.int64) if ends else np.zeros(sectors, np.int64)
    counts = until - np.concatenate([[0], until[:-1]])[: len(until)]
    if len(counts) != sectors or (counts < 0).any() or counts.sum() != rows:
        raise ValueError(f"expected ends of {rows} rows in {sectors} sectors")
    return np.repeat(np.arange(sectors), counts)


def _tuples(length: int, rows: Sequence[int], values: Texts) -> Texts:
    """The values of each row, as tuples."""
    if len(rows) != len(values) or (len(rows) and not 0 <= min(rows) <= max(rows) < length):
        raise ValueError("values of rows that are not there")
    if not rows:
        return endless((), np.object_)[:length]
    of_row: dict[int, list[str]] = {}
    for row, value in zip(rows, values.tolist(), strict=True):
        of_row.setdefault(row, []).append(value)
    column = np.empty(length, np.object_)
    column[:] = [tuple(of_row.get(row, ())) for row in range(length)]
    return column


def _tables_of_rows(numbered: Sequence[tuple[int, pb.Ledger]]) -> LedgerTables:
    """The tables of messages of earlier versions, by the numbers of these."""

    def table(kind: type[C], part: str) -> C:
        rows = [(i, row) for i, (_, entry) in enumerate(numbered) for row in getattr(entry, part)]
        return _table_of_rows(kind, [row for _, row in rows], entry=[i for i, _ in rows])

    entries = [entry for _, entry in numbered]
    return LedgerTables(
        _table_of_rows(ToldEntries, entries, payload=[number for number, _ in numbered]),
        table(ToldLooks, "looks"),
        table(ToldPlots, "plots"),
        table(ToldMessages, "messages"),
    )


def _table_of_rows(kind: type[C], rows: Sequence[Any], **known: Sequence[int]) -> C:
    """A table of what rows hold, beside the columns that are known."""
    columns: dict[str, NDArray[Any]] = {}
    for each in fields(kind):
        column = columns[each.name] = np.empty(len(rows), _DTYPES_OF[str(each.type)])
        column[:] = known.get(each.name) or [_told(row, each.name) for row in rows]
    return kind(**columns)


def _told(row: Any, name: str) -> Any:
    """What a row holds as a column's value."""
    field = row.DESCRIPTOR.fields_by_name[FIELDS.get(name, name)]
    if field.has_presence and not row.HasField(field.name):
        return ABSENT.get((row.DESCRIPTOR.name, name), 0)
    value = getattr(row, field.name)
    return tuple(value) if field.is_repeated else value
