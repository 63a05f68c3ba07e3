"""How a flight that was smoothed differs from what was read."""

from __future__ import annotations

import math

import numpy as np
from support.significance import Array

from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.models.frames import geodetic_to_ecef


def speeds(flown: Flight) -> Array:
    """Over ground, m/s."""
    return np.array([math.hypot(*r.velocity_enu_m_s[:2]) for r in flown.reports])


def moved_m(a: Flight, b: Flight) -> float:
    """The furthest over ground that a report of one is from that of the other."""
    first, second = (
        geodetic_to_ecef(*np.array([(r.latitude_deg, r.longitude_deg, 0.0) for r in f.reports]).T)
        for f in (a, b)
    )
    return float(np.linalg.norm(first - second, axis=1).max())
