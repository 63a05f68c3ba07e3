"""Where geometry and frames fail: rows of docs/stability.md."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from stability_case import Case, relative

from plotfeed.models import accuracy, propagation
from plotfeed.models.frames import (
    WGS84_A_M,
    WGS84_E2,
    LocalFrame,
    aer_to_enu,
    ecef_to_geodetic,
    enu_to_aer,
    geodetic_to_ecef,
    wrap_180,
    wrap_360,
)
from plotfeed.models.sensors.bistatic_places import flat_solution

BASELINE_M = 20_000.0
TRANSMITTER_M = np.array([BASELINE_M, 0.0, 0.0])
ALONG_M = 7000.0
Floats = NDArray[np.float64]


def exact_detour_m(along_m: float, off_m: float) -> mp.mpf:
    """Bistatic range of a place so far along the baseline and off it, in sixty digits."""
    x, y, b = mp.mpf(along_m), mp.mpf(off_m), mp.mpf(BASELINE_M)
    return mp.sqrt(x * x + y * y) + mp.sqrt((x - b) ** 2 + y * y) - b


def plain_detour_m(target_m: Floats) -> Floats:
    """The sum of the ways less the baseline."""
    ways = np.linalg.norm(target_m, axis=-1) + np.linalg.norm(target_m - TRANSMITTER_M, axis=-1)
    return np.asarray(ways - BASELINE_M)


def plain_distance_m(detour_m: float, angle_rad: float) -> float:
    """Equation 34 with its cosine."""
    depth_m = BASELINE_M * (1 - math.cos(angle_rad))
    return detour_m * (detour_m + 2 * BASELINE_M) / (2 * (detour_m + depth_m))


def detour() -> Case:
    off_m = 1e-4
    target = np.array([ALONG_M, off_m, 0.0])
    exact = exact_detour_m(ALONG_M, off_m)
    return Case(
        where="bistatic range 0.1 mm off the baseline",
        plain_form="sum of the ways less the baseline",
        plain=relative(plain_detour_m(target), exact),
        cure="law of cosines, its difference from a cross product",
        ours=relative(propagation.bistatic_range(target, TRANSMITTER_M), exact),
        test="models/test_stability.py::test_bistatic_range_a_tenth_of_a_millimetre_off_the_baseline",
    )


def inversion() -> Case:
    detour_m = float(exact_detour_m(ALONG_M, 1e-5))
    angle_rad = math.atan2(1e-5, ALONG_M)
    exact = mp.hypot(mp.mpf(ALONG_M), mp.mpf(1e-5))
    ours = propagation.range_from_bistatic(detour_m, BASELINE_M, math.degrees(angle_rad))[0]
    return Case(
        where="distance from the bistatic range, 0.01 mm off",
        plain_form="1 − cos β",
        plain=relative(plain_distance_m(detour_m, angle_rad), exact),
        cure="2 sin² β/2",
        ours=relative(ours, exact),
        test="models/test_stability.py::test_a_place_next_to_the_baseline_comes_back",
    )


def no_detour() -> Case:
    solution = flat_solution(np.array([-5.0]), np.array([91.0]), TRANSMITTER_M[None])
    chance = solution.chance_between(0.0, 1e4, np.array([10.0]), np.array([-0.5]))
    return Case(
        where="bistatic range below zero, by noise at the baseline",
        plain_form="equation 34",
        plain=f"a plot {plain_distance_m(-5.0, math.radians(1.0)) / 1e3:.0f} km away",
        cure="undefined, and so no plot",
        ours="no plot" if np.isnan(solution.range_m[0]) and chance[0] == 0 else "a plot",
        test="models/sensors/test_passive_radar.py::test_on_the_baseline_plots_vanish_and_nothing_is_infinite",
    )


def at_the_sensor() -> Case:
    try:
        plain: float | str = 10.0 / (1.63 * math.sqrt(2 * 1e9 / 0.0**4))
    except ZeroDivisionError:
        plain = "division by zero"
    snr = propagation.radar_snr(500, 20, 35, 0.03, 0.01, 0.06, 0.0, 0.0, 4, 5)
    sigma_m = accuracy.with_floor(accuracy.sigma_range_m(snr, 10.0), 0.3)
    return Case(
        where="error of range at range 0",
        plain_form="equations 1 and 13",
        plain=plain,
        cure="an infinite ratio is a value; the floor remains",
        ours=abs(float(sigma_m) - 0.3),
        unit="m",
        test="models/test_stability.py::test_no_distance_and_infinite_snr_leave_the_floor_of_errors",
    )


def grazing() -> Case:
    h1, h2, ground, wavelength = 2.0, 3.0, 1e6, 0.5
    ways = mp.hypot(ground, h1 + h2) - mp.hypot(ground, h1 - h2)
    exact = (2 * mp.sin(mp.pi * ways / wavelength)) ** 2
    plain_detour = math.hypot(ground, h1 + h2) - math.hypot(ground, h1 - h2)
    plain = 2 - 2 * math.cos(2 * math.pi * plain_detour / wavelength)
    return Case(
        where="two waves over a mirror, 1000 km away",
        plain_form="difference of the ways; 1 + ρ² + 2ρ cos φ",
        plain=relative(plain, exact),
        cure="4h₁h₂ over the sum of the ways; sums of squares",
        ours=relative(propagation.two_ray_factor(h1, h2, ground, wavelength, -1.0), exact),
        test="models/test_propagation.py::test_far_away_power_falls_with_the_fourth_power_of_distance_beyond_free_space",
    )


def straight_above() -> Case:
    frame = LocalFrame(40.4168, -3.7038, 100.0)
    above = geodetic_to_ecef(40.4168, -3.7038, np.linspace(620.0, 820.0, 201))
    enu = (above - frame.origin_ecef_m) @ frame.rotation_from_ecef.T
    plain_deg = np.degrees(np.arctan2(enu[:, 0], enu[:, 1]))
    azimuth_deg, _, _ = enu_to_aer(frame.from_ecef(above))
    # Which directions the rounding takes is a matter of the machine.
    spread_deg = float(np.abs(wrap_180(plain_deg - plain_deg[0])).max())
    return Case(
        where="azimuth straight above the sensor",
        plain_form="arctangent of what rounding leaves",
        plain="leaps by over 90°" if spread_deg > 90 else "an azimuth",
        cure="below 5 nm across there is none",
        ours="no azimuth" if np.isnan(azimuth_deg).all() else "an azimuth",
        test="models/test_frames.py::test_straight_above_has_no_azimuth",
    )


def zenith_errors(off_m: float) -> tuple[float, float]:
    """Relative errors of the angle from the vertical, 10 km up: plain form and ours."""
    enu = np.array([off_m, 0.0, 10_000.0])
    exact = mp.atan2(mp.mpf(off_m), 10_000) * 180 / mp.pi
    plain = 90 - np.degrees(np.arcsin(enu[2] / np.linalg.norm(enu)))
    return relative(plain, exact), relative(90 - enu_to_aer(enu)[1], exact)


def near_the_zenith() -> Case:
    plain, ours = zenith_errors(1e-3)
    return Case(
        where="angle from the vertical, 1 mm off it, 10 km up",
        plain_form="arcsine of height over range",
        plain=plain,
        cure="arctangent of height over ground range",
        ours=ours,
        test="models/test_stability.py::test_a_millimetre_off_the_vertical_at_10_km_is_resolved",
    )


def over_the_zenith() -> Case:
    noisy = aer_to_enu(10.0, 91.0, 1.0)
    plain = aer_to_enu(10.0, 90.0, 1.0)
    ours = aer_to_enu(*accuracy.fold_over_zenith(10.0, 91.0), 1.0)
    return Case(
        where="an elevation of 91°, by noise",
        plain_form="clipped to 90°",
        plain=_apart_deg(plain, noisy),
        cure="folded: the azimuth turns round",
        ours=_apart_deg(ours, noisy),
        unit="°",
        test="models/test_accuracy.py::test_folding_keeps_the_direction",
    )


def plain_height_m(ecef_m: Floats) -> float:
    """The textbook's p/cos(latitude) less the radius, its latitude by ten rounds."""
    p, z = math.hypot(ecef_m[0], ecef_m[1]), ecef_m[2]
    latitude, height = math.atan2(z, p * (1 - WGS84_E2)), 0.0
    for _ in range(10):
        radius = WGS84_A_M / math.sqrt(1 - WGS84_E2 * math.sin(latitude) ** 2)
        height = p / math.cos(latitude) - radius
        latitude = math.atan2(z, p * (1 - WGS84_E2 * radius / (radius + height)))
    return height


def pole_errors(off_deg: float) -> tuple[float, float]:
    """Errors of the height, metres: plain form and ours."""
    ecef_m = geodetic_to_ecef(90.0 - off_deg, 77.0, 123.0)
    return abs(plain_height_m(ecef_m) - 123.0), abs(float(ecef_to_geodetic(ecef_m)[2]) - 123.0)


def pole() -> Case:
    plain, ours = pole_errors(1e-9)
    return Case(
        where="height 0.1 mm from the pole",
        plain_form="p over cos φ, less the radius",
        plain=plain,
        cure="p cos φ + z sin φ − a √(1 − e² sin² φ)",
        ours=ours,
        unit="m",
        test="models/test_frames.py::test_poles_have_latitude_height_and_longitude_zero",
    )


def antimeridian() -> Case:
    def east_m(longitude_deg: float, other_deg: float) -> float:
        other = geodetic_to_ecef(10.0, other_deg, 0.0)
        return float(LocalFrame(10.0, longitude_deg, 0.0).from_ecef(other)[0])

    elsewhere_m = east_m(30.0, 30.001)
    plain_m = math.radians(-179.999 - 180.0) * math.cos(math.radians(10.0)) * WGS84_A_M
    return Case(
        where="east from 180° to 179.999° W",
        plain_form="difference of longitudes",
        plain=abs(plain_m - elsewhere_m),
        cure="by way of ECEF",
        ours=abs(east_m(180.0, -179.999) - elsewhere_m),
        unit="m",
        test="models/test_frames.py::test_the_antimeridian_is_no_seam",
    )


def below_north() -> Case:
    return Case(
        where="an azimuth of −10⁻¹⁷°",
        plain_form="remainder of 360",
        plain=f"{-1e-17 % 360:g}°, which no format holds",
        cure="360 is 0",
        ours=f"{float(wrap_360(-1e-17)):g}°",
        test="models/test_stability.py::test_an_angle_a_hair_below_north_is_north",
    )


def small_turn() -> Case:
    angle_deg = 1e-10
    return Case(
        where="a difference of 10⁻¹⁰°, wrapped",
        plain_form="(x + 180) mod 360 − 180",
        plain=relative((angle_deg + 180) % 360 - 180, mp.mpf(angle_deg)),
        cure="within the interval it stays as it is",
        ours=relative(wrap_180(angle_deg), mp.mpf(angle_deg)),
        test="models/test_frames.py::test_wrap_180",
    )


def single_precision() -> Case:
    frame = LocalFrame(40.45, -3.73, 650.0)
    enu = np.array([1234.5678, -987.6543, 55.5])
    ecef_m = frame.to_ecef(enu)
    return Case(
        where="ECEF in float32",
        plain_form="all columns in float32",
        plain=float(np.abs(frame.from_ecef(ecef_m.astype(np.float32)) - enu).max()),
        cure="float64 from telemetry to plot",
        ours=float(np.abs(frame.from_ecef(ecef_m) - enu).max()),
        unit="m",
        test="models/test_stability.py::test_a_position_of_single_precision_loses_metres_and_ours_does_not",
    )


def _apart_deg(one: Floats, other: Floats) -> float:
    return math.degrees(2 * math.asin(float(np.linalg.norm(one - other)) / 2))


BISTATIC = (detour, inversion, no_detour, at_the_sensor, grazing)
FRAMES = (
    straight_above,
    near_the_zenith,
    over_the_zenith,
    pole,
    antimeridian,
    below_north,
    small_turn,
    single_precision,
)
