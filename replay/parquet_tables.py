"""Tables in Parquet for those who compute: plots, truths, looks, tracks, messages, fates; written.

Needs pyarrow, the extra `parquet`. Angles are degrees, lengths metres, times UTC to the nanosecond;
null is what was not told. Text is as it came: no spreadsheet opens such a file.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from functools import partial
from typing import Any, BinaryIO, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import LEDGER, LEDGER_BATCH, TRACK_BATCH, message_type
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.measured_plots import ABSENT, MeasuredPlots
from plotfeed.replay.plots_csv import COLUMNS, Selection, plots_in, table_of
from plotfeed.replay.recorded import PLOT_TABLES, Recorded, RecordingWriter, TableName

GROUP_ROWS = 1 << 16
GROUP_OCTETS = 32 << 20  # Of payloads: what is held before a group of rows is written
TIME = pa.timestamp("ns", tz="UTC")
WHOLE, REAL, TEXT, TRUTH = pa.int64(), pa.float64(), pa.string(), pa.bool_()
MOST_NS = (1 << 63) - 1
Row = dict[str, Any]


_KINDS = {"f": REAL, "i": WHOLE, "O": TEXT}
_PLOT_FIELDS = {
    **dict.fromkeys(COLUMNS, REAL),
    **{name: _KINDS[absent.dtype.kind] for name, absent in ABSENT.items() if name in COLUMNS},
    "time_utc": TIME,
    "topic": TEXT,
    "log_time_utc": TIME,
}
_LIST = pa.list_(TEXT)
_TYPES = {int: WHOLE, float: REAL, str: TEXT, bool: TRUTH}


def _columns(message: Any, names: str, **others: pa.DataType) -> Mapping[str, pa.DataType]:
    """Columns that are called as fields of a message are, times without `_ns`; and others."""
    fields = message.DESCRIPTOR.fields_by_name
    found = {"sensor": TEXT, "scan": WHOLE, "sector": WHOLE}
    for name in names.split():
        is_time = name.endswith("_utc")
        kind = TIME if is_time else others.get(name) or _TYPES[type(fields[name].default_value)]
        found[name] = kind
    return found


# Columns of each table, in their order.
FIELDS: Mapping[TableName, Mapping[str, pa.DataType]] = {
    **dict.fromkeys(PLOT_TABLES, _PLOT_FIELDS),
    TableName.TRUTHS: _columns(
        pb.PlotTruth,
        "plot drone time_utc range_m azimuth_deg elevation_deg range_rate_m_s merged_drones",
        plot=WHOLE,
        merged_drones=_LIST,
    ),
    TableName.LOOKS: _columns(
        pb.Look,
        "drone time_utc emitted_utc range_m azimuth_deg elevation_deg snr_db pd detected channel",
    ),
    TableName.TRACKS: _columns(
        pb.Track,
        "kind id number time_utc latitude_deg longitude_deg height_m velocity_east_m_s "
        "velocity_north_m_s climb_m_s age_s sigma_east_m sigma_north_m sigma_up_m "
        "sigma_velocity_east_m_s sigma_velocity_north_m_s sigma_climb_m_s coasted first last "
        "log_time_utc",
        kind=TEXT,
    ),
    TableName.MESSAGES: {
        "log_time_utc": TIME,
        "publish_time_utc": TIME,
        "topic": TEXT,
        "content_type": TEXT,
        "stage": TEXT,
        "qos": WHOLE,
        "retain": TRUTH,
        "octets": WHOLE,
        "payload": pa.binary(),
    },
    TableName.FATES: _columns(
        pb.Sent,
        "topic fate due_utc link_due_utc sent_utc octets number copy flipped_bit not_to",
        fate=TEXT,
        not_to=_LIST,
    ),
}


class ParquetWriter(RecordingWriter):
    """Rows of one table; a message that has none for it is left out."""

    def __init__(self, file: BinaryIO, table: TableName, select: Selection | None = None) -> None:
        """`select` says which plots of a message a table of them takes; without it, all."""
        self._schema = pa.schema(list(FIELDS[table].items()))
        self._table = table
        self._rows_of = _ROWS_OF.get(table) or partial(_plot_rows, select or plots_in)
        self._columns: dict[str, list[Any]] = {name: [] for name in FIELDS[table]}
        self._octets = 0
        self._file = pq.ParquetWriter(file, self._schema, compression="zstd")

    def write(self, message: Recorded) -> str | None:
        """Write the rows of a message, if any; why it cannot have any, or None."""
        rows = self._rows_of(message)
        if rows is None or isinstance(rows, str):
            return rows or f"no {self._table}"
        for row in rows:
            for name, column in self._columns.items():
                column.append(row.get(name))
        if self._table is TableName.MESSAGES:
            self._octets += len(message.payload)
        if len(next(iter(self._columns.values()))) >= GROUP_ROWS or self._octets >= GROUP_OCTETS:
            self._flush()
        return None

    def notes(self) -> list[str]:
        """What such a table is not."""
        others = ", ".join(name for name in TableName if name is not self._table)
        return [f"it holds the table {self._table}, and is not read back; others: {others}"]

    def close(self) -> None:
        """Write the last rows and the index."""
        self._flush()
        self._file.close()

    def _flush(self) -> None:
        if next(iter(self._columns.values())):
            self._file.write_table(pa.table(self._columns, schema=self._schema))
        self._columns = {name: [] for name in self._columns}
        self._octets = 0


def _plot_rows(select: Selection, message: Recorded) -> Iterable[Row] | str | None:
    found = select(message)
    if not isinstance(found, MeasuredPlots):
        return found
    columns = table_of(found, message.topic)
    columns["time_utc"] = list(map(_ns, columns["time_utc"]))
    columns["log_time_utc"] = [_ns(message.log_time_ns)] * len(found)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _ns(t_utc_ns: int | None) -> int | None:
    """A time, if a table can hold it and it was told."""
    return t_utc_ns if t_utc_ns is not None and 0 < t_utc_ns <= MOST_NS else None


M = TypeVar("M", pb.Ledger, pb.TrackBatch)


def _rows_in(
    kinds: Container[str],
    topic_end: str,
    read: Callable[[bytes], Iterable[M]],
    table: TableName,
    told: Callable[[M], Iterable[tuple[Any, Row]]],
) -> Callable[[Recorded], Iterable[Row] | None]:
    """Rows of what messages of those kinds hold, each with what its fields do not say of it."""

    def rows(message: Recorded) -> Iterable[Row] | None:
        said = message_type(message.content_type)
        if said not in kinds and (said or not message.topic.endswith(topic_end)):
            return None
        found: list[Row] = []
        try:
            for of in read(message.payload):
                sector = {"sensor": of.sensor, "scan": of.scan, "sector": of.sector}
                sector["log_time_utc"] = _ns(message.log_time_ns)
                found += [_row(each, table, sector | more) for each, more in told(of)]
        except Exception:  # noqa: BLE001 - of protobuf's own, in each of its implementations
            return None
        return found

    return rows


def _row(message: Any, table: TableName, row: Row) -> Row:
    """The row with the fields that columns are called after; those that are absent left out."""
    may_lack = {field.name for field in message.DESCRIPTOR.fields if field.has_presence}
    for name, kind in FIELDS[table].items():
        if name in row:
            continue
        if kind is TIME:
            row[name] = _ns(getattr(message, f"{name}_ns"))
        elif name not in may_lack or message.HasField(name):
            value = getattr(message, name)
            row[name] = list(value) if kind is _LIST else value
    return row


def _message_rows(message: Recorded) -> Iterable[Row]:
    told = {
        "log_time_utc": _ns(message.log_time_ns),
        "publish_time_utc": _ns(message.publish_time_ns),
        "content_type": message.content_type or None,
        "stage": str(message.stage),
        "octets": len(message.payload),
    }
    return [message._asdict() | told]


_OF_LEDGER = partial(_rows_in, (LEDGER, LEDGER_BATCH), "/truth", entries_in)
_ROWS_OF: Mapping[TableName, Callable[[Recorded], Iterable[Row] | None]] = {
    TableName.TRUTHS: _OF_LEDGER(
        TableName.TRUTHS,
        lambda said: [(p, {"plot": n, "drone": p.drone or None}) for n, p in enumerate(said.plots)],
    ),
    TableName.LOOKS: _OF_LEDGER(TableName.LOOKS, lambda said: [(each, {}) for each in said.looks]),
    TableName.TRACKS: _rows_in(
        (TRACK_BATCH,),
        "/tracks",
        lambda payload: [pb.TrackBatch.FromString(payload)],
        TableName.TRACKS,
        lambda said: [(t, {"kind": pb.TrackKind.Name(said.kind).lower()}) for t in said.tracks],
    ),
    TableName.MESSAGES: _message_rows,
    TableName.FATES: _OF_LEDGER(
        TableName.FATES,
        lambda said: [(sent, {"fate": pb.Fate.Name(sent.fate)}) for sent in said.messages],
    ),
}
