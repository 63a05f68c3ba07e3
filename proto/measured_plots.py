"""Plots as a message tells of them: structures of arrays, with what it does not say left open."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Columns, Floats, Ints, Texts, endless

NOT_TOLD = -1


@dataclass(frozen=True, kw_only=True)
class MeasuredPlots(Columns):
    """Plots of a message in their order; columns (n,): NaN, "" and -1 are for what it leaves out.

    They are those of `Plots` with ratios in decibels, and what transponders and trackers tell
    besides. Heights are above the WGS-84 ellipsoid,
    altitudes above mean sea level. A category is that of ASTERIX, 0 for other formats. Times are
    whole numbers of any size, for files say what they like, or None.
    """

    t_utc_ns: Texts
    sensor: Texts  # Id of the sensor; "" but in batches of ours
    category: Ints
    sac: Ints
    sic: Ints
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
    channel: Ints
    kind: Texts
    identity: Texts
    mode_3a: Texts  # Of transponders, in octal
    address: Texts  # Of Mode S, in hexadecimal
    track: Ints
    flight_level: Floats  # In hundreds of feet, by a barometer set to 1013.25 hPa
    ssr_amplitude_dbm: Floats  # Of a transponder's reply
    latitude_deg: Floats
    longitude_deg: Floats
    east_m: Floats  # From the sensor; of a tracker, from its reference point
    north_m: Floats
    velocity_east_m_s: Floats
    velocity_north_m_s: Floats
    climb_m_s: Floats
    sigma_range_rate_m_s: Floats
    kind_probability: Floats

    @classmethod
    def of(cls, plots: Iterable[Mapping[str, Any]]) -> Self:
        """Plots from what is told of each, by the names of the columns; other names are ignored."""
        rows = list(plots)
        told = set().union(*rows)
        return cls.holding(
            {
                name: np.array([row.get(name, absent[0]) for row in rows], absent.dtype)
                if name in told
                else absent[: len(rows)]
                for name, absent in ABSENT.items()
            }
        )


# What stands in the columns of which no plot of a message tells anything.
ABSENT: Mapping[str, NDArray[Any]] = {
    **dict.fromkeys((field.name for field in fields(MeasuredPlots)), endless(math.nan, np.float64)),
    "t_utc_ns": endless(None, np.object_),
    **dict.fromkeys(("sensor", "kind", "identity", "mode_3a", "address"), endless("", np.object_)),
    **dict.fromkeys(("sac", "sic", "channel", "track"), endless(NOT_TOLD, np.int64)),
    "category": endless(0, np.int64),
}
