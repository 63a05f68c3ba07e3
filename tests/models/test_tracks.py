"""Errors of tracks are the filter's. Tests of significance as in tests/support/significance.py."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from support.significance import Array, assert_standard_normal, assert_uncorrelated

from plotfeed.models.accuracy import stated_covariance_m2
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import Plots
from plotfeed.models.tracks import (
    AlphaBeta,
    LocalStates,
    SmoothedTruth,
    TrackerLooks,
    TrackRule,
    TrackStates,
)

S = 1_000_000_000
PERIOD_S = 2.0
PERIOD_NS = 2 * S
SMOOTHING = 3.0
N = 2000
SIGMAS_M = np.array([3.0, 20.0, 40.0])  # along three axes askew to east, north and up
AXES = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
COVARIANCE_M2 = (AXES * SIGMAS_M**2) @ AXES.T
RULE = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=9, period_ns=PERIOD_NS)
MISSED = {6, 7, 8}
VELOCITY_M_S = np.array([10.0, -5.0, 1.0])


def truth_at(t_ns: int, drones: Array) -> LocalStates:
    start_m = np.stack([np.full(len(drones), 10.0), 100.0 * drones, np.full(len(drones), 50.0)], 1)
    return LocalStates(
        drone=drones,
        position_enu_m=start_m + VELOCITY_M_S * (t_ns / S),
        velocity_enu_m_s=np.broadcast_to(VELOCITY_M_S, (len(drones), 3)),
    )


@dataclass(frozen=True)
class Told:
    states: TrackStates
    position_errors: Array
    velocity_errors: Array


def looks_at(drones: Array, t_ns: int, hit: Array, covariance_m2: Array) -> TrackerLooks:
    return TrackerLooks(
        drone=drones,
        t_utc_ns=np.full(len(drones), t_ns),
        hit=hit,
        covariance_m2=np.broadcast_to(covariance_m2, (len(drones), 3, 3)).copy(),
    )


def track(seed: int, drones: int = N, scans: int = 10, gone: int = 99) -> list[Told]:
    """Scan by scan; all are hit but in MISSED. From scan `gone` on nobody is there any more."""
    tracks, chance, found = SmoothedTruth(RULE, SMOOTHING), Chance(seed, "radar"), []
    every = np.arange(drones)
    for scan in range(scans):
        end_ns = (scan + 1) * PERIOD_NS
        hit = np.full(drones, scan not in MISSED)
        truth = truth_at(end_ns, every if scan < gone else every[:0])
        states = tracks.take(
            looks_at(every, end_ns, hit, COVARIANCE_M2),
            truth,
            start_ns=end_ns - PERIOD_NS,
            end_ns=end_ns,
            rng=chance.rng(Purpose.TRACKS, scan),
        )
        now = truth_at(end_ns, states.drone)
        found.append(
            Told(
                states,
                states.position_enu_m - now.position_enu_m,
                states.velocity_enu_m_s - now.velocity_enu_m_s,
            )
        )
    return found


@cache
def long() -> list[Told]:
    return track(seed=201)


def over_sigma(errors: Array, sigmas: Array) -> Array:
    """Along the axes of the plots' errors, each over its own standard deviation; (3, n)."""
    return (errors @ AXES / sigmas).T


def test_errors_are_those_that_the_filter_leaves() -> None:
    design = AlphaBeta(SMOOTHING)
    for scan in (1, 5, 6, 8, 9):
        misses = scan - 5 if scan in MISSED else 0
        position = SIGMAS_M * design.position_variance(misses) ** 0.5
        velocity = SIGMAS_M * design.velocity_variance() ** 0.5 / PERIOD_S
        for axis in over_sigma(long()[scan].position_errors, position):
            assert_standard_normal(axis, f"position, scan {scan}")
        for axis in over_sigma(long()[scan].velocity_errors, velocity):
            assert_standard_normal(axis, f"velocity, scan {scan}")


def test_errors_are_correlated_over_the_memory() -> None:
    """What is new in an error after a scan is normal, of the variance that is missing."""
    kept = np.exp(-1 / SMOOTHING)
    sigma = SIGMAS_M * AlphaBeta(SMOOTHING).position_variance(0) ** 0.5
    for earlier, later in ((1, 2), (3, 4)):
        before, after = (over_sigma(long()[k].position_errors, sigma) for k in (earlier, later))
        for axis in range(3):
            new = (after[axis] - kept * before[axis]) / np.sqrt(1 - kept**2)
            assert_standard_normal(new, "innovation")
            assert_uncorrelated(new, before[axis])


def test_errors_along_axes_and_of_other_drones_have_nothing_in_common() -> None:
    east, north, up = over_sigma(long()[4].position_errors, SIGMAS_M)
    speed = over_sigma(long()[4].velocity_errors, SIGMAS_M)[0]
    for one, other in ((east, north), (north, up), (up, east), (east, speed)):
        assert_uncorrelated(one, other)
    assert_uncorrelated(east[1:], east[:-1])


def test_it_states_the_errors_that_it_has() -> None:
    design = AlphaBeta(SMOOTHING)
    for scan, misses in ((2, 0), (8, 3)):
        expected = np.sqrt(np.diagonal(COVARIANCE_M2) * design.position_variance(misses))
        stated = long()[scan].states.sigma_position_m
        np.testing.assert_allclose(stated, np.broadcast_to(expected, (N, 3)))


def test_age_and_misses_count_from_the_last_plot() -> None:
    for scan in range(1, 10):
        states = long()[scan].states
        assert set(states.misses.tolist()) == {scan - 5 if scan in MISSED else 0}
        assert set(states.age_s.tolist()) == {PERIOD_S * (scan - 5) if scan in MISSED else 0.0}


def test_the_track_of_a_drone_that_is_gone_flies_straight_on_and_ends() -> None:
    told = track(seed=202, scans=14, gone=4)
    assert [len(t.states) for t in told] == [0] + [N] * 12 + [0]
    assert told[12].states.last.all()
    sigma = SIGMAS_M * AlphaBeta(SMOOTHING).position_variance(9) ** 0.5
    for axis in over_sigma(told[12].position_errors, sigma):
        assert_standard_normal(axis, "coasted to the end")


def test_the_same_draws_whatever_the_seed_of_others() -> None:
    one, again, other = (track(seed, drones=5) for seed in (203, 203, 204))
    for a, b, c in zip(one, again, other, strict=True):
        np.testing.assert_array_equal(a.states.position_enu_m, b.states.position_enu_m)
        assert not np.intersect1d(a.states.position_enu_m, c.states.position_enu_m).size


def test_plots_without_an_error_leave_the_truth() -> None:
    tracks = SmoothedTruth(RULE, SMOOTHING)
    only = np.array([7])
    for scan in range(4):
        end_ns = (scan + 1) * PERIOD_NS
        states = tracks.take(
            looks_at(only, end_ns, np.array([True]), np.zeros((3, 3))),
            truth_at(end_ns, only),
            start_ns=end_ns - PERIOD_NS,
            end_ns=end_ns,
            rng=np.random.default_rng(scan),
        )
    np.testing.assert_array_equal(states.position_enu_m, truth_at(end_ns, only).position_enu_m)


def test_an_error_without_bounds_teaches_nothing() -> None:
    tracks, drone = SmoothedTruth(RULE, SMOOTHING), np.array([0])
    for scan, factor in enumerate((1.0, np.inf, 1.0, np.nan)):
        end_ns = (scan + 1) * PERIOD_NS
        states = tracks.take(
            looks_at(drone, end_ns, np.array([True]), np.where(np.eye(3) > 0, factor, 0)),
            truth_at(end_ns, drone),
            start_ns=end_ns - PERIOD_NS,
            end_ns=end_ns,
            rng=np.random.default_rng(scan),
        )
    expected = AlphaBeta(SMOOTHING).position_variance(0) ** 0.5
    np.testing.assert_allclose(states.sigma_position_m, np.full((1, 3), expected))


def test_stated_errors_of_range_and_angles_become_a_covariance() -> None:
    """Against what errors drawn so come to."""
    one = {"range_m": 3000.0, "azimuth_deg": 60.0, "elevation_deg": 25.0}
    sigmas = {"sigma_range_m": 8.0, "sigma_azimuth_deg": 0.4, "sigma_elevation_deg": 0.9}
    plots = Plots.of(
        t_utc_ns=np.zeros(1, np.int64), **{k: np.array([v]) for k, v in (one | sigmas).items()}
    )
    rng, n = np.random.default_rng(205), 400_000
    range_m, azimuth, elevation = (
        value + sigma * rng.standard_normal(n)
        for value, sigma in zip(one.values(), sigmas.values(), strict=True)
    )
    azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    east_north_up = range_m * np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    drawn = np.cov(east_north_up)
    np.testing.assert_allclose(stated_covariance_m2(plots)[0], drawn, rtol=0.02, atol=5.0)


def test_a_level_covariance_is_taken_as_it_is() -> None:
    plots = Plots.of(
        t_utc_ns=np.zeros(1, np.int64),
        range_m=np.array([1000.0]),
        azimuth_deg=np.array([10.0]),
        covariance_east_m2=np.array([9.0]),
        covariance_north_m2=np.array([4.0]),
        covariance_east_north_m2=np.array([-2.0]),
    )
    expected = [[9.0, -2.0, 0.0], [-2.0, 4.0, 0.0], [0.0, 0.0, 0.0]]
    np.testing.assert_array_equal(stated_covariance_m2(plots)[0], expected)


def test_an_error_without_bounds_is_none() -> None:
    plots = Plots.of(
        t_utc_ns=np.zeros(2, np.int64),
        range_m=np.full(2, 1000.0),
        azimuth_deg=np.full(2, 10.0),
        sigma_range_m=np.array([1.0, np.inf]),
        sigma_azimuth_deg=np.ones(2),
    )
    covariance_m2 = stated_covariance_m2(plots)
    assert np.isfinite(covariance_m2[0]).all()
    assert np.isnan(covariance_m2[1]).all()


MEMORIES = pytest.mark.parametrize("scans", [0.1, 0.5, 1.0, 3.0, 10.0, 100.0])
FLIGHT = np.array([[1.0, 1.0], [0.0, 1.0]])  # a period of x and vT


def errors_of(design: AlphaBeta) -> np.ndarray:
    """Covariance of x and vT for plots of variance 1, by the filter's own equations."""
    gain = np.array([[design.alpha], [design.beta]])
    left = (np.eye(2) - gain @ np.array([[1.0, 0.0]])) @ FLIGHT
    covariance: np.ndarray = solve_discrete_lyapunov(left, gain @ gain.T)
    return covariance


@MEMORIES
def test_variances_are_those_of_the_filters_equations(scans: float) -> None:
    design = AlphaBeta(scans)
    expected = errors_of(design)
    assert design.position_variance(0) == pytest.approx(expected[0, 0], rel=1e-9)
    assert design.velocity_variance() == pytest.approx(expected[1, 1], rel=1e-9)


@MEMORIES
def test_a_coasted_position_is_that_of_a_straight_flight(scans: float) -> None:
    design = AlphaBeta(scans)
    covariance = errors_of(design)
    for misses in range(1, 6):
        covariance = FLIGHT @ covariance @ FLIGHT.T
        assert design.position_variance(misses) == pytest.approx(covariance[0, 0], rel=1e-9)


@MEMORIES
def test_it_is_the_weighted_straight_line_through_all_plots(scans: float) -> None:
    design = AlphaBeta(scans)
    age = np.arange(int(60 * scans) + 60)
    root = np.sqrt(design.memory**age)
    # Position now and change a period, of plots at times -age: rows of weights of the plots.
    weights = np.linalg.pinv(np.stack([root, -age * root], axis=1)) * root
    assert design.position_variance(0) == pytest.approx(weights[0] @ weights[0], rel=1e-6)
    assert design.velocity_variance() == pytest.approx(weights[1] @ weights[1], rel=1e-6)


def test_without_memory_the_position_is_the_plot() -> None:
    design = AlphaBeta(0.1)
    assert design.position_variance(0) == pytest.approx(1.0, rel=1e-3)
    assert design.velocity_variance() == pytest.approx(2.0, rel=1e-3)
