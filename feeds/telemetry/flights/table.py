"""Tables of comma-separated values with a line of column names."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log, utc_ns
from plotfeed.proto.errors import PlotfeedError

KNOWN_NAMES: Mapping[str, Sequence[str]] = {
    "time": (
        "time", "time_utc", "t_utc_ns", "utc", "utc_time", "datetime", "datetime_utc", "date_time",
        "timestamp", "timestamp_utc", "timestamp_ms", "timestamp_us", "timestamp_ns", "epoch",
        "unix_time", "time_s", "t",
    ),
    "latitude_deg": ("latitude_deg", "latitude", "lat", "lat_deg"),
    "longitude_deg": ("longitude_deg", "longitude", "lon", "lng", "long", "lon_deg", "lng_deg"),
    "altitude_m": (
        "altitude_m", "altitude", "alt", "alt_m", "height_m", "height", "elevation", "elevation_m",
        "ele",
    ),
    "velocity_east_m_s": ("velocity_east_m_s", "v_east_m_s", "ve_m_s", "vel_e_m_s"),
    "velocity_north_m_s": ("velocity_north_m_s", "v_north_m_s", "vn_m_s", "vel_n_m_s"),
    "velocity_up_m_s": ("velocity_up_m_s", "v_up_m_s", "vu_m_s", "climb_m_s"),
    "horizontal_accuracy_m": ("horizontal_accuracy_m", "hacc_m", "h_acc_m"),
    "vertical_accuracy_m": ("vertical_accuracy_m", "vacc_m", "v_acc_m"),
    "velocity_accuracy_m_s": ("velocity_accuracy_m_s", "sacc_m_s", "s_acc_m_s"),
}  # fmt: skip
"""Quantity to the column names taken for it, unless the user names one.

Velocities are only taken where the name tells direction and unit: `vx` may be north or east.
"""
REQUIRED = ("time", "latitude_deg", "longitude_deg", "altitude_m")
_VELOCITY = ("velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s")
_ACCURACIES = ("horizontal_accuracy_m", "vertical_accuracy_m", "velocity_accuracy_m_s")

_EPOCH_DIGITS = ((Decimal("1e11"), 10**9), (Decimal("1e14"), 10**6), (Decimal("1e17"), 10**3))
"""Times since 1970 under each are in seconds, ms, us; above the last in ns."""
_EARLIEST_EPOCH = Decimal("1e8")
"""1973 in seconds: a smaller number is the time of something else, such as a day."""
_LATEST_NS = Decimal(2**63)


def read_table(text: str, options: FlightOptions, log: Log) -> None:
    """Take every row that has a time and a position."""
    if options.altitude_reference is None:
        raise PlotfeedError(
            "a table does not say what its altitudes are measured from; say so with "
            "--altitude-reference above_takeoff, mean_sea_level or ellipsoid"
        )
    header, rows = _rows(text, log)
    columns = _columns(header, options.columns, rows, options.utc_offset_h)
    for line, row in rows:
        cells = {q: row[i].strip() if i < len(row) else "" for q, i in columns.items()}
        _take(f"line {line}", cells, options, log)


def _rows(text: str, log: Log) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Column names, and line number and cells of every other row that is not empty."""
    lines = text.splitlines()
    start = next((i for i, s in enumerate(lines) if s.strip() and not s.startswith("#")), None)
    if start is None:
        raise PlotfeedError("empty table")
    delimiter = max(",;\t", key=lines[start].count)
    reader = csv.reader(lines[start:], delimiter=delimiter)
    rows: list[tuple[int, list[str]]] = []
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
    return [name.strip() for name in rows[0][1]], rows[1:]


def _columns(
    header: list[str],
    named: Mapping[str, str],
    rows: list[tuple[int, list[str]]],
    utc_offset_h: float,
) -> dict[str, int]:
    """Quantity to the index of its column."""
    for quantity, name in named.items():
        if quantity not in KNOWN_NAMES:
            expected = ", ".join(KNOWN_NAMES)
            raise PlotfeedError(
                f"--column {quantity}: no such quantity; expected one of {expected}"
            )
        if name not in header:
            names = ", ".join(header)[:300]
            raise PlotfeedError(f"--column {quantity}={name}: no such column; columns are {names}")
    # "Altitude (m)" is altitude_m among our names.
    plain = [re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") for name in header]
    columns = {quantity: header.index(name) for quantity, name in named.items()}
    for quantity, known in KNOWN_NAMES.items():
        fitting = [plain.index(name) for name in known if name in plain]
        if quantity == "time":  # some tables have several, and one of them is a time of day
            fitting = [i for i in fitting if _is_time(i, rows, utc_offset_h)] or fitting
        if fitting:
            columns.setdefault(quantity, fitting[0])
    for quantity in REQUIRED:
        if quantity not in columns:
            raise PlotfeedError(
                f"no column found for {quantity}; name it with --column {quantity}=NAME; "
                f"columns are {', '.join(header)[:300]}"
            )
    return columns


def _is_time(column: int, rows: list[tuple[int, list[str]]], utc_offset_h: float) -> bool:
    cells = rows[0][1] if rows else []
    return column < len(cells) and parse_time_ns(cells[column], utc_offset_h) is not None


def _take(where: str, cells: Mapping[str, str], options: FlightOptions, log: Log) -> None:
    t_utc_ns = parse_time_ns(cells["time"], options.utc_offset_h)
    if t_utc_ns is None:
        log.skip(where, f"time is {cells['time'][:40]!r}; expected ISO 8601 or seconds since 1970")
        return
    values = {q: _number(cell) for q, cell in cells.items() if q != "time"}
    for quantity in REQUIRED[1:]:
        if math.isnan(values[quantity]):
            log.skip(where, f"{quantity} is {cells[quantity][:40]!r}; expected a number")
            return
    velocity = tuple(values.get(q, math.nan) for q in _VELOCITY)
    log.take(
        where,
        t_utc_ns=t_utc_ns,
        latitude_deg=values["latitude_deg"],
        longitude_deg=values["longitude_deg"],
        altitude_m=values["altitude_m"],
        altitude_reference=options.altitude_reference,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        **{q: values[q] for q in _ACCURACIES if q in values and not math.isnan(values[q])},
    )


def _number(cell: str) -> float:
    """NaN where the cell holds no number."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def parse_time_ns(cell: str, utc_offset_h: float) -> int | None:
    """UTC, nanoseconds since 1970, of an ISO 8601 time or a number since 1970; None if neither.

    Numbers may be seconds, ms, us or ns: which one, their size tells.
    """
    try:
        return _epoch_ns(Decimal(cell.strip()))
    except InvalidOperation:
        pass
    try:
        return utc_ns(datetime.fromisoformat(cell.strip()), utc_offset_h)
    except (ValueError, OverflowError):
        return None


def _epoch_ns(since_1970: Decimal) -> int | None:
    if not since_1970.is_finite() or not _EARLIEST_EPOCH <= since_1970 < _LATEST_NS:
        return None
    unit_ns = next((unit for below, unit in _EPOCH_DIGITS if since_1970 < below), 1)
    return round(since_1970 * unit_ns)
