"""The cover of a sensor, by its keys or by what it says of itself, and what keeps a flight out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from plotfeed.models.beam import AzimuthCover, Volume
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.state import Floats

LIMITS = {
    "range_min_m": 0.0,
    "azimuth_min_deg": -180.0,
    "azimuth_max_deg": 180.0,
    "elevation_min_deg": -90.0,
    "elevation_max_deg": 90.0,
}
"""Keys of cover that not all sensors have, each with what goes for those that have it not."""
HINDRANCES = (
    *("off", "range", "elevation", "direction", "ground", "horizon", "nothing to sense"),
    "too weak",
)
"""What keeps a sensor from seeing something, in the order in which it is asked after."""


@dataclass(frozen=True, slots=True, order=True)
class Hindrance:
    """What keeps a sensor from seeing a flight; of two, the greater one lets more of it through."""

    step: int
    """Index among `HINDRANCES`."""
    short_by_m: float
    """How much too far away it is, below 0."""
    text: str
    """How it is where the flight comes nearest, and what the sensor could see."""

    @classmethod
    def of(cls, kind: str, text: str, short_by_m: float = 0.0) -> Hindrance:
        """A hindrance of one of `HINDRANCES`."""
        return cls(HINDRANCES.index(kind), short_by_m, text)

    @property
    def kind(self) -> str:
        """Which of `HINDRANCES` it is."""
        return HINDRANCES[self.step]


def cover_of(told: Mapping[str, Any]) -> Volume:
    """The cover by a sensor's `range_max_m` and those of `LIMITS` that are told and not None."""
    low_m, low_deg, high_deg, lowest_deg, highest_deg = (
        float(usual if told.get(name) is None else told[name]) for name, usual in LIMITS.items()
    )
    return Volume(
        range_min_m=low_m,
        range_max_m=float(told["range_max_m"]),
        azimuth_cover=AzimuthCover(low_deg, high_deg),
        elevation_min_deg=lowest_deg,
        elevation_max_deg=highest_deg,
    )


def outside(cover: Volume, place_enu_m: Floats) -> Hindrance | None:
    """What keeps all places of a flight, (n, 3), out of a cover; None if one of them lies within.

    Each place is asked for after what the hindrance before has let through.
    """
    azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
    lowest_deg, highest_deg = cover.elevation_min_deg, cover.elevation_max_deg
    every = range_m <= cover.range_max_m
    nearest = int(np.argmin(range_m))
    if not every.any():
        near_m = float(range_m[nearest])
        text = f"{shown_m(near_m)} away at its nearest, it sees to {shown_m(cover.range_max_m)}"
        return Hindrance.of("range", text, cover.range_max_m - near_m)
    every &= (range_m >= cover.range_min_m) & (range_m > 0)
    if not every.any():
        text = f"{shown_m(range_m[nearest])} away, it sees from {shown_m(cover.range_min_m)} on"
        return Hindrance.of("range", text)
    high = every & (elevation_deg >= lowest_deg) & (elevation_deg <= highest_deg)
    if not high.any():
        off_deg = np.maximum(lowest_deg - elevation_deg, elevation_deg - highest_deg)
        best_deg = elevation_deg[int(np.argmin(np.where(every, off_deg, np.inf)))]
        looks = f"it looks from {lowest_deg:.0f}° to {highest_deg:.0f}°"
        return Hindrance.of("elevation", f"{best_deg:.0f}° high at best, {looks}")
    inside = high & (cover.azimuth_cover.holds(azimuth_deg) | np.isnan(azimuth_deg))
    if inside.any():
        return None
    at_deg = azimuth_deg[int(np.argmin(np.where(high, range_m, np.inf)))]
    low_deg, high_deg = (
        float(deg) % 360 for deg in (cover.azimuth_cover.min_deg, cover.azimuth_cover.max_deg)
    )
    text = f"at {at_deg:.0f}° where it is nearest, it looks from {low_deg:.0f}° to {high_deg:.0f}°"
    return Hindrance.of("direction", text)


def shown_m(distance_m: float) -> str:
    """A distance to read, such as 1.86e+03 km."""
    return f"{distance_m / 1000:.3g} km" if distance_m >= 1000 else f"{distance_m:.0f} m"
