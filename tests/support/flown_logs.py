"""Logs of flights as octets, what a reader makes of them, and how smoothing changes that."""

from __future__ import annotations

import math

import numpy as np
from support.significance import Array

from plotfeed.feeds.telemetry.flights import BY_SUFFIX
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.frames import geodetic_to_ecef


def flown(suffix: str, data: str | bytes, **options: object) -> Flight:
    """The flight in a file of that suffix that holds that; raises `PlotfeedError`."""
    log = Log()
    octets = data.encode() if isinstance(data, str) else data
    BY_SUFFIX[suffix](octets, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


def places(flight: Flight) -> list[tuple[float, float, float]]:
    return [(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in flight.reports]


def speeds(flight: Flight) -> Array:
    """Over ground, m/s."""
    return np.array([math.hypot(*r.velocity_enu_m_s[:2]) for r in flight.reports])


def moved_m(a: Flight, b: Flight) -> float:
    """The furthest over ground that a report of one is from that of the other."""
    first, second = (
        geodetic_to_ecef(*np.array([(*place[:2], 0.0) for place in places(f)]).T) for f in (a, b)
    )
    return float(np.linalg.norm(first - second, axis=1).max())
