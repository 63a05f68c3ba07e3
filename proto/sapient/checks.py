"""What the message classes take and no SAPIENT message may hold."""

from __future__ import annotations

import math

from plotfeed.models.state import Floats
from plotfeed.proto.errors import EncodeError

MAX_UTC_NS = 2**63 - 1  # year 2262: the last that int64 holds
MAX_TEXT = 1000


def measured(field: str, values: Floats, low: float, high: float) -> list[float | None]:
    """A column within [low, high], None for NaN: what was not measured; raises `EncodeError`.

    Value by value: most columns have a few rows, and NumPy takes longer to begin than these do.
    """
    return [
        value if low <= value <= high else _none_for_nan(field, value, low, high)
        for value in values.tolist()
    ]


def _none_for_nan(field: str, value: float, low: float, high: float) -> float | None:
    if math.isnan(value):
        return None
    raise EncodeError(_not_within(value, low, high), field=field)


def check_number(field: str, value: float, low: float, high: float) -> None:
    """Within [low, high] and finite; raises `EncodeError`."""
    if not (low <= value <= high and math.isfinite(value)):
        raise EncodeError(_not_within(value, low, high), field=field)


def check_text(field: str, value: str) -> None:
    """Neither empty nor endless; raises `EncodeError`."""
    if not 0 < len(value) <= MAX_TEXT:
        raise EncodeError(f"expected 1 to {MAX_TEXT} characters, not {len(value)}", field=field)


def check_time(t_utc_ns: int) -> None:
    """From 1970 on; raises `EncodeError`."""
    if not 0 <= t_utc_ns <= MAX_UTC_NS:
        raise EncodeError(f"{t_utc_ns} ns is not from 1970 to 2262", field="timestamp")


def _not_within(value: float, low: float, high: float) -> str:
    return f"{value:g} is not a number from {low:g} to {high:g}"
