"""The structures of arrays that cross rooms: what is true, what was looked at, what was measured.

Every column has one row a target, shape (n,) unless it says (n, 3). Floats are float64, times
int64 nanoseconds of UTC since 1970, drones an index into the session's list of drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FALSE_ALARM = -1
"""The drone index of a plot that no drone caused."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Equally long columns, selected and joined by row."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def rows(self, which: NDArray[Any] | slice) -> Self:
        """Those rows: a boolean mask (n,), indices (m,) or a slice."""
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """One structure of all rows of `parts`, in their order; at least one part."""
        parts = [p for p in parts if len(p)] or [parts[0]]
        if len(parts) == 1:
            return parts[0]
        names = [f.name for f in fields(cls)]
        return cls(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthState(Columns):
    """Where drones are: position and velocity in ECEF, (n, 3), each at its own time."""

    drone: Ints
    t_utc_ns: Ints
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats
    rcs_m2: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets(Columns):
    """The same seen from a sensor: position and velocity east, north and up of it, (n, 3)."""

    drone: Ints
    t_utc_ns: Ints
    position_enu_m: Floats
    velocity_enu_m_s: Floats
    rcs_m2: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks(Columns):
    """Each drone that a sensor looked at: true geometry from the sensor, and the odds it had."""

    drone: Ints
    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    snr: Floats
    pd: Floats
    detected: Bools


@dataclass(frozen=True, slots=True, kw_only=True)
class Plots(Columns):
    """What was measured, and privately of whom: the last four columns are never sent to a tracker.

    Azimuth is clockwise from true north in [0, 360), elevation above the sensor's horizontal,
    height above the WGS-84 ellipsoid. `snr` is that of the very detection, linear; the sigmas are
    what the sensor itself would state. NaN stands for what the sensor does not measure, and in
    the true columns for a false alarm.
    """

    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    height_m: Floats
    snr: Floats
    amplitude_dbm: Floats
    run_length_deg: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    drone: Ints
    true_range_m: Floats
    true_azimuth_deg: Floats
    true_elevation_deg: Floats

    @classmethod
    def of(cls, **columns: NDArray[Any]) -> Self:
        """Plots with those columns, of which `t_utc_ns` is one; the others say 'not measured'.

        A plot of no stated drone is a false alarm.
        """
        n = len(columns["t_utc_ns"])
        columns.setdefault("drone", np.full(n, FALSE_ALARM, np.int64))
        missing = [f.name for f in fields(cls) if f.name not in columns]
        return cls(**columns, **dict.fromkeys(missing, np.full(n, np.nan)))

    def in_order_of_time(self) -> Self:
        """The same plots, earliest first; ties keep their order."""
        return self.rows(np.argsort(self.t_utc_ns, kind="stable"))
