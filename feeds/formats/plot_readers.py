"""From the octets of a message back to the plots in it, by column: one reader for each format.

Columns have the names and units of `models.state.Plots`, a row each plot; what is missing was not
measured or is not in the format. Readers are for messages that are whole, and raise `DecodeError`
or protobuf's own. A time of day is taken for the nearest to a given UTC.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime

import numpy as np

from plotfeed.models.state import Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.report_profiles import FOOT_M, NM_M
from plotfeed.proto.utc import NS

DAY_S = 86_400
TIME = "t_utc_ns"
HEIGHT = "height_m"
Columns = dict[str, Floats | Ints]
PlotReader = Callable[[bytes, int], Columns]
"""The plots in a payload, given a UTC time near its own."""


def read_015(payload: bytes, near_ns: int) -> Columns:
    """Range, of a passive radar the bistatic one, azimuth and elevation."""
    columns = _read_asterix(
        payload,
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


def read_048(payload: bytes, near_ns: int) -> Columns:
    """Range, azimuth and, in place of the elevation, the height above mean sea level."""
    return _read_asterix(
        payload,
        near_ns,
        48,
        "I048/140",
        {
            "range_m": ("I048/040/RHO", NM_M),
            "azimuth_deg": ("I048/040/THETA", 1.0),
            HEIGHT: ("I048/110", FOOT_M),
        },
    )


def read_205(payload: bytes, near_ns: int) -> Columns:
    """Bearings, as of the time at which they were sent."""
    return _read_asterix(payload, near_ns, 205, "I205/030", {"azimuth_deg": ("I205/070", 1.0)})


def read_batch(payload: bytes, _near_ns: int) -> Columns:
    """Everything, as floats of 64 bits."""
    plots = pb.PlotBatch.FromString(payload).plots
    columns: Columns = {TIME: np.array([plot.time_utc_ns for plot in plots], np.int64)}
    for name in ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg"):
        if plots and plots[0].HasField(name):
            columns[name] = np.array([getattr(plot, name) for plot in plots])
    return columns


def read_sapient(payload: bytes, _near_ns: int) -> Columns:
    """Range and bearing; a bistatic range and the age of a plot from what is told beside them."""
    from plotfeed.proto.sapient.decode_sapient import decode as decode_sapient
    from plotfeed.proto.sapient.encode_detections import AGE, BISTATIC_RANGE

    message = decode_sapient(payload)
    if "detection_report" not in message:
        return {TIME: np.zeros(0, np.int64)}
    report = message["detection_report"]
    told = {info["type"]: info["value"] for info in report.get("object_info", ())}
    age_ns = round(float(told.get(AGE, 0)) * NS)
    columns: Columns = {TIME: np.array([_stamp_ns(message["timestamp"]) - age_ns], np.int64)}
    place = report.get("range_bearing", {})
    for ours, theirs in (
        ("range_m", "range"),
        ("azimuth_deg", "azimuth"),
        ("elevation_deg", "elevation"),
    ):
        if theirs in place:
            columns[ours] = np.array([place[theirs]], np.float64)
    if BISTATIC_RANGE in told:
        columns["bistatic_range_m"] = np.array([float(told[BISTATIC_RANGE])])
    return columns


def _read_asterix(
    payload: bytes,
    near_ns: int,
    category: int,
    time_path: str,
    paths: Mapping[str, tuple[str, float]],
) -> Columns:
    """Items of the records of a category, in our units; a time of day is the nearest one."""
    records = [record for record in decode(payload) if record.category == category]
    columns: Columns = {TIME: _nearest_ns(_numbers(records, time_path), near_ns)}
    for name, (path, unit) in paths.items():
        if records and records[0].get(path) is not None:
            columns[name] = _numbers(records, path) * unit
    return columns


def _numbers(records: list[Record], path: str) -> Floats:
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
