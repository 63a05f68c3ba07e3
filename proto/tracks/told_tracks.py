"""Tracks of sensors as all formats of tracks are given them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Bools, Columns, Floats, Ints


@dataclass(frozen=True, kw_only=True)
class Tracks(Columns):
    """Tracks of a sensor at their own times; columns (n,), NaN for what it does not estimate.

    East and north are from the system's reference point, height is above the WGS-84 ellipsoid,
    age is that of the last plot in a track. `coasted` tracks are predicted without one, `first`
    and `last` reports begin and end a track.
    """

    track: Ints
    t_utc_ns: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    east_m: Floats
    north_m: Floats
    velocity_east_m_s: Floats
    velocity_north_m_s: Floats
    height_m: Floats
    climb_m_s: Floats
    age_s: Floats
    sigma_east_m: Floats
    sigma_north_m: Floats
    tentative: Bools
    coasted: Bools
    first: Bools
    last: Bools


@dataclass(frozen=True, kw_only=True)
class ToldTracks(Tracks):
    """Tracks as `Tracks` has them, with what 062 has no room for; NaN for what is not estimated.

    Standard deviations are one sigma, of the position upwards and of the velocity's components.
    """

    sigma_up_m: Floats
    sigma_velocity_east_m_s: Floats
    sigma_velocity_north_m_s: Floats
    sigma_climb_m_s: Floats

    @property
    def speed_m_s(self) -> Floats:
        """Speed over the ground, m/s, (n,)."""
        return np.hypot(self.velocity_east_m_s, self.velocity_north_m_s)

    @property
    def course_deg(self) -> Floats:
        """Clockwise from true north in [0, 360), (n,)."""
        course = np.degrees(np.arctan2(self.velocity_east_m_s, self.velocity_north_m_s)) % 360.0
        return np.where(course == 360.0, 0.0, course)

    @property
    def sigma_level_m(self) -> Floats:
        """The larger one of the deviations east and north, (n,)."""
        return np.maximum(self.sigma_east_m, self.sigma_north_m)

    @property
    def sigma_speed_m_s(self) -> Floats:
        """The larger one of the deviations of the level velocity's components, (n,)."""
        return np.maximum(self.sigma_velocity_east_m_s, self.sigma_velocity_north_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOrigin:
    """Whose tracks they are, and from where: what is the same in all messages of a sensor."""

    sensor: str
    kind: Literal["smoothed-truth", "plain"]
    stale_after_s: float  # A track of which nothing has come for so long is gone

    def name_of(self, number: int) -> str:
        """Name a track so that no other of the session has it."""
        return f"{self.sensor}-{number}"

    def short_name_of(self, number: int, most: int = 24) -> str:
        """Name a track in so many characters; what does not fit gives way to a digest of it."""
        name = self.name_of(number)
        if len(name) <= most and name.isascii():
            return name
        digest = blake2b(self.sensor.encode(), digest_size=4).hexdigest()
        return f"{digest}-{number}"


Told = dict[str, Any]  # One track: columns by their names, None for what is not estimated


def one_by_one(tracks: ToldTracks) -> list[Told]:
    """Tracks as values of Python, with speed, course and the deviations of these."""
    columns: dict[str, NDArray[Any]] = dict(vars(tracks))
    columns |= {name: getattr(tracks, name) for name in _DERIVED}
    lists = [_values(column) for column in columns.values()]
    return [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]


def _values(column: NDArray[Any]) -> list[Any]:
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f" and np.isnan(column).any():
        return [None if value != value else value for value in values]  # noqa: PLR0124 - NaN is not
    return values


_DERIVED = ("speed_m_s", "course_deg", "sigma_level_m", "sigma_speed_m_s")
_DTYPES = {"Ints": np.int64, "Bools": np.bool_, "Floats": np.float64}
NO_TRACKS = ToldTracks(**{f.name: np.zeros(0, _DTYPES[str(f.type)]) for f in fields(ToldTracks)})
