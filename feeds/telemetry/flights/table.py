"""Tables of comma-separated values with a line of column names, of whatever exporter."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.feeds.telemetry.flights.table_columns import (
    DEGREES,
    KNOWN_NAMES,
    METRES,
    REFERENCE_WORDS,
    SPEEDS,
    USER_QUANTITIES,
    AltitudeColumn,
    TableColumn,
    altitude_column,
    headers,
    missing,
)
from plotfeed.feeds.telemetry.flights.table_times import Row, cell_of, times_of
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

_VELOCITY = ("velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s")
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
    altitude = _altitude(columns, named, options)
    times, cells = times_of(columns, named, rows, options, log)
    reference = AltitudeReference.ABOVE_TAKEOFF
    if altitude is not None:
        reference = altitude.reference
        log.state(str(altitude))
    elif options.stated_height is not None:
        height_m, reference = options.stated_height
        log.state(f"height {height_m:g} m, {REFERENCE_WORDS[reference]}: no column has one")
    for (line, row), t_utc_ns, cell in zip(rows, times, cells, strict=True):
        where = f"line {line}"
        if t_utc_ns is None:
            expected = "expected ISO 8601 or seconds since 1970"
            log.skip(where, f"time is {cell[:40]!r}; {expected}")
        else:
            values = _values(row, found, altitude, options)
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
            raise PlotfeedError(
                f"--column {quantity}: no such quantity; expected one of {expected}"
            )
        column = next((c for c in columns if c.header == name.strip()), None)
        if column is None:
            raise PlotfeedError(
                f"--column {quantity}={name}: no such column; columns are {headers(columns)}"
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


def _altitude(
    columns: Sequence[TableColumn], named: Mapping[str, TableColumn], options: FlightOptions
) -> AltitudeColumn | None:
    """The column of altitudes; None where the height is the user's."""
    is_litchi = {column.name for column in columns} >= LITCHI
    implied = AltitudeReference.ABOVE_TAKEOFF if is_litchi else None
    found = altitude_column(columns, options.altitude_reference, named.get("altitude_m"), implied)
    if found is None and options.height_m is None:
        error = missing("altitude_m", columns)
        raise PlotfeedError(f"{error}; or give one height with --height-m")
    return found


def _values(
    row: Sequence[str],
    found: Mapping[str, Place],
    altitude: AltitudeColumn | None,
    options: FlightOptions,
) -> dict[str, float]:
    """Quantities of a row in our units; NaN for what is no number there."""
    values = {q: _number(cell_of(row, c)) * factor for q, (c, factor) in found.items()}
    if altitude is not None:
        values["altitude_m"] = _number(cell_of(row, altitude.column)) * altitude.factor
    elif options.height_m is not None:
        values["altitude_m"] = options.height_m
    return values


def _take(
    where: str,
    t_utc_ns: int,
    values: Mapping[str, float],
    reference: AltitudeReference,
    log: Log,
) -> None:
    for quantity in REQUIRED:
        if math.isnan(values[quantity]):
            log.skip(where, f"{quantity} is missing or no number")
            return
    if values["latitude_deg"] == 0 and values["longitude_deg"] == 0:
        log.skip(where, "position 0, 0: no GPS fix")
        return
    velocity = tuple(values.get(q, math.nan) for q in _VELOCITY)
    log.take(
        where,
        t_utc_ns=t_utc_ns,
        latitude_deg=values["latitude_deg"],
        longitude_deg=values["longitude_deg"],
        altitude_m=values["altitude_m"],
        altitude_reference=reference,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        **{q: values[q] for q in _ACCURACIES if q in values and not math.isnan(values[q])},
    )


def _number(cell: str) -> float:
    """NaN where the cell holds no number."""
    try:
        return float(cell)
    except ValueError:
        return math.nan
