"""Logs of flights and what their files do not say, as scenes and as paths through space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from support import given_files
from support.significance import Array

from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.telemetry.flights import BY_SUFFIX, read, smoothed
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.utc import NS
from plotfeed.testing import radar


@dataclass(frozen=True, eq=False)
class GivenFlight:
    """A file, the datum of its altitudes, and a radar a kilometre or so to the south."""

    file: str
    datum_m: float  # Of its altitudes above the ellipsoid
    datum: dict[str, float]  # The same as keys of a scene
    reference: AltitudeReference | None = None  # Where the file does not say it
    step_m: float = 1.0  # About how coarsely the log writes positions

    @property
    def log(self) -> Path:
        (path,) = given_files.places(f"flights/{self.file}")
        return path

    @cached_property
    def recorded(self) -> Flight:
        return read(self.log, FlightOptions(altitude_reference=self.reference))

    @cached_property
    def flight(self) -> Flight:
        return smoothed(self.recorded)

    @cached_property
    def site(self) -> LocalFrame:
        first = self.flight.reports[0]
        below_m = first.altitude_m + self.datum_m - 20.0
        return LocalFrame(first.latitude_deg - 0.012, first.longitude_deg + 0.002, below_m)

    @cached_property
    def times_s(self) -> Array:
        """Since its start."""
        t_ns = np.array([r.t_utc_ns for r in self.flight.reports])
        return np.asarray((t_ns - t_ns[0]) / NS)

    @cached_property
    def knots_enu_m(self) -> Array:
        return self._enu_m(self.flight)

    @cached_property
    def recorded_enu_m(self) -> Array:
        return self._enu_m(self.recorded)

    @cached_property
    def path(self) -> CubicHermiteSpline:
        """Place from the site after seconds: the cubics with the reports' velocities."""
        velocities = []
        for r in self.flight.reports:
            assert r.velocity_enu_m_s is not None
            there = LocalFrame(r.latitude_deg, r.longitude_deg, r.altitude_m + self.datum_m)
            ecef = there.rotate_to_ecef(np.array(r.velocity_enu_m_s))
            velocities.append(self.site.rotate_from_ecef(ecef))
        return CubicHermiteSpline(self.times_s, self.knots_enu_m, np.array(velocities))

    def _enu_m(self, flight: Flight) -> Array:
        ecef = geodetic_to_ecef(
            [r.latitude_deg for r in flight.reports],
            [r.longitude_deg for r in flight.reports],
            [r.altitude_m + self.datum_m for r in flight.reports],
        )
        return np.asarray(self.site.from_ecef(ecef))

    def scene(self, *sensors: dict[str, Any], seed: int, **more: Any) -> Scene:
        site = {
            "latitude_deg": self.site.latitude_deg,
            "longitude_deg": self.site.longitude_deg,
            "height_m": self.site.height_m,
        }
        general = {"name": "flight", "seed": seed, "site": site}
        tree = {"scene": general, "sensor": [radar(**s) for s in sensors]} | more
        return from_tree(tree, self.log.with_name("scene.toml"))

    def as_drone(self) -> dict[str, Any]:
        reference = {"altitude_reference": self.reference.value} if self.reference else {}
        return {"id": "d", "flight": {"file": self.file} | self.datum | reference}


SEA = AltitudeReference.MEAN_SEA_LEVEL
FLIGHTS = [
    GivenFlight("eight.srt", 172.0, {"takeoff_height_m": 172.0}, step_m=11.0),
    GivenFlight("eight.csv", 52.0, {"geoid_undulation_m": 52.0}, SEA),
    GivenFlight("eight.bin", 52.0, {"geoid_undulation_m": 52.0}),
]
if given_files.more_input():
    FLIGHTS += [
        GivenFlight("matrice_300.srt", 62.0, {"takeoff_height_m": 62.0}, step_m=11.0),
        GivenFlight("UAV_Rot.csv", 57.0, {"geoid_undulation_m": 57.0}, SEA),
        GivenFlight("log171.bin", 19.0, {"geoid_undulation_m": 19.0}),
    ]
EVERY_FLIGHT = pytest.mark.parametrize("flight", FLIGHTS, ids=lambda each: each.file)


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
