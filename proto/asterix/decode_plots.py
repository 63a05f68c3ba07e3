"""Plots from octets of ASTERIX: where the records of each category tell of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from plotfeed.proto.asterix.cat015 import MEASUREMENT_PLOT, Geometry
from plotfeed.proto.asterix.cat205 import Message205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Record, decode, decode_lenient
from plotfeed.proto.asterix.codec.layout import Compound, Fixed, Item, Named, Quantity
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.units import FOOT_M, NM_M
from plotfeed.proto.utc import NS, nearest_utc_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotItems:
    """Paths into the records of a category to what they tell of plots."""

    time: str
    """Path of the time of day, in seconds."""
    columns: Mapping[str, str]
    """The path of each column of plots."""
    units: Mapping[str, float] = field(default_factory=dict)
    """What one is of a column, in the column's own unit, where that is not the layout's."""
    plots_alone: tuple[str, tuple[int, ...]] = ("", ())
    """A part, and the values by which it says that a record is a plot; all are, without one."""


PLOT_ITEMS: dict[int, PlotItems] = {
    15: PlotItems(
        time="I015/145",
        columns={
            "range_m": "I015/625/R",
            "sigma_range_m": "I015/625/SDR",
            "azimuth_deg": "I015/627/AZ",
            "sigma_azimuth_deg": "I015/627/SDASZ",
            "elevation_deg": "I015/628/EL",
            "sigma_elevation_deg": "I015/628/SDEL",
            "height_m": "I015/601/GH",
            "range_rate_m_s": "I015/626/DV",
            "sigma_range_rate_m_s": "I015/626/SDDV",
            "amplitude_dbm": "I015/630/RPP",
            "snr_db": "I015/630/RPS",
            "channel": "I015/400/PID",
        },
        plots_alone=("I015/000/MT", (MEASUREMENT_PLOT,)),
    ),
    48: PlotItems(
        time="I048/140",
        columns={
            "range_m": "I048/040/RHO",
            "azimuth_deg": "I048/040/THETA",
            "altitude_m": "I048/110",
            "range_rate_m_s": "I048/120/CAL/CAL",
            "amplitude_dbm": "I048/130/PAM",
            "identity": "I048/240",
            "mode_3a": "I048/070/MODE3A",
            "address": "I048/220",
            "track": "I048/161",
            "flight_level": "I048/090/FL",
            "ssr_amplitude_dbm": "I048/130/SAM",
            "east_m": "I048/042/X",
            "north_m": "I048/042/Y",
        },
        units={"range_m": NM_M, "altitude_m": FOOT_M, "east_m": NM_M, "north_m": NM_M},
    ),
    205: PlotItems(
        time="I205/030",
        columns={
            "azimuth_deg": "I205/070",
            "elevation_deg": "I205/200",
            "identity": "I205/090",
        },
        plots_alone=("I205/000", (Message205.SYSTEM_BEARING, Message205.SENSOR_DATA)),
    ),
}
"""What tells of plots, by category. The time of 205 is that of sending."""
TRACK_ITEMS = PlotItems(
    time="I062/070",
    columns={
        "track": "I062/040",
        "latitude_deg": "I062/105/LAT",
        "longitude_deg": "I062/105/LON",
        "east_m": "I062/100/X",
        "north_m": "I062/100/Y",
        "velocity_east_m_s": "I062/185/VX",
        "velocity_north_m_s": "I062/185/VY",
        "height_m": "I062/130",
        "climb_m_s": "I062/220",
        "flight_level": "I062/136",
        "mode_3a": "I062/060/MODE3A",
        "address": "I062/380/ADR",
        "identity": "I062/245/CHR",
    },
    units={"height_m": FOOT_M, "climb_m_s": FOOT_M / 60},
)
"""Of 062, whose tracks are no plots and have rows in tables alone."""
MULTISTATIC = {"range_m": "bistatic_range_m", "sigma_range_m": "sigma_bistatic_range_m"}
"""Columns that the ranges of 015 are of, where a record says that its sensor is multistatic."""


def steps_of(category: int) -> Mapping[str, float]:
    """Steps in which a category tells columns of plots, in their units; none for other formats."""
    items = PLOT_ITEMS.get(category)
    if items is None:
        return {}
    parts = dict(chain.from_iterable(map(_parts_of, CATEGORIES[category].uap)))
    found = {name: parts[path] for name, path in items.columns.items()}
    steps = {
        name: part.lsb * items.units.get(name, 1.0)
        for name, part in found.items()
        if isinstance(part, Quantity)
    }
    return steps | {own: steps[name] for name, own in MULTISTATIC.items() if name in steps}


def _parts_of(item: Item | None, path: str = "") -> Iterator[tuple[str, Named]]:
    """Named parts of an item by their paths, but for those that repeat."""
    if isinstance(item, Compound):
        for subfield in item.subfields:
            yield from _parts_of(subfield, f"{path}{item.name}/")
    elif isinstance(item, Fixed):
        fields = item.group.fields
        for part, _ in fields:
            yield (
                (f"{path}{item.name}" if len(fields) == 1 else f"{path}{item.name}/{part.name}"),
                part,
            )


def plots_in_asterix(payload: bytes, near_utc_ns: int) -> MeasuredPlots:
    """Plots of all records of categories that have any; raises `DecodeError`.

    A time of day is of the day that brings it nearest to `near_utc_ns`.
    """
    records = [record for record in decode(payload) if record.category in PLOT_ITEMS]
    return _plots_of(records, near_utc_ns)


def plots_and_tracks_in(payload: bytes, near_utc_ns: int) -> MeasuredPlots | None:
    """Plots and tracks of the records that are whole; None without one that could be any."""
    records = [record for record in decode_lenient(payload)[0] if _items_of(record)]
    return _plots_of(records, near_utc_ns) if records else None


def _plots_of(records: list[Record], near_utc_ns: int) -> MeasuredPlots:
    return MeasuredPlots.of(_told(record, near_utc_ns) for record in records if _is_plot(record))


def _items_of(record: Record) -> PlotItems | None:
    return TRACK_ITEMS if record.category == 62 else PLOT_ITEMS.get(record.category)


def _is_plot(record: Record) -> bool:
    items = _items_of(record)
    part, values = items.plots_alone if items else ("", ())
    return not part or record.get(part) in values


def _told(record: Record, near_utc_ns: int) -> dict[str, Any]:
    items = _items_of(record) or PLOT_ITEMS[record.category]
    place = f"I{record.category:03d}/010"
    told: dict[str, Any] = {"category": record.category}
    time_s = record.get(items.time)
    if isinstance(time_s, float):
        told["t_utc_ns"] = nearest_utc_ns(round(time_s * NS), near_utc_ns)
    is_multistatic = record.get("I015/020/MOMU") == Geometry.MULTISTATIC
    columns = {"sac": f"{place}/SAC", "sic": f"{place}/SIC", **items.columns}
    for name, path in columns.items():
        value = record.get(path)
        if value is None:
            continue
        if name == "address" and isinstance(value, int):
            value = f"{value:06X}"
        elif isinstance(value, float):
            value *= items.units.get(name, 1.0)
        told[MULTISTATIC.get(name, name) if is_multistatic else name] = value
    return told
