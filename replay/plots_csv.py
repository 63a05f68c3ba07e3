"""A table of plots, a row each, of our own batches and of ASTERIX 048, 015 and 205; only written.

What is empty was not measured, or is not in the category. Ranges of 015 are bistatic where the
record says that its sensor is multistatic.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping
from typing import Any, BinaryIO

from plotfeed.proto.asterix.codec.decode import Record, decode_lenient
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.asterix_blocks import is_asterix
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.times import near

NM_M = 1852.0  # exact
FOOT_M = 0.3048  # exact
MULTISTATIC = 1  # I015/020/MOMU
MEASURED_PLOT = 1  # I015/000/MT
BEARINGS = (2, 5)  # I205/000: of a system, of a sensor

COLUMNS = (
    "time_utc",
    "topic",
    "sensor",
    "category",
    "sac",
    "sic",
    "range_m",
    "bistatic_range_m",
    "azimuth_deg",
    "elevation_deg",
    "height_m",
    "doppler_m_s",
    "snr_db",
    "amplitude_dbm",
    "sigma_range_m",
    "sigma_bistatic_range_m",
    "sigma_azimuth_deg",
    "sigma_elevation_deg",
    "channel",
    "kind",
    "identity",
)
Row = dict[str, Any]


class PlotsCsvWriter:
    """Rows of the plots in messages; a message that cannot hold plots is left out."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._text = io.StringIO(newline="")
        self._rows = csv.DictWriter(self._text, COLUMNS, lineterminator="\n")
        self._rows.writeheader()
        self._flush()

    def write(self, message: Recorded) -> str | None:
        """Write the plots of a message, if any; why it cannot have any, or None."""
        rows = rows_of(message)
        if rows is None:
            return "no plots"
        for row in rows:
            self._rows.writerow({"topic": message.topic, **row})
        self._flush()
        return None

    def notes(self) -> list[str]:
        """What a table of plots is not."""
        return ["it holds plots, not messages, and is not read back"]

    def close(self) -> None:
        """Nothing is left to be written."""

    def _flush(self) -> None:
        self._file.write(self._text.getvalue().encode())
        self._text.seek(0)
        self._text.truncate()


def rows_of(message: Recorded) -> list[Row] | None:
    """The plots in a message, by column; None if it cannot hold any or cannot be read."""
    if is_asterix(message.content_type, message.payload):
        records, _ = decode_lenient(message.payload)
        plots = [record for record in records if record.category in _PARTS]
        return list(_asterix(plots, message)) if plots else None
    if message.content_type.endswith("plotfeed.v1.PlotBatch") or (
        not message.content_type and message.topic.endswith("/plots")
    ):
        return _protobuf(message)
    return None


def _protobuf(message: Recorded) -> list[Row] | None:
    from google.protobuf.message import DecodeError

    from plotfeed.proto import plotfeed_pb2 as pb

    try:
        batch = pb.PlotBatch.FromString(message.payload)
    except DecodeError:
        return None
    names = [name for name in COLUMNS if name in pb.Plot.DESCRIPTOR.fields_by_name]
    return [
        {"time_utc": iso_utc(plot.time_utc_ns), "sensor": batch.sensor}
        | {name: getattr(plot, name) for name in names if _is_there(plot, name)}
        | ({"doppler_m_s": plot.range_rate_m_s} if _is_there(plot, "range_rate_m_s") else {})
        for plot in batch.plots
    ]


def _is_there(plot: Any, name: str) -> bool:
    field = plot.DESCRIPTOR.fields_by_name[name]
    return plot.HasField(name) if field.has_presence else True


def _asterix(records: list[Record], message: Recorded) -> Iterator[Row]:
    levels = message.topic.split("/")
    sensor = levels[-3] if len(levels) > 2 and levels[-2] == "asterix" else ""
    for record in records:
        place = f"I{record.category:03d}"
        time_item, parts = _PARTS[record.category]
        values = parts(record)
        if values is None:
            continue
        time_s = record.get(f"{place}/{time_item}")
        time_ns = round(time_s * NS) if isinstance(time_s, float) else None
        yield {
            "time_utc": "" if time_ns is None else iso_utc(near(time_ns, message.log_time_ns)),
            "sensor": sensor,
            "category": f"{record.category:03d}",
            "sac": record.get(f"{place}/010/SAC"),
            "sic": record.get(f"{place}/010/SIC"),
            **{name: value for name, value in values.items() if value is not None},
        }


def _of_048(record: Record) -> Row | None:
    return {
        "range_m": _times(record.get("I048/040/RHO"), NM_M),
        "azimuth_deg": record.get("I048/040/THETA"),
        "height_m": _times(record.get("I048/110"), FOOT_M),
        "doppler_m_s": record.get("I048/120/CAL/CAL"),
        "amplitude_dbm": record.get("I048/130/PAM"),
        "identity": record.get("I048/240"),
    }


def _of_015(record: Record) -> Row | None:
    if record.get("I015/000/MT") != MEASURED_PLOT:
        return None
    bistatic = "bistatic_" if record.get("I015/020/MOMU") == MULTISTATIC else ""
    return {
        f"{bistatic}range_m": record.get("I015/625/R"),
        f"sigma_{bistatic}range_m": record.get("I015/625/SDR"),
        "azimuth_deg": record.get("I015/627/AZ"),
        "sigma_azimuth_deg": record.get("I015/627/SDASZ"),
        "elevation_deg": record.get("I015/628/EL"),
        "sigma_elevation_deg": record.get("I015/628/SDEL"),
        "height_m": record.get("I015/601/GH"),
        "doppler_m_s": record.get("I015/626/DV"),
        "amplitude_dbm": record.get("I015/630/RPP"),
        "snr_db": record.get("I015/630/RPS"),
        "channel": record.get("I015/400/PID"),
    }


def _of_205(record: Record) -> Row | None:
    if record.get("I205/000") not in BEARINGS:
        return None
    return {
        "azimuth_deg": record.get("I205/070"),
        "elevation_deg": record.get("I205/200"),
        "identity": record.get("I205/090"),
    }


_PARTS: Mapping[int, tuple[str, Callable[[Record], Row | None]]] = {
    15: ("145", _of_015),
    48: ("140", _of_048),
    205: ("030", _of_205),
}
"""By category: the item of its time of day, and the columns of a record; None if it is no plot."""


def _times(value: object, factor: float) -> float | None:
    return value * factor if isinstance(value, float) else None
