"""Times of a table's rows: of a clock, a date and a time of day, a count, or two of these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal, InvalidOperation

from plotfeed.feeds.telemetry.flights.file_times import (
    finer_times,
    is_day_first,
    midnight_ns,
    parse_time_ns,
    time_of_day_ns,
)
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.feeds.telemetry.flights.table_columns import (
    DATE,
    ELAPSED,
    SECONDS,
    TIME,
    TIME_OF_DAY,
    TableColumn,
    missing,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

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
        log.assume(f"times are {offset_h:+g} h from UTC (--utc-offset-h)")
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
