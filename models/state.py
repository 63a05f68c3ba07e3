"""The structures of arrays that cross rooms: what is true, what was looked at, what was measured.

Every column has one row a target, shape (n,) unless it says (n, 3). Floats are float64, times
int64 nanoseconds of UTC since 1970, drones an index into the session's list of drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FALSE_ALARM = -1
"""The drone index of a plot that no drone caused."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Texts = NDArray[np.object_]


def rows_where(mask: Bools) -> Ints | slice:
    """What selects the rows of a mask (n,): all of them without copying, where it holds all."""
    return slice(None) if mask.all() else np.flatnonzero(mask)


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Equally long columns, selected and joined by row."""

    def __len__(self) -> int:
        return len(getattr(self, self._names()[0]))

    @classmethod
    @cache
    def _names(cls) -> tuple[str, ...]:
        return tuple(f.name for f in fields(cls))

    def rows(self, which: NDArray[Any]) -> Self:
        """Those rows: a boolean mask (n,), or distinct indices (m,)."""
        if which.dtype == np.bool_:
            if which.all():
                return self
            which = np.flatnonzero(which)
        columns = {name: getattr(self, name) for name in self._names()}
        return type(self)(
            **{
                # What is the same throughout is not copied, value by value, to be the same again.
                name: column[: len(which)] if column.strides[0] == 0 else column[which]
                for name, column in columns.items()
            }
        )

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """One structure of all rows of `parts`, in their order; at least one part."""
        parts = [p for p in parts if len(p)] or [parts[0]]
        if len(parts) == 1:
            return parts[0]
        return cls(
            **{name: np.concatenate([getattr(p, name) for p in parts]) for name in cls._names()}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthState(Columns):
    """Where drones are: position and velocity in ECEF, (n, 3), each at its own time."""

    drone: Ints
    t_utc_ns: Ints
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Emitter:
    """Something on a drone that radiates; `identity` is what its emission says when decoded."""

    frequency_hz: float
    bandwidth_hz: float = 0.0
    eirp_dbm: float = 0.0
    kind: str = ""
    identity: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """What there is of a drone to sense; NaN where it is not known."""

    rcs_m2: float = np.nan
    sound_power_db: float = np.nan
    """Re 1 pW."""
    emitters: tuple[Emitter, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Signatures:
    """The signatures of all drones, by their index: columns (n,)."""

    rcs_m2: Floats
    sound_power_db: Floats
    emitters: Sequence[tuple[Emitter, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Drones seen from a sensor, east, north and up of it, (n, 3), at the times of measurement.

    `position_enu_m` is where the signal that is measured left the drone, `true_position_enu_m`
    where the drone is at the time of measurement: they differ only for sound.
    """

    drone: Ints
    t_utc_ns: Ints
    position_enu_m: Floats
    true_position_enu_m: Floats
    signatures: Signatures

    def __len__(self) -> int:
        return len(self.drone)

    def rcs_m2(self, rows: Ints | slice = slice(None)) -> Floats:
        """Radar cross-sections of those rows; (m,)."""
        return self.signatures.rcs_m2[self.drone[rows]]

    def sound_power_db(self, rows: Ints | slice = slice(None)) -> Floats:
        """Sound power levels of those rows, dB re 1 pW; (m,)."""
        return self.signatures.sound_power_db[self.drone[rows]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks(Columns):
    """Each drone that a sensor looked at: geometry as it was sensed, and the odds it had.

    `channel` is the transmitter or emitter by whose signal it was looked at, where a sensor looks
    by several, else 0.
    """

    drone: Ints
    channel: Ints
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
    height above the WGS-84 ellipsoid, bistatic range the path transmitter-target-receiver less the
    baseline. `snr` is that of the very detection, linear; sigmas and covariances, of the position
    east and north, are what the sensor itself would state. NaN and "" stand for what the sensor
    does not measure, NaN also in the true columns for a false alarm. `channel` is as in `Looks`.
    """

    t_utc_ns: Ints
    channel: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    height_m: Floats
    bistatic_range_m: Floats
    snr: Floats
    amplitude_dbm: Floats
    run_length_deg: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    sigma_bistatic_range_m: Floats
    covariance_east_m2: Floats
    covariance_north_m2: Floats
    covariance_east_north_m2: Floats
    kind: Texts
    identity: Texts
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
        return cls(
            **{
                name: columns[name] if name in columns else np.broadcast_to(_absent(name), n)
                for name in cls._names()
            }
        )

    def in_order_of_time(self) -> Self:
        """The same plots, earliest first; ties keep their order."""
        return self.rows(np.argsort(self.t_utc_ns, kind="stable"))


_ABSENT = {
    "drone": np.array(FALSE_ALARM, np.int64),
    "channel": np.array(0, np.int64),
    "kind": np.array("", np.object_),
    "identity": np.array("", np.object_),
}
_UNMEASURED = np.array(np.nan)


def _absent(name: str) -> NDArray[Any]:
    """What stands in a column of plots that a sensor does not fill; ()."""
    return _ABSENT.get(name, _UNMEASURED)
