"""What the message classes take and no SAPIENT message may hold."""

from __future__ import annotations

import math

import numpy as np

from plotfeed.models.state import Floats
from plotfeed.proto.errors import EncodeError

MAX_UTC_NS = 2**63 - 1  # year 2262: the last that int64 holds
MAX_TEXT = 1000


def check_column(field: str, values: Floats, low: float, high: float) -> None:
    """All within [low, high], or NaN for what was not measured; raises `EncodeError`."""
    wrong = ~((values >= low) & (values <= high) | np.isnan(values)) | np.isinf(values)
    if wrong.any():
        raise EncodeError(_not_within(float(values[wrong][0]), low, high), field=field)


def none_for_nan(values: Floats) -> list[float | None]:
    """A column as a list, with None for what was not measured."""
    return [
        None if missing else v for v, missing in zip(values.tolist(), np.isnan(values), strict=True)
    ]


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
