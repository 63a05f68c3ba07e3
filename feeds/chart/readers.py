"""What a tracker reads of plots in each format: our own decoders, as columns of what is measured.

Columns are by quantity, one row a plot in the order in which plots were given; `t_utc_ns` is what
the reader takes for the time of measurement. A quantity that a format does not carry is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime

import numpy as np

from plotfeed.feeds.message import Message
from plotfeed.models.state import Floats, Ints
from plotfeed.models.truth import NS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode import Record, decode
from plotfeed.proto.asterix.reports import FOOT_M, NM_M

DAY_S = 86_400
HEIGHT = "height_m"
TIME = "t_utc_ns"
Columns = dict[str, Floats | Ints]
Reader = Callable[[Sequence[Message], int], Columns]


def read_048(messages: Sequence[Message], near_ns: int) -> Columns:
    """Range, azimuth and, in place of the elevation, the height above mean sea level."""
    return _read_asterix(
        messages,
        near_ns,
        48,
        "I048/140",
        {
            "range_m": ("I048/040/RHO", NM_M),
            "azimuth_deg": ("I048/040/THETA", 1.0),
            HEIGHT: ("I048/110", FOOT_M),
        },
    )


def read_015(messages: Sequence[Message], near_ns: int) -> Columns:
    """Range, of a passive radar the bistatic one, azimuth and elevation."""
    columns = _read_asterix(
        messages,
        near_ns,
        15,
        "I015/145",
        {
            "range_m": ("I015/625/R", 1.0),
            "azimuth_deg": ("I015/627/AZ", 1.0),
            "elevation_deg": ("I015/628/EL", 1.0),
        },
    )
    if "range_m" in columns:
        columns["bistatic_range_m"] = columns["range_m"]  # the caller knows which of them it is
    return columns


def read_205(messages: Sequence[Message], near_ns: int) -> Columns:
    """Bearings, as of the time at which they were sent."""
    paths = {"azimuth_deg": ("I205/070", 1.0)}
    return _read_asterix(messages, near_ns, 205, "I205/030", paths)


def read_plots(messages: Sequence[Message], _near_ns: int) -> Columns:
    """Everything, as floats of 64 bits."""
    plots = [plot for m in messages for plot in pb.PlotBatch.FromString(m.payload).plots]
    columns: Columns = {TIME: np.array([plot.time_utc_ns for plot in plots], np.int64)}
    for name in ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg"):
        if plots and plots[0].HasField(name):
            columns[name] = np.array([getattr(plot, name) for plot in plots])
    return columns


def read_sapient(messages: Sequence[Message], _near_ns: int) -> Columns:
    """Range and bearing; a bistatic range and the age of a plot from what is told beside them."""
    from plotfeed.proto.sapient.decode import decode as decode_sapient  # noqa: PLC0415 - an extra
    from plotfeed.proto.sapient.detections import AGE, BISTATIC_RANGE  # noqa: PLC0415

    found = [decode_sapient(message.payload) for message in messages]
    reports = [message["detection_report"] for message in found]
    told = [{i["type"]: i["value"] for i in r.get("object_info", ())} for r in reports]
    ages_ns = np.array([round(float(info.get(AGE, 0)) * NS) for info in told], np.int64)
    stamps_ns = np.array([_stamp_ns(message["timestamp"]) for message in found], np.int64)
    columns: Columns = {TIME: stamps_ns - ages_ns}
    places = [report.get("range_bearing", {}) for report in reports]
    for ours, theirs in (
        ("range_m", "range"),
        ("azimuth_deg", "azimuth"),
        ("elevation_deg", "elevation"),
    ):
        if places and theirs in places[0]:
            columns[ours] = np.array([place[theirs] for place in places], np.float64)
    if told and BISTATIC_RANGE in told[0]:
        columns["bistatic_range_m"] = np.array([float(info[BISTATIC_RANGE]) for info in told])
    return columns


READERS: dict[str, Reader] = {
    "asterix-015": read_015,
    "asterix-048": read_048,
    "asterix-205": read_205,
    "plots": read_plots,
    "sapient": read_sapient,
}


def _read_asterix(
    messages: Sequence[Message],
    near_ns: int,
    category: int,
    time_path: str,
    paths: dict[str, tuple[str, float]],
) -> Columns:
    """Items of the records of a category, in our units; a time of day is the nearest one."""
    records = [r for m in messages for r in decode(m.payload) if r.category == category]
    columns: Columns = {TIME: _nearest_ns(_numbers(records, time_path), near_ns)}
    for name, (path, unit) in paths.items():
        if records and records[0].get(path) is not None:
            columns[name] = _numbers(records, path) * unit
    return columns


def _numbers(records: Sequence[Record], path: str) -> Floats:
    return np.array([record.get(path) for record in records], dtype=np.float64)


def _nearest_ns(time_of_day_s: Floats, near_ns: int) -> Ints:
    """UTC of times of day, within half a day of one that is known."""
    day_ns, into_ns = divmod(near_ns, DAY_S * NS)
    late_s = (time_of_day_s - into_ns / NS + DAY_S / 2) % DAY_S - DAY_S / 2
    return np.asarray(day_ns * DAY_S * NS + into_ns + np.rint(late_s * NS).astype(np.int64))


def _stamp_ns(text: str) -> int:
    """Of a protobuf timestamp in JSON, with up to nine digits behind the point."""
    whole, _, rest = text.removesuffix("Z").partition(".")
    seconds = int(datetime.fromisoformat(f"{whole}+00:00").timestamp())
    return seconds * NS + int(rest.ljust(9, "0"))
