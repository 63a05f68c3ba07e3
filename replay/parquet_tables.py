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


_OF_SECTOR = {"sensor": TEXT, "scan": WHOLE, "sector": WHOLE}
_GEOMETRY = dict.fromkeys(("range_m", "azimuth_deg", "elevation_deg"), REAL)


_TRACK_REALS = (
    *("latitude_deg", "longitude_deg", "height_m"),
    *("velocity_east_m_s", "velocity_north_m_s", "climb_m_s", "age_s"),
    *("sigma_east_m", "sigma_north_m", "sigma_up_m"),
    *("sigma_velocity_east_m_s", "sigma_velocity_north_m_s", "sigma_climb_m_s"),
)
_TRACK_FLAGS = ("coasted", "first", "last")


_KINDS = {"f": REAL, "i": WHOLE, "O": TEXT}
_PLOT_FIELDS = {
    **dict.fromkeys(COLUMNS, REAL),
    **{name: _KINDS[absent.dtype.kind] for name, absent in ABSENT.items() if name in COLUMNS},
    "time_utc": TIME,
    "topic": TEXT,
    "log_time_utc": TIME,
}
# Columns of each table, in their order.
FIELDS: Mapping[TableName, Mapping[str, pa.DataType]] = {
    **dict.fromkeys(PLOT_TABLES, _PLOT_FIELDS),
    TableName.TRUTHS: {
        **_OF_SECTOR,
        "plot": WHOLE,
        "drone": TEXT,
        "time_utc": TIME,
        **_GEOMETRY,
        "range_rate_m_s": REAL,
        "merged_drones": pa.list_(TEXT),
    },
    TableName.LOOKS: {
        **_OF_SECTOR,
        "drone": TEXT,
        "time_utc": TIME,
        "emitted_utc": TIME,
        **_GEOMETRY,
        "snr_db": REAL,
        "pd": REAL,
        "detected": TRUTH,
        "channel": WHOLE,
    },
    TableName.TRACKS: {
        **_OF_SECTOR,
        "kind": TEXT,
        "id": TEXT,
        "number": WHOLE,
        "time_utc": TIME,
        **dict.fromkeys(_TRACK_REALS, REAL),
        **dict.fromkeys(_TRACK_FLAGS, TRUTH),
        "log_time_utc": TIME,
    },
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
    TableName.FATES: {
        **_OF_SECTOR,
        "topic": TEXT,
        "fate": TEXT,
        "due_utc": TIME,
        "link_due_utc": TIME,
        "sent_utc": TIME,
        "octets": WHOLE,
        "number": WHOLE,
        "copy": WHOLE,
        "flipped_bit": WHOLE,
        "not_to": pa.list_(TEXT),
    },
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
        return [f"it holds the table {self._table}, and is not read back; --table: {others}"]

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
    rows_of: Callable[[M, Row], Iterable[Row]],
) -> Callable[[Recorded], Iterable[Row] | None]:
    """Rows of what messages of those kinds say, by the sector that they say it of."""

    def rows(message: Recorded) -> Iterable[Row] | None:
        said = message_type(message.content_type)
        if said not in kinds and (said or not message.topic.endswith(topic_end)):
            return None
        try:
            return [
                row
                for found in read(message.payload)
                for row in rows_of(
                    found, {"sensor": found.sensor, "scan": found.scan, "sector": found.sector}
                )
            ]
        except Exception:  # noqa: BLE001 - of protobuf's own, in each of its implementations
            return None

    return rows


def _fields(message: Any, names: Iterable[str]) -> Row:
    """Fields by name, those that are absent left out."""
    told = {field.name for field in message.DESCRIPTOR.fields if field.has_presence}
    return {n: getattr(message, n) for n in names if n not in told or message.HasField(n)}


def _look_rows(ledger: pb.Ledger, of: Row) -> Iterable[Row]:
    names = ("drone", *_GEOMETRY, "snr_db", "pd", "detected", "channel")
    for look in ledger.looks:
        times = {"time_utc": _ns(look.time_utc_ns), "emitted_utc": _ns(look.emitted_utc_ns)}
        yield of | times | _fields(look, names)


def _truth_rows(ledger: pb.Ledger, of: Row) -> Iterable[Row]:
    names = (*_GEOMETRY, "range_rate_m_s")
    for number, plot in enumerate(ledger.plots):
        row = of | {"plot": number, "drone": plot.drone or None, "time_utc": _ns(plot.time_utc_ns)}
        yield row | _fields(plot, names) | {"merged_drones": list(plot.merged_drones)}


def _fate_rows(ledger: pb.Ledger, of: Row) -> Iterable[Row]:
    names = ("topic", "octets", "number", "copy", "flipped_bit")
    for sent in ledger.messages:
        times = {
            "due_utc": _ns(sent.due_utc_ns),
            "link_due_utc": _ns(sent.link_due_utc_ns),
            "sent_utc": _ns(sent.sent_utc_ns),
        }
        fate = {"fate": pb.Fate.Name(sent.fate), "not_to": list(sent.not_to)}
        yield of | times | fate | _fields(sent, names)


def _track_rows(message: Recorded) -> Iterable[Row] | None:
    rows = _TRACKS_IN(message)
    log_time = {"log_time_utc": _ns(message.log_time_ns)}
    return None if rows is None else [row | log_time for row in rows]


def _rows_of_batch(batch: pb.TrackBatch, of: Row) -> Iterable[Row]:
    names = ("id", "number", *_TRACK_REALS, *_TRACK_FLAGS)
    kind = {"kind": pb.TrackKind.Name(batch.kind).lower()}
    for track in batch.tracks:
        yield of | kind | {"time_utc": _ns(track.time_utc_ns)} | _fields(track, names)


def _batch_in(payload: bytes) -> list[pb.TrackBatch]:
    return [pb.TrackBatch.FromString(payload)]


_TRACKS_IN = _rows_in((TRACK_BATCH,), "/tracks", _batch_in, _rows_of_batch)
_OF_LEDGER = partial(_rows_in, (LEDGER, LEDGER_BATCH), "/truth", entries_in)


def _message_rows(message: Recorded) -> Iterable[Row]:
    return [
        {
            "log_time_utc": _ns(message.log_time_ns),
            "publish_time_utc": _ns(message.publish_time_ns),
            "topic": message.topic,
            "content_type": message.content_type or None,
            "stage": str(message.stage),
            "qos": message.qos,
            "retain": message.retain,
            "octets": len(message.payload),
            "payload": message.payload,
        }
    ]


_ROWS_OF: Mapping[TableName, Callable[[Recorded], Iterable[Row] | None]] = {
    TableName.TRUTHS: _OF_LEDGER(_truth_rows),
    TableName.LOOKS: _OF_LEDGER(_look_rows),
    TableName.TRACKS: _track_rows,
    TableName.MESSAGES: _message_rows,
    TableName.FATES: _OF_LEDGER(_fate_rows),
}
