"""What else moves: flocks, traffic and rotors, as knots of place and velocity on their ways.

Birds of a flock keep to a leader, with velocities about its own that are Ornstein-Uhlenbeck
processes; cars on a road are a Poisson process; a point of a rotor goes round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import OTHER, Floats

SMALL = 0.02  # Time constants below which variances of ways are series
# Of birds that flap (Alerstam et al. 2007, PLoS Biology 5(8) e197).
AIRSPEED_OF_1_KG_M_S, BY_MASS = 15.9, 0.13


def other_name(what: str, name: str, number: int | None = None) -> str:
    """The name among drones of what is none."""
    return f"{what}{OTHER}{name}" + ("" if number is None else f"-{number}")


def airspeed_m_s(mass_kg: ArrayLike) -> Floats:
    """Speed of birds by their mass, 8 to 23 m/s from a warbler to a swan."""
    return np.asarray(AIRSPEED_OF_1_KG_M_S * as_floats(mass_kg) ** BY_MASS)


@nan_without_warnings
def wander_variance_m2(sigma_m_s: ArrayLike, time_constant_s: ArrayLike, t_s: ArrayLike) -> Floats:
    """Variance of the way of an Ornstein-Uhlenbeck velocity that was drawn at the beginning.

    2 sigma^2 tau^2 (u + expm1(-u)), u the time over the constant; where that is a difference of
    nearly equal numbers, its series.
    """
    tau = as_floats(time_constant_s)
    u = as_floats(t_s) / tau
    series = u * u * (1 - u / 3 * (1 - u / 4 * (1 - u / 5 * (1 - u / 6))))
    whole = 2 * (u + np.expm1(-u))
    return np.asarray((as_floats(sigma_m_s) * tau) ** 2 * np.where(u < SMALL, series, whole))


@dataclass(frozen=True, kw_only=True)
class Wander:
    """An Ornstein-Uhlenbeck velocity, and the way that follows from it, of each axis alike."""

    sigma_m_s: float
    time_constant_s: float

    def walk(
        self, step_s: float, steps: int, shape: tuple[int, ...], rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Ways from 0 and velocities after each step, drawn jointly; (steps + 1, ...) each."""
        u = step_s / self.time_constant_s
        kept, lost = np.exp(-u), -np.expm1(-u)
        tau, sigma = self.time_constant_s, self.sigma_m_s
        # Of what is new in a step: its velocity, and its way given that.
        new_v = sigma * np.sqrt(-np.expm1(-2 * u))
        shared = (sigma * lost) ** 2 * tau  # covariance of the two
        of_way = wander_variance_m2(sigma, tau, step_s) - (sigma * tau * lost) ** 2
        slope = shared / new_v**2 if new_v else 0.0
        rest = np.sqrt(max(float(of_way - slope * shared), 0.0))
        way, velocity = np.zeros((steps + 1, *shape)), np.empty((steps + 1, *shape))
        velocity[0] = sigma * rng.standard_normal(shape)
        normal = rng.standard_normal((2, steps, *shape))
        for k in range(steps):
            fresh = new_v * normal[0, k]
            velocity[k + 1] = kept * velocity[k] + fresh
            moved = tau * lost * velocity[k] + slope * fresh + rest * normal[1, k]
            way[k + 1] = way[k] + moved
        return way, velocity


def cars_on(flow_per_h: float, speed_m_s: float, length_m: float, rng: np.random.Generator) -> int:
    """Draw how many cars there are on a road: Poisson, of mean flow times length over speed."""
    return int(rng.poisson(flow_per_h / 3600 * length_m / speed_m_s))


def rotor_knots(
    axis_azimuth_deg: float, radius_m: float, tip_m_s: float, phase: float, knots: int
) -> tuple[Floats, Floats, Floats]:
    """A turn of a point on a rotor about its hub: times, places and velocities, east, north, up.

    The axis is level, towards an azimuth; `phase` is a share of the turn.
    """
    turn_s = 2 * np.pi * radius_m / tip_m_s
    share = np.arange(knots + 1) / knots
    angle = 2 * np.pi * (share + phase)
    azimuth = np.radians(axis_azimuth_deg)
    across = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    place = radius_m * (np.outer(np.sin(angle), across) + np.outer(np.cos(angle), up))
    velocity = tip_m_s * (np.outer(np.cos(angle), across) - np.outer(np.sin(angle), up))
    return share * turn_s, place, velocity
