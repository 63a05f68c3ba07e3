"""Tables of comma-separated values with a line of column names, of whatever exporter.

Which column is what, in which unit and above what, is told by how exporters head them. Times are
those of a clock, a date and a time of day, a count, or two of these.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from plotfeed.feeds.telemetry.flights.file_times import (
    finer_times,
    is_day_first,
    midnight_ns,
    parse_time_ns,
    time_of_day_ns,
)
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.feeds.telemetry.position_report import VELOCITY
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.units import FOOT_M, KNOT_M_S, MILE_H_M_S
from plotfeed.proto.utc import NS

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


def altitude_column(
    columns: Sequence[TableColumn],
    wanted: AltitudeReference | None,
    named: TableColumn | None,
    implied: AltitudeReference | None,
) -> tuple[TableColumn, AltitudeReference] | None:
    """The column of altitudes, and above what they are: what the user names or wants comes first.

    `implied` is what an exporter's plain "altitude" is above. None where there is no altitude;
    raises `PlotfeedError` where nobody says above what it is.
    """
    of_names = [column for name in ALTITUDES for column in columns if column.name == name]
    of_names = of_names if named is None else [named]
    found = [(c, ALTITUDES.get(c.name)) for c in of_names if not c.unit or c.unit in METRES]
    if not found:
        return None

    def rank(pair: tuple[TableColumn, AltitudeReference | None]) -> tuple[bool, bool]:
        reference = pair[1]
        if wanted is None:
            return (reference or implied) is None, False
        return reference is not wanted, reference is not None

    column, stated = min(found, key=rank)
    reference = stated or wanted or implied
    if reference is None:
        raise PlotfeedError(
            f"column {column.header!r} does not say what its altitudes are measured from; say so "
            "with --set altitude_reference=above_takeoff, mean_sea_level or ellipsoid"
        )
    return column, reference


def missing(quantity: str, columns: Sequence[TableColumn]) -> PlotfeedError:
    """The error of a table that has no column for that."""
    return PlotfeedError(
        f"no column found for {quantity}; name it with --set columns.{quantity}=NAME; "
        f"columns are {headers(columns)}"
    )


def headers(columns: Sequence[TableColumn]) -> str:
    """What columns are called, in a bounded line."""
    return ", ".join(column.header for column in columns)[:300]


MAX_ELAPSED_NS = 10**6 * NS  # A flight of eleven days: what is more is no time since its beginning
LOOK_AT = 200  # Rows in which something is looked for, by which a column is judged

Row = tuple[int, list[str]]
Times = list[int | None]


def times_of(
    columns: Sequence[TableColumn],
    named: Mapping[str, TableColumn],
    rows: Sequence[Row],
    options: FlightOptions,
    log: Log,
) -> tuple[Times, list[str]]:
    """UTC of each row, None where it has none, and the cells that it was read from.

    Raises `PlotfeedError` for a table without times, or with a count that begins nobody knows when.
    """
    clock, cells = _clock(columns, named, rows, options.utc_offset_h, log)
    count = named.get("elapsed") or _first_of(ELAPSED, columns, lambda c: _counts(rows, c))
    if count is None:
        if clock is None:
            raise missing("time", columns)
        return clock, cells
    elapsed = [_elapsed_ns(cell_of(row, count), count) for _, row in rows]
    if clock is None:
        if options.start_utc_ns is None:
            raise PlotfeedError(
                f"column {count.header!r} counts from the beginning, and nothing says when that "
                "was (start_utc_ns)"
            )
        log.state(f"time since the beginning: column {count.header!r}")
        nothing: Times = [None] * len(rows)
        found = finer_times(nothing, elapsed, start_ns=options.start_utc_ns)
        return found, [cell_of(row, count) for _, row in rows]
    log.state(f"parts of seconds: column {count.header!r}")
    return finer_times(clock, elapsed, start_ns=None), cells


def cell_of(row: Sequence[str], column: TableColumn) -> str:
    """What stands in a column of a row; nothing where the row is too short."""
    return row[column.index].strip() if column.index < len(row) else ""


def _clock(
    columns: Sequence[TableColumn],
    named: Mapping[str, TableColumn],
    rows: Sequence[Row],
    offset_h: float,
    log: Log,
) -> tuple[Times | None, list[str]]:
    """What a clock says for each row, if there is one, and the cells that it was read from."""
    whole = named.get("time") or _first_of(
        TIME, columns, lambda c: _holds(rows, c, lambda cell: parse_time_ns(cell, offset_h))
    )
    if whole is None:
        dates = _first_of(DATE, columns, lambda c: _holds(rows, c, midnight_ns))
        of_day = _first_of(TIME_OF_DAY, columns, lambda c: _holds(rows, c, time_of_day_ns))
        if dates is not None and of_day is not None:
            return _dated(dates, of_day, rows, offset_h, log)
        # What cannot be read in the first row may be read further down.
        whole = _first_of(TIME, columns, lambda c: c.unit not in SECONDS)
        if whole is None:
            return None, []
    is_utc = "utc" in f"{whole.name}_{whole.unit}".split("_")
    log.state(f"time: column {whole.header!r}")
    cells = [cell_of(row, whole) for _, row in rows]
    return [parse_time_ns(cell, 0.0 if is_utc else offset_h) for cell in cells], cells


def _dated(
    dates: TableColumn, of_day: TableColumn, rows: Sequence[Row], offset_h: float, log: Log
) -> tuple[Times, list[str]]:
    """A date and a time of day in two columns."""
    days = [cell_of(row, dates) for _, row in rows]
    day_first = is_day_first(days)
    first = next((day for day in days if day), "")
    if day_first is None and midnight_ns(first) != midnight_ns(first, day_first=True):
        log.assume(f"dates such as {first} have the month first")
    log.state(f"time: columns {dates.header!r} and {of_day.header!r}")
    is_utc = "utc" in (dates.unit, of_day.unit)
    if not is_utc:
        log.assume(f"times are {offset_h:+g} h from UTC (utc_offset_h)")
    ahead_ns = 0 if is_utc else round(offset_h * 3600 * NS)
    found: Times = []
    cells = [cell_of(row, of_day) for _, row in rows]
    for day, cell in zip(days, cells, strict=True):
        midnight, since = midnight_ns(day, day_first=bool(day_first)), time_of_day_ns(cell)
        is_known = midnight is not None and since is not None
        found.append((midnight or 0) + (since or 0) - ahead_ns if is_known else None)
    return found, [f"{day} {cell}" for day, cell in zip(days, cells, strict=True)]


def _counts(rows: Sequence[Row], column: TableColumn) -> bool:
    """Whether a column counts from the beginning, in a unit that its name tells."""
    if column.unit not in SECONDS:
        return False
    return _holds(rows, column, lambda cell: _elapsed_ns(cell, column))


def _elapsed_ns(cell: str, column: TableColumn) -> int | None:
    try:
        value = Decimal(cell.strip())
    except InvalidOperation:
        return None
    if not value.is_finite() or not 0 <= value <= MAX_ELAPSED_NS:
        return None
    elapsed_ns = round(value * SECONDS.get(column.unit, NS))
    return elapsed_ns if elapsed_ns <= MAX_ELAPSED_NS else None


def _first_of(
    names: Sequence[str], columns: Sequence[TableColumn], fits: Callable[[TableColumn], bool]
) -> TableColumn | None:
    """The first column of the first name that fits."""
    return next((c for name in names for c in columns if c.name == name and fits(c)), None)


def _holds(rows: Sequence[Row], column: TableColumn, read: Callable[[str], int | None]) -> bool:
    """Whether what stands first in that column can be read."""
    cells = (cell_of(row, column) for _, row in rows[:LOOK_AT])
    return read(next((cell for cell in cells if cell), "")) is not None


_ACCURACIES = ("horizontal_accuracy_m", "vertical_accuracy_m", "velocity_accuracy_m_s")
# Columns that Litchi's log has beside each other; its altitude is above take-off.
LITCHI = frozenset({"altitude", "velocityx", "velocityy", "velocityz"})
MOST_LINES_BEFORE = 3
REQUIRED = ("latitude_deg", "longitude_deg", "altitude_m")
Place = tuple[TableColumn, float]  # A column, and what its values are multiplied by


def read_table(text: str, options: FlightOptions, log: Log) -> None:
    """Take every row that has a time, a position and a height."""
    columns, rows = _rows(text, log)
    named = _named(columns, options.columns)
    found = _quantities(columns, named)
    is_litchi = {column.name for column in columns} >= LITCHI
    implied = AltitudeReference.ABOVE_TAKEOFF if is_litchi else None
    altitude = altitude_column(
        columns, options.altitude_reference, named.get("altitude_m"), implied
    )
    if altitude is None and options.stated_height is None:
        error = missing("altitude_m", columns)
        raise PlotfeedError(f"{error}; or give one height with --set height_m")
    times, cells = times_of(columns, named, rows, options, log)
    reference = AltitudeReference.ABOVE_TAKEOFF
    if altitude is not None:
        column, reference = altitude
        factor = column.factor(METRES)
        found["altitude_m"] = column, factor
        words = f"{IN_WORDS.get(factor, 'metres')}, {REFERENCE_WORDS[reference]}"
        log.state(f"height in {words}: column {column.header!r}")
    elif options.stated_height is not None:
        height_m, reference = options.stated_height
        log.state(f"height {height_m:g} m, {REFERENCE_WORDS[reference]}: no column has one")
    for (line, row), t_utc_ns, cell in zip(rows, times, cells, strict=True):
        where = f"line {line}"
        if t_utc_ns is None:
            expected = "expected ISO 8601 or seconds since 1970"
            log.skip(where, f"time is {cell[:40]!r}; {expected}")
        else:
            values = {q: _number(cell_of(row, c)) * factor for q, (c, factor) in found.items()}
            values.setdefault("altitude_m", options.height_m or 0.0)
            _take(where, t_utc_ns, values, reference, log)


def _rows(text: str, log: Log) -> tuple[list[TableColumn], list[Row]]:
    """Columns, and line number and cells of every row below that is not empty.

    Some exporters have a line before that of the names, which is the first with a latitude.
    """
    lines = text.splitlines()
    full = [i for i, s in enumerate(lines) if s.strip() and not s.startswith("#")]
    if not full:
        raise PlotfeedError("empty table")
    start = full[0]
    for i in full[:MOST_LINES_BEFORE]:
        cells = lines[i].split(max(",;\t", key=lines[i].count))
        names = {TableColumn.of(0, cell.strip(' "')).name for cell in cells}
        if names & set(KNOWN_NAMES["latitude_deg"]):
            start = i
            break
    delimiter = max(",;\t", key=lines[start].count)
    reader = csv.reader(lines[start:], delimiter=delimiter)
    rows: list[Row] = []
    while True:
        try:
            row = next(reader)
        except StopIteration:
            break
        except csv.Error as error:
            log.skip(f"line {start + reader.line_num}", str(error))
            continue
        if any(cell.strip() for cell in row):
            rows.append((start + reader.line_num, row))
    if not rows:
        raise PlotfeedError("no line of column names that can be read")
    return [TableColumn.of(i, name) for i, name in enumerate(rows[0][1])], rows[1:]


def _named(columns: Sequence[TableColumn], named: Mapping[str, str]) -> dict[str, TableColumn]:
    """Columns that the user names, by quantity."""
    found = {}
    for quantity, name in named.items():
        if quantity not in USER_QUANTITIES:
            expected = ", ".join(USER_QUANTITIES)
            raise PlotfeedError(f"columns.{quantity}: no such quantity; expected one of {expected}")
        column = next((c for c in columns if c.header == name.strip()), None)
        if column is None:
            raise PlotfeedError(
                f"columns.{quantity}={name}: no such column; columns are {headers(columns)}"
            )
        found[quantity] = column
    return found


def _quantities(
    columns: Sequence[TableColumn], named: Mapping[str, TableColumn]
) -> dict[str, Place]:
    """Place and factor of the columns of positions, velocities and accuracies."""
    found = {}
    for quantity, names in KNOWN_NAMES.items():
        is_speed = quantity.endswith("_m_s")
        units = SPEEDS if is_speed else DEGREES if quantity.endswith("_deg") else METRES
        fitting = [c for name in names for c in columns if c.name == name]
        # Direction and unit of a velocity must be told, and the unit of an accuracy.
        fitting = [c for c in fitting if (c.unit in units) or (not c.unit and units is DEGREES)]
        if column := named.get(quantity) or next(iter(fitting), None):
            found[quantity] = column, column.factor(units)
    for quantity in ("latitude_deg", "longitude_deg"):
        if quantity not in found:
            raise missing(quantity, columns)
    return found


def _take(
    where: str, t_utc_ns: int, values: Mapping[str, float], reference: AltitudeReference, log: Log
) -> None:
    for quantity in REQUIRED:
        if math.isnan(values[quantity]):
            log.skip(where, f"{quantity} is missing or no number")
            return
    log.take(
        where,
        t_utc_ns,
        (values["latitude_deg"], values["longitude_deg"]),
        (values["altitude_m"], reference),
        velocity_enu_m_s=tuple(values.get(q, math.nan) for q in VELOCITY),
        **{q: values.get(q, math.nan) for q in _ACCURACIES},
    )


def _number(cell: str) -> float:
    """NaN where the cell holds no number."""
    try:
        return float(cell)
    except ValueError:
        return math.nan
