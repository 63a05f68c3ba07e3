"""Tables of comma-separated values with a line of column names, of whatever exporter.

Which column is what, in which unit and above what, is told by how exporters head them. Times are
those of a clock, a date and a time of day, a count, or two of these.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import partial

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


MAX_ELAPSED_NS = 10**6 * NS  # A flight of eleven days: what is more is no time since its beginning
LOOK_AT = 200  # Rows in which something is looked for, by which a column is judged
_ACCURACIES = ("horizontal_accuracy_m", "vertical_accuracy_m", "velocity_accuracy_m_s")
# Columns that Litchi's log has beside each other; its altitude is above take-off.
LITCHI = frozenset({"altitude", "velocityx", "velocityy", "velocityz"})
MOST_LINES_BEFORE = 3
REQUIRED = ("latitude_deg", "longitude_deg", "altitude_m")

Times = list[int | None]


def read_table(text: str, options: FlightOptions, log: Log) -> None:
    """Take every row that has a time, a position and a height."""
    table = _Table(text, options, log)
    found, (altitude, reference) = table.quantities(), table.altitude()
    times, told = table.times()
    words = REFERENCE_WORDS[reference]
    if altitude is None:
        log.state(f"height {options.height_m:g} m, {words}: no column has one")
    else:
        factor = altitude.factor(METRES)
        found["altitude_m"] = altitude, factor
        log.state(
            f"height in {IN_WORDS.get(factor, 'metres')}, {words}: column {altitude.header!r}"
        )
    for (line, row), t_utc_ns, cell in zip(table.rows, times, told, strict=True):
        where = f"line {line}"
        if t_utc_ns is None:
            expected = "expected ISO 8601 or seconds since 1970"
            log.skip(where, f"time is {cell[:40]!r}; {expected}")
            continue
        values = {q: _number(cell_of(row, c)) * factor for q, (c, factor) in found.items()}
        values.setdefault("altitude_m", options.height_m or 0.0)
        absent = next((q for q in REQUIRED if math.isnan(values[q])), None)
        if absent is not None:
            log.skip(where, f"{absent} is missing or no number")
            continue
        log.take(
            where,
            t_utc_ns,
            (values["latitude_deg"], values["longitude_deg"]),
            (values["altitude_m"], reference),
            velocity_enu_m_s=tuple(values.get(q, math.nan) for q in VELOCITY),
            **{q: values.get(q, math.nan) for q in _ACCURACIES},
        )


class _Table:
    """Columns, those that the user names by quantity, and rows; raises `PlotfeedError`."""

    def __init__(self, text: str, options: FlightOptions, log: Log) -> None:
        self._options, self._log = options, log
        rows = list(_rows(text, log))
        if not rows:
            raise PlotfeedError("no line of column names that can be read")
        self.rows = rows[1:]  # Line number and cells of each
        self._columns = [TableColumn.of(i, name) for i, name in enumerate(rows[0][1])]
        self._headers = ", ".join(column.header for column in self._columns)[:300]
        self._named: dict[str, TableColumn] = {}
        for quantity, name in options.columns.items():
            if quantity not in USER_QUANTITIES:
                expected = f"expected one of {', '.join(USER_QUANTITIES)}"
                raise PlotfeedError(f"columns.{quantity}: no such quantity; {expected}")
            column = next((c for c in self._columns if c.header == name.strip()), None)
            if column is None:
                there = f"columns are {self._headers}"
                raise PlotfeedError(f"columns.{quantity}={name}: no such column; {there}")
            self._named[quantity] = column

    def quantities(self) -> dict[str, tuple[TableColumn, float]]:
        """Columns of positions, velocities and accuracies, with what values are multiplied by."""
        found = {}
        for quantity, names in KNOWN_NAMES.items():
            is_speed = quantity.endswith("_m_s")
            units = SPEEDS if is_speed else DEGREES if quantity.endswith("_deg") else METRES
            fitting = [c for name in names for c in self._columns if c.name == name]
            # Direction and unit of a velocity must be told, and the unit of an accuracy.
            fitting = [c for c in fitting if (c.unit in units) or (not c.unit and units is DEGREES)]
            if column := self._named.get(quantity) or next(iter(fitting), None):
                found[quantity] = column, column.factor(units)
        for quantity in ("latitude_deg", "longitude_deg"):
            if quantity not in found:
                raise self._missing(quantity)
        return found

    def altitude(self) -> tuple[TableColumn | None, AltitudeReference]:
        """The column of altitudes, and above what they are: what the user names or wants is first.

        None with the height that the user states where there is no such column.
        """
        wanted, named = self._options.altitude_reference, self._named.get("altitude_m")
        # What an exporter's plain "altitude" is above.
        implied = ABOVE if {column.name for column in self._columns} >= LITCHI else None
        of_names = [c for name in ALTITUDES for c in self._columns if c.name == name]
        of_names = of_names if named is None else [named]
        found = [(c, ALTITUDES.get(c.name)) for c in of_names if not c.unit or c.unit in METRES]
        if not found:
            if self._options.stated_height is None:
                error = self._missing("altitude_m")
                raise PlotfeedError(f"{error}; or give one height with --set height_m")
            return None, self._options.stated_height[1]

        def rank(pair: tuple[TableColumn, AltitudeReference | None]) -> tuple[bool, bool]:
            reference = pair[1]
            if wanted is None:
                return (reference or implied) is None, False
            return reference is not wanted, reference is not None

        column, stated = min(found, key=rank)
        reference = stated or wanted or implied
        if reference is None:
            raise PlotfeedError(
                f"column {column.header!r} does not say what its altitudes are measured from; "
                "say so with --set altitude_reference=above_takeoff, mean_sea_level or ellipsoid"
            )
        return column, reference

    def times(self) -> tuple[Times, list[str]]:
        """UTC of each row, None where it has none, and the cells that it was read from.

        Raises `PlotfeedError` without times, or with a count that begins nobody knows when.
        """
        clock, cells = self._clock()
        count = self._named.get("elapsed") or self._first_of(
            ELAPSED, lambda c: c.unit in SECONDS and self._holds(c, partial(_elapsed_ns, c.unit))
        )
        if count is None:
            if clock is None:
                raise self._missing("time")
            return clock, cells
        counted = self._cells(count)
        elapsed = [_elapsed_ns(count.unit, cell) for cell in counted]
        if clock is not None:
            self._log.state(f"parts of seconds: column {count.header!r}")
            return finer_times(clock, elapsed, start_ns=None), cells
        start_ns = self._options.start_utc_ns
        if start_ns is None:
            raise PlotfeedError(
                f"column {count.header!r} counts from the beginning, and nothing says when that "
                "was (start_utc_ns)"
            )
        self._log.state(f"time since the beginning: column {count.header!r}")
        return finer_times([None] * len(counted), elapsed, start_ns=start_ns), counted

    def _clock(self) -> tuple[Times | None, list[str]]:
        """What a clock says for each row, if there is one, and the cells that it was read from."""
        offset_h = self._options.utc_offset_h
        whole = self._named.get("time") or self._first_of(
            TIME, lambda c: self._holds(c, lambda cell: parse_time_ns(cell, offset_h))
        )
        if whole is None:
            dates = self._first_of(DATE, lambda c: self._holds(c, midnight_ns))
            of_day = self._first_of(TIME_OF_DAY, lambda c: self._holds(c, time_of_day_ns))
            if dates is not None and of_day is not None:
                return self._dated(dates, of_day)
            # What cannot be read in the first row may be read further down.
            whole = self._first_of(TIME, lambda c: c.unit not in SECONDS)
            if whole is None:
                return None, []
        is_utc = "utc" in f"{whole.name}_{whole.unit}".split("_")
        self._log.state(f"time: column {whole.header!r}")
        cells = self._cells(whole)
        return [parse_time_ns(cell, 0.0 if is_utc else offset_h) for cell in cells], cells

    def _dated(self, dates: TableColumn, of_day: TableColumn) -> tuple[Times, list[str]]:
        """A date and a time of day in two columns."""
        days, cells, offset_h = self._cells(dates), self._cells(of_day), self._options.utc_offset_h
        day_first = is_day_first(days)
        first = next((day for day in days if day), "")
        if day_first is None and midnight_ns(first) != midnight_ns(first, day_first=True):
            self._log.assume(f"dates such as {first} have the month first")
        self._log.state(f"time: columns {dates.header!r} and {of_day.header!r}")
        is_utc = "utc" in (dates.unit, of_day.unit)
        if not is_utc:
            self._log.assume(f"times are {offset_h:+g} h from UTC (utc_offset_h)")
        ahead_ns = 0 if is_utc else round(offset_h * 3600 * NS)
        found: Times = []
        for day, cell in zip(days, cells, strict=True):
            midnight, since = midnight_ns(day, day_first=bool(day_first)), time_of_day_ns(cell)
            is_known = midnight is not None and since is not None
            found.append((midnight or 0) + (since or 0) - ahead_ns if is_known else None)
        return found, [f"{day} {cell}" for day, cell in zip(days, cells, strict=True)]

    def _first_of(
        self, names: Sequence[str], fits: Callable[[TableColumn], bool]
    ) -> TableColumn | None:
        """The first column of the first name that fits."""
        return next(
            (c for name in names for c in self._columns if c.name == name and fits(c)), None
        )

    def _holds(self, column: TableColumn, read: Callable[[str], int | None]) -> bool:
        """Whether what stands first in that column can be read."""
        cells = (cell_of(row, column) for _, row in self.rows[:LOOK_AT])
        return read(next((cell for cell in cells if cell), "")) is not None

    def _cells(self, column: TableColumn) -> list[str]:
        return [cell_of(row, column) for _, row in self.rows]

    def _missing(self, quantity: str) -> PlotfeedError:
        """The error of a table that has no column for that."""
        name_it = f"name it with --set columns.{quantity}=NAME"
        return PlotfeedError(
            f"no column found for {quantity}; {name_it}; columns are {self._headers}"
        )


def cell_of(row: Sequence[str], column: TableColumn) -> str:
    """What stands in a column of a row; nothing where the row is too short."""
    return row[column.index].strip() if column.index < len(row) else ""


def _rows(text: str, log: Log) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every row that is not empty, that of the columns' names first.

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
    reader = csv.reader(lines[start:], delimiter=max(",;\t", key=lines[start].count))
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            log.skip(f"line {start + reader.line_num}", str(error))
            continue
        if any(cell.strip() for cell in row):
            yield start + reader.line_num, row


def _elapsed_ns(unit: str, cell: str) -> int | None:
    """A count since the beginning; None for what is none, or too large to be one."""
    try:
        value = Decimal(cell.strip())
    except InvalidOperation:
        return None
    if not value.is_finite() or not 0 <= value <= MAX_ELAPSED_NS:
        return None
    elapsed_ns = round(value * SECONDS.get(unit, NS))
    return elapsed_ns if elapsed_ns <= MAX_ELAPSED_NS else None


def _number(cell: str) -> float:
    """NaN where the cell holds no number."""
    try:
        return float(cell)
    except ValueError:
        return math.nan
