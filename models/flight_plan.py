"""How a drone gets from place to place within its limits: knots of position and velocity.

Places are metres east and north on the plane that touches the Earth at a site, and heights above
the site's ellipsoidal one: flight at one height follows the curved Earth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import LocalFrame, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import Floats

MAX_STRETCH_M = 2000.0  # A cubic this long follows the curved Earth within a micrometre
ARC_DEG = 2.0  # A cubic this long leaves its circle by less than a 20,000th of the radius
# Of the acceleration an orbit may need this much; 0.6 are left to gain and lose speed by.
CENTRIPETAL_SHARE = 0.8
STEP_S = 0.1  # Velocities are turned into another space by a difference over this
LEVEL_STEPS = 4  # Each brings a height on the plane 10,000 times as near, out to 100 km


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLimits:
    """What a drone can do: greatest speeds, up and down too, and greatest acceleration."""

    speed_m_s: float
    climb_m_s: float
    sink_m_s: float
    acceleration_m_s2: float

    def orbit_speed_m_s(self, radius_m: float) -> float:
        """The greatest speed on a circle, by the acceleration towards its centre."""
        centripetal_m_s2 = CENTRIPETAL_SHARE * self.acceleration_m_s2
        return min(self.speed_m_s, float(np.sqrt(centripetal_m_s2 * radius_m)))


class FlightKnots(NamedTuple):
    """Times in seconds, (n,), positions in metres and velocities in m/s, (n, 3)."""

    t_s: Floats
    position_m: Floats
    velocity_m_s: Floats


class FlightPlan:
    """Manoeuvres one after the other, each by constant accelerations; all but `drift` end at rest.

    Between two knots a drone follows the cubic through both (Hermite), which is exact on straight
    stretches.
    """

    def __init__(
        self, limits: FlightLimits, position_m: ArrayLike, velocity_m_s: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Begin there, at that velocity."""
        self.limits = limits
        self._t_s = [0.0]
        self._position_m = [as_floats(position_m)]
        self._velocity_m_s = [as_floats(velocity_m_s)]

    @property
    def end_s(self) -> float:
        """How long all of it takes so far, seconds."""
        return self._t_s[-1]

    @property
    def place_m(self) -> Floats:
        """The place where it ends so far."""
        return self._position_m[-1]

    def knots(self) -> FlightKnots:
        """All of it so far."""
        return FlightKnots(
            np.array(self._t_s), np.array(self._position_m), np.array(self._velocity_m_s)
        )

    def stop(self) -> None:
        """Brake where it flies."""
        self._change_velocity(np.zeros(3))

    def hover(self, for_s: float) -> None:
        """Stay where it comes to rest."""
        self.stop()
        if for_s > 0:
            self._add(np.array([for_s]), self.place_m[None], np.zeros((1, 3)))

    def fly_to(self, place_m: ArrayLike, speed_m_s: float | None = None) -> None:
        """Fly straight to a place, from rest to rest; slower where the way climbs or sinks."""
        self.stop()
        start_m, way_m = self.place_m, as_floats(place_m) - self.place_m
        length_m = float(np.linalg.norm(way_m))
        if length_m == 0.0:
            return
        direction = way_m / length_m
        up, limits = float(direction[2]), self.limits
        speed = limits.speed_m_s if speed_m_s is None else min(speed_m_s, limits.speed_m_s)
        if up:
            speed = min(speed, (limits.climb_m_s if up > 0 else limits.sink_m_s) / abs(up))
        durations_s, gone_m, speeds = self._paced(length_m, speed, MAX_STRETCH_M)
        self._add(durations_s, start_m + gone_m[:, None] * direction, speeds[:, None] * direction)

    def orbit(
        self,
        centre_m: ArrayLike,
        radius_m: float,
        *,
        turns: float = 1.0,
        speed_m_s: float | None = None,
        is_clockwise: bool = True,
    ) -> None:
        """Fly to the nearest point of a circle at its centre's height, and so often round it."""
        centre = as_floats(centre_m)
        out_m = (self.place_m - centre)[:2]
        begin_rad = float(np.arctan2(*out_m)) if out_m.any() else 0.0  # clockwise from north

        self.fly_to(centre + radius_m * _level(begin_rad), speed_m_s)
        speed = self.limits.orbit_speed_m_s(radius_m)
        speed = speed if speed_m_s is None else min(speed, speed_m_s)
        sense = 1.0 if is_clockwise else -1.0
        length_m, step_m = 2 * np.pi * radius_m * turns, radius_m * np.radians(ARC_DEG)
        centripetal = speed**2 / radius_m
        tangential = (self.limits.acceleration_m_s2**2 - centripetal**2) ** 0.5
        durations_s, gone_m, speeds = self._paced(length_m, speed, step_m, tangential)
        angle = begin_rad + sense * gone_m / radius_m
        along = sense * _level(angle + np.pi / 2)
        self._add(durations_s, centre + radius_m * _level(angle), speeds[:, None] * along)

    def drift(self, velocity_m_s: ArrayLike, for_s: float) -> None:
        """Take on a velocity, whatever the limits of speed, and keep it."""
        velocity = as_floats(velocity_m_s)
        self._change_velocity(velocity)
        stretches = max(1, int(np.ceil(float(np.linalg.norm(velocity)) * for_s / MAX_STRETCH_M)))
        steps_s = np.full(stretches, for_s / stretches)
        way_m = np.cumsum(steps_s)[:, None] * velocity
        self._add(steps_s, self.place_m + way_m, np.broadcast_to(velocity, way_m.shape))

    def _change_velocity(self, velocity_m_s: Floats) -> None:
        before = self._velocity_m_s[-1]
        duration_s = float(np.linalg.norm(velocity_m_s - before)) / self.limits.acceleration_m_s2
        if duration_s > 0:
            mean_m_s = (before + velocity_m_s) / 2
            end_m = self.place_m + duration_s * mean_m_s
            self._add(np.array([duration_s]), end_m[None], velocity_m_s[None])

    def _add(self, durations_s: Floats, position_m: Floats, velocity_m_s: Floats) -> None:
        """Go on through knots: how long each takes, (n,), where it is and how fast, (n, 3)."""
        self._t_s += (self.end_s + np.cumsum(durations_s)).tolist()
        self._position_m += [*position_m]
        self._velocity_m_s += [*velocity_m_s]

    def _paced(
        self, length_m: float, speed_m_s: float, step_m: float, gain_m_s2: float | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """A way from rest to rest: each knot how long after the last, how far, how fast; (n,)."""
        gain = self.limits.acceleration_m_s2 if gain_m_s2 is None else gain_m_s2
        top = min(speed_m_s, (gain * length_m) ** 0.5)
        ramp_m = min(top**2 / (2 * gain), length_m / 2)
        steps = max(1, int(np.ceil(length_m / step_m)))
        cuts = [*np.linspace(0.0, length_m, steps + 1).tolist(), ramp_m, length_m - ramp_m]
        gone_m = np.unique(np.clip(cuts, 0.0, length_m))
        gone_m = gone_m[np.append(np.diff(gone_m) > 1e-9 * length_m, True)]
        speeds = np.minimum(top, np.sqrt(2 * gain * np.minimum(gone_m, length_m - gone_m)))
        mean = (speeds[1:] + speeds[:-1]) / 2
        return np.diff(gone_m) / mean, gone_m[1:], speeds[1:]


def _level(angle_rad: ArrayLike) -> Floats:
    """Unit vectors at angles clockwise from north, without height; (..., 3)."""
    angle = as_floats(angle_rad)
    return np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def level_to_ecef(frame: LocalFrame, level_m: ArrayLike) -> Floats:
    """ECEF of places on a site's plane and above it, as at the head of this file; (..., 3)."""
    east, north, above = np.moveaxis(as_floats(level_m), -1, 0)
    on_plane = np.stack([east, north, np.zeros_like(east)], axis=-1)
    latitude_deg, longitude_deg, _ = frame.to_geodetic(on_plane)
    return geodetic_to_ecef(latitude_deg, longitude_deg, frame.height_m + above)


def level_from_ecef(frame: LocalFrame, ecef_m: ArrayLike) -> Floats:
    """The inverse of `level_to_ecef`."""
    latitude_deg, longitude_deg, height_m = ecef_to_geodetic(ecef_m)
    plane_m = np.full_like(height_m, frame.height_m)
    for _ in range(LEVEL_STEPS):
        enu_m = frame.from_ecef(geodetic_to_ecef(latitude_deg, longitude_deg, plane_m))
        plane_m = plane_m - enu_m[..., 2]
    return np.stack([enu_m[..., 0], enu_m[..., 1], height_m - frame.height_m], axis=-1)


def to_ecef(frame: LocalFrame, knots: FlightKnots) -> FlightKnots:
    """Knots in ECEF, of those on a site's plane and above it."""
    ahead, behind = (
        level_to_ecef(frame, knots.position_m + step_s * knots.velocity_m_s)
        for step_s in (STEP_S, -STEP_S)
    )
    velocity = (ahead - behind) / (2 * STEP_S)
    return FlightKnots(knots.t_s, level_to_ecef(frame, knots.position_m), velocity)


def level_velocity(frame: LocalFrame, ecef_m: Floats, velocity_ecef_m_s: Floats) -> Floats:
    """Velocities on a site's plane and above it, of ECEF positions and velocities; (..., 3)."""
    ahead, behind = (
        level_from_ecef(frame, ecef_m + step_s * velocity_ecef_m_s) for step_s in (STEP_S, -STEP_S)
    )
    return (ahead - behind) / (2 * STEP_S)
