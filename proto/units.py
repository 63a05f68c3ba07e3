"""Units in which formats have what models have in others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plotfeed.proto.lazy_numpy import np

if TYPE_CHECKING:
    from plotfeed.models.state import Floats


FOOT_M = 0.3048  # m, exact; international yard and pound agreement, 1959
NM_M = 1852.0  # m, exact; BIPM, The International System of Units
MILE_M = 1609.344  # m, exact: 5280 feet
KNOT_M_S, MILE_H_M_S = NM_M / 3600, MILE_M / 3600
TIME_LSB_NS = 10**9 // 128  # exact: 1/128 s, in which ASTERIX counts


def with_rounding(sigma: Floats, lsb: float | Floats) -> Floats:
    """Standard deviation of a value that travels as a whole number of `lsb`; same unit.

    What rounding adds has the variance lsb^2/12 (Bennett, Bell System Technical Journal 27, 1948).
    """
    deviation: Floats = np.sqrt(sigma * sigma + lsb * lsb / 12)
    return deviation


def decibels(ratio: Floats) -> Floats:
    """10 lg of a ratio of powers; minus infinity for none, NaN for what has no logarithm."""
    with np.errstate(divide="ignore", invalid="ignore"):
        level: Floats = 10 * np.log10(ratio)
    return level
