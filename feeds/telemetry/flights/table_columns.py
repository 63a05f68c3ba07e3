"""Which column of a table is what, in which unit and above what, by how exporters head them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.units import FOOT_M, KNOT_M_S, MILE_H_M_S

METRES = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("ft", "feet", "foot"), FOOT_M),
}
SPEEDS = {
    **dict.fromkeys(("m_s", "mps", "ms"), 1.0),
    **dict.fromkeys(("km_h", "kmh", "kph"), 1 / 3.6),
    **dict.fromkeys(("kt", "kts", "knots"), KNOT_M_S),
    **dict.fromkeys(("ft_s", "fps"), FOOT_M),
    "mph": MILE_H_M_S,
}
# In nanoseconds.
SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 10**9),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 10**6),
    **dict.fromkeys(("us", "microsecond", "microseconds"), 10**3),
    "ns": 1,
}
DEGREES = {"deg": 1.0, "degree": 1.0, "degrees": 1.0}
IN_WORDS = {1.0: "metres", FOOT_M: "feet"}
ABOVE, SEA, GLOBE = (
    AltitudeReference.ABOVE_TAKEOFF,
    AltitudeReference.MEAN_SEA_LEVEL,
    AltitudeReference.ELLIPSOID,
)
REFERENCE_WORDS = {
    ABOVE: "above take-off",
    SEA: "above mean sea level",
    GLOBE: "above the ellipsoid",
}

TIME = (
    "time_utc", "t_utc", "datetime_utc", "utc_time", "utc", "time", "datetime", "date_time",
    "timestamp_utc", "timestamp", "epoch", "unix_time", "gps_datetime", "datetime_local", "t",
)  # fmt: skip
ELAPSED = ("elapsed", "elapsed_time", "time", "fly_time", "flytime", "flight_time", "offset_time")
DATE = ("date", "date_local", "date_utc")
TIME_OF_DAY = ("update_time", "updatetime", "updatetime_local", "time_local", "time_of_day", "time")
# Quantity to the names taken for it, without unit and prefix.
#
# Velocities are only taken where the name tells direction and unit: `vx` may be north or east.
KNOWN_NAMES: Mapping[str, Sequence[str]] = {
    "latitude_deg": ("latitude", "lat"),
    "longitude_deg": ("longitude", "lon", "lng", "long"),
    "velocity_east_m_s": ("velocity_east", "v_east", "ve", "vel_e"),
    "velocity_north_m_s": ("velocity_north", "v_north", "vn", "vel_n"),
    "velocity_up_m_s": ("velocity_up", "v_up", "vu", "climb"),
    "horizontal_accuracy_m": ("horizontal_accuracy", "hacc", "h_acc"),
    "vertical_accuracy_m": ("vertical_accuracy", "vacc", "v_acc"),
    "velocity_accuracy_m_s": ("velocity_accuracy", "sacc", "s_acc"),
}
# What heights are called, and above what that is; None where the name does not say.
ALTITUDES: Mapping[str, AltitudeReference | None] = {
    **dict.fromkeys(("height_above_takeoff", "height_above_home", "relative_altitude"), ABOVE),
    **dict.fromkeys(("rel_alt", "relative_alt", "osd_height", "altitude_agl_home"), ABOVE),
    **dict.fromkeys(("altitude_above_sealevel", "altitude_msl", "alt_msl", "amsl"), SEA),
    **dict.fromkeys(("altitude_ellipsoid", "ellipsoid_height", "height_ellipsoid", "hae"), GLOBE),
    **dict.fromkeys(("altitude", "alt", "height", "elevation", "ele")),
}
USER_QUANTITIES = ("time", *KNOWN_NAMES, "altitude_m", "elapsed")
_PREFIX = re.compile(r"^(osd|custom|gps|home)_(?=lat|lon|lng|date|time|updatetime|fly)")
_UNIT = re.compile(r"^(.*?)[\s_]*[(\[]\s*([^()\[\]]*)\s*[)\]]\s*$")


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column: its place, its name as written, and its name and unit apart."""

    index: int
    header: str
    name: str
    unit: str

    @classmethod
    def of(cls, index: int, header: str) -> TableColumn:
        """The column with that header, such as `height_above_takeoff(feet)`, `OSD.height [ft]`."""
        found = _UNIT.match(header.strip())
        name, unit = (found[1], found[2]) if found else (header, "")
        name, unit = plain(name), plain(unit)
        name = _PREFIX.sub("", name)
        if not found:
            for known in (*METRES, *SPEEDS, *SECONDS, *DEGREES):
                if name.endswith(f"_{known}") and len(known) > len(unit):
                    unit = known
            name = name.removesuffix(f"_{unit}") if unit else name
        return cls(index, header.strip(), name, unit)

    def factor(self, units: Mapping[str, float]) -> float:
        """What its values are multiplied by; raises `PlotfeedError` for a unit that is unknown."""
        if self.unit and self.unit not in units:
            raise PlotfeedError(
                f"column {self.header!r}: unknown unit; expected one of {', '.join(units)}"
            )
        return units[self.unit] if self.unit else 1.0


def plain(text: str) -> str:
    """Lower case, words joined by one underscore: "Altitude (m)" is altitude_m."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


@dataclass(frozen=True, slots=True)
class AltitudeColumn:
    """Where a table's altitudes are, in which unit, and above what."""

    column: TableColumn
    factor: float
    reference: AltitudeReference

    def __str__(self) -> str:
        unit = IN_WORDS.get(self.factor, "metres")
        return f"height in {unit}, {REFERENCE_WORDS[self.reference]}: column {self.column.header!r}"


def altitude_column(
    columns: Sequence[TableColumn],
    wanted: AltitudeReference | None,
    named: TableColumn | None,
    implied: AltitudeReference | None,
) -> AltitudeColumn | None:
    """The column of altitudes: what the user names, one above what is wanted, one that says it.

    `implied` is what an exporter's plain "altitude" is above. None where there is no altitude;
    raises `PlotfeedError` where nobody says above what it is.
    """
    found = [(c, ALTITUDES[c.name]) for c in columns if c.name in ALTITUDES]
    if named is not None:
        found = [(named, ALTITUDES.get(named.name))]
    found = [(c, r) for c, r in found if not c.unit or c.unit in METRES]
    if not found:
        return None
    order = list(ALTITUDES)
    found.sort(key=lambda pair: order.index(pair[0].name) if pair[0].name in order else 0)
    for column, reference in found:
        if wanted is not None and reference is wanted:
            return AltitudeColumn(column, column.factor(METRES), wanted)
    for column, reference in found:
        above = wanted or implied if reference is None else reference
        if above is not None and (wanted is None or reference is None):
            return AltitudeColumn(column, column.factor(METRES), above)
    column, reference = found[0]
    if reference is None:
        raise PlotfeedError(
            f"column {column.header!r} does not say what its altitudes are measured from; say so "
            "with --altitude-reference above_takeoff, mean_sea_level or ellipsoid"
        )
    return AltitudeColumn(column, column.factor(METRES), reference)


def missing(quantity: str, columns: Sequence[TableColumn]) -> PlotfeedError:
    """The error of a table that has no column for that."""
    return PlotfeedError(
        f"no column found for {quantity}; name it with --column {quantity}=NAME; "
        f"columns are {headers(columns)}"
    )


def headers(columns: Sequence[TableColumn]) -> str:
    """What columns are called, in a bounded line."""
    return ", ".join(column.header for column in columns)[:300]
