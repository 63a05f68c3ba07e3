"""Plots as a message tells of them: structures of arrays, with what it does not say left open."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Columns, Floats, Ints, Texts

NOT_TOLD = -1


@dataclass(frozen=True, kw_only=True)
class MeasuredPlots(Columns):
    """Plots of a message in their order; columns (n,): NaN, "" and -1 are for what it leaves out.

    They are those of `Plots` with ratios in decibels. Heights are above the WGS-84 ellipsoid,
    altitudes above mean sea level. A category is that of ASTERIX, 0 for other formats. Times are
    whole numbers of any size, for files say what they like, or None.
    """

    t_utc_ns: Texts
    sensor: Texts
    """Id of the sensor; "" but in batches of ours."""
    kind: Texts
    identity: Texts
    category: Ints
    sac: Ints
    sic: Ints
    channel: Ints
    range_m: Floats
    bistatic_range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    height_m: Floats
    altitude_m: Floats
    range_rate_m_s: Floats
    snr_db: Floats
    amplitude_dbm: Floats
    sigma_range_m: Floats
    sigma_bistatic_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats

    @classmethod
    def of(cls, plots: Iterable[Mapping[str, Any]]) -> Self:
        """Plots from what is told of each, by the names of the columns; other names are ignored."""
        rows = list(plots)
        columns = {}
        for field in fields(cls):
            absent, dtype = _ABSENT.get(field.name, _NUMBER)
            column: NDArray[Any] = np.empty(len(rows), dtype)
            column[:] = [row.get(field.name, absent) for row in rows]
            columns[field.name] = column
        return cls.holding(columns)


_NUMBER = (math.nan, np.float64)
_ABSENT: Mapping[str, tuple[Any, type]] = {
    "t_utc_ns": (None, np.object_),
    "sensor": ("", np.object_),
    "kind": ("", np.object_),
    "identity": ("", np.object_),
    "category": (0, np.int64),
    "sac": (NOT_TOLD, np.int64),
    "sic": (NOT_TOLD, np.int64),
    "channel": (NOT_TOLD, np.int64),
}
"""What stands for what is not told, and the type of the column, where that is not NaN."""
