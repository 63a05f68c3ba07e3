"""Encoding: from plots to the octets that a tracker reads, and what reading them gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from typing import Any, get_args

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case
from plotfeed.feeds.accuracy_chart.stage import Alternative, ChartStage, rms
from plotfeed.feeds.formats import MAKERS
from plotfeed.feeds.formats.message_format import MessageFormat
from plotfeed.feeds.formats.sapient.sapient_node import Groups
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.sensors.sensor_keys import RotatingScan
from plotfeed.feeds.sensing.staring import with_heights
from plotfeed.models.beam.scan import Sector, next_sector, nth_sector
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Floats, Ints, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.report_profiles import FOOT_M, NM_M
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

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
    from plotfeed.proto.sapient.decode_sapient import (
        decode as decode_sapient,
    )
    from plotfeed.proto.sapient.encode_detections import AGE, BISTATIC_RANGE

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


STEP_S = 1e-3
"""Over which rates of change are taken."""
SOME_SCAN = 1000
"""It begins a group, if its number is a multiple of their size."""
Parts = list[tuple[Sector, Plots]]


def encoding(case: Case) -> ChartStage | None:
    """Every format that such a sensor can report in, and that is installed."""
    parts = _parts(case)
    sent = Plots.joined([plots for _, plots in parts])
    if not len(sent):
        return None
    found = []
    for name in formats_of(case):
        try:
            maker = MAKERS[name](case.scene, case.sensor)
        except PlotfeedError:  # an extra that is missing
            continue
        read = READERS[name](_messages(maker, parts), parts[0][0].start_ns)
        found.append(
            Alternative(
                name=name,
                run=partial(_messages, MAKERS[name](case.scene, case.sensor), parts),
                units=len(sent),
                errors=_errors(case, sent, read),
                ours=name in case.sensor.report,
            )
        )
    return ChartStage(
        name="encoding",
        question="How to write plots down",
        alternatives=tuple(found),
    )


def formats_of(case: Case) -> list[str]:
    """The formats of plots that the scene could ask of such a sensor."""
    annotation: Any = type(case.sensor).model_fields["report"].annotation
    named = get_args(get_args(annotation)[0])
    return [name for name in named if name in READERS]


def _messages(maker: MessageFormat, parts: Parts) -> list[Message]:
    return [message for sector, plots in parts for message in maker.messages(sector, plots)]


def _parts(case: Case) -> Parts:
    """One detection of each seen target where that is to be had, spread over a few sectors."""
    targets, rng = case.seen_targets(), case.rng
    _, plots = case.model.observe(targets, rng)
    sectors = _group(case)
    start_ns, end_ns = sectors[0].start_ns, sectors[-1].end_ns
    if len(sectors) > 1:
        t_ns = np.sort(rng.integers(start_ns, end_ns, len(plots)))
    else:
        t_ns = np.full(len(plots), end_ns, np.int64)  # a sensor that stares reports when it ends
    plots = with_heights(plots.but(t_utc_ns=t_ns), case.frame)
    index = np.searchsorted([s.end_ns for s in sectors[:-1]], t_ns, side="right")
    return [(sector, plots.rows(index == i)) for i, sector in enumerate(sectors)]


def _group(case: Case) -> list[Sector]:
    """As many sectors as SAPIENT keeps together, so that its messages leave within them."""
    scan = case.sensor.scan
    period_ns = round(scan.period_s * NS)
    n = scan.sectors if isinstance(scan, RotatingScan) else 1
    size = Groups(period_ns, n).size
    sectors = [nth_sector(size * SOME_SCAN, 0, period_ns, n)]
    while len(sectors) < size:
        sectors.append(next_sector(sectors[-1], period_ns, n))
    return sectors


def _errors(case: Case, sent: Plots, read: Columns) -> dict[str, float]:
    """Of what is read, for where the target was at the time that is read beside it."""
    late_s = (read[TIME] - sent.t_utc_ns) / NS
    rates = _rates(case, sent)
    errors = {}
    for name in ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg"):
        if name not in case.own:
            continue
        found = _read(case, name, sent, read)
        if found is not None:
            difference = found - getattr(sent, name) - rates[name] * late_s
            errors[name] = rms(wrap_180(difference) if name.endswith("_deg") else difference)
    return errors


def _read(case: Case, name: str, sent: Plots, read: Columns) -> Floats | None:
    """What is read of a quantity; None if the format has nothing to read it from."""
    if name == "elevation_deg" and name not in read and HEIGHT in read:
        undulation_m = case.scene.telemetry.geoid_undulation_m or 0.0
        higher_m = read[HEIGHT] + undulation_m - sent.height_m
        level_m = sent.range_m * np.cos(np.radians(sent.elevation_deg))
        return np.asarray(sent.elevation_deg + np.degrees(higher_m / level_m))
    return np.asarray(read[name]) if name in read else None


def _rates(case: Case, sent: Plots) -> dict[str, Floats]:
    """How fast what is measured of each plot's target changes, a second."""
    enu_m = case.seen_targets().position_enu_m
    before, after = case.measured(enu_m), case.measured(enu_m + STEP_S * case.velocity_enu_m_s)
    changes = {name: after[name] - value for name, value in before.items()}
    return {
        name: (wrap_180(change) if name.endswith("_deg") else change)[sent.drone] / STEP_S
        for name, change in changes.items()
    }
