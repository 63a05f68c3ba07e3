"""Tracks: the truth with a filter's errors, and the plain tracker."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.linalg import solve_discrete_lyapunov
from support.significance import (
    Array,
    assert_chance,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

from plotfeed.models.accuracy import stated_covariance_m2
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.plain_tracker import (
    LocatedPlots,
    PlainMotion,
    PlainTracker,
    distances2,
    least_sum,
    predicted,
    updated,
)
from plotfeed.models.state import Plots
from plotfeed.models.track_metrics import nees
from plotfeed.models.tracks import (
    AlphaBeta,
    LivingTracks,
    LocalStates,
    SmoothedTruth,
    TrackerLooks,
    TrackLives,
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


def track(
    seed: int,
    drones: int = N,
    scans: int = 10,
    gone: int = 99,
    covariances_m2: Callable[[int], Array] = lambda _: COVARIANCE_M2,
) -> list[Told]:
    """Scan by scan; all are hit but in MISSED. From scan `gone` on nobody is there any more."""
    tracks, chance, found = SmoothedTruth(RULE, SMOOTHING), Chance(seed, "radar"), []
    every = np.arange(drones)
    for scan in range(scans):
        end_ns = (scan + 1) * PERIOD_NS
        looks = TrackerLooks(
            drone=every,
            t_utc_ns=np.full(drones, end_ns),
            hit=np.full(drones, scan not in MISSED),
            covariance_m2=np.broadcast_to(covariances_m2(scan), (drones, 3, 3)).copy(),
        )
        truth = truth_at(end_ns, every if scan < gone else every[:0])
        rng = chance.rng(Purpose.TRACKS, scan)
        states = tracks.take(looks, truth, start_ns=end_ns - PERIOD_NS, end_ns=end_ns, rng=rng)
        now = truth_at(end_ns, states.drone)
        position_errors = states.position_enu_m - now.position_enu_m
        velocity_errors = states.velocity_enu_m_s - now.velocity_enu_m_s
        found.append(Told(states, position_errors, velocity_errors))
    return found


@cache
def long() -> list[Told]:
    return track(seed=201)


def over_sigma(errors: Array, sigmas: Array) -> Array:
    """Along the axes of the plots' errors, each over its own standard deviation; (3, n)."""
    return (errors @ AXES / sigmas).T


def test_errors_are_those_that_the_filter_leaves_and_the_track_states() -> None:
    design = AlphaBeta(SMOOTHING)
    for scan in (1, 5, 6, 8, 9):
        misses = scan - 5 if scan in MISSED else 0
        position = SIGMAS_M * design.position_variance(misses) ** 0.5
        velocity = SIGMAS_M * design.velocity_variance() ** 0.5 / PERIOD_S
        for axis in over_sigma(long()[scan].position_errors, position):
            assert_standard_normal(axis, f"position, scan {scan}")
        for axis in over_sigma(long()[scan].velocity_errors, velocity):
            assert_standard_normal(axis, f"velocity, scan {scan}")
        expected = np.sqrt(np.diagonal(COVARIANCE_M2) * design.position_variance(misses))
        stated = long()[scan].states.sigma_position_m
        np.testing.assert_allclose(stated, np.broadcast_to(expected, (N, 3)))


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


def test_the_track_of_a_drone_that_is_gone_flies_straight_on_and_ends() -> None:
    told = track(seed=202, scans=14, gone=4)
    assert [len(t.states) for t in told] == [0] + [N] * 12 + [0]
    assert told[12].states.last.all()
    sigma = SIGMAS_M * AlphaBeta(SMOOTHING).position_variance(9) ** 0.5
    for axis in over_sigma(told[12].position_errors, sigma):
        assert_standard_normal(axis, "coasted to the end")


def test_plots_without_an_error_leave_the_truth_and_one_without_bounds_teaches_nothing() -> None:
    told = track(1, drones=1, scans=4, covariances_m2=lambda _: np.zeros((3, 3)))
    assert not told[-1].position_errors.any()
    factors = (1.0, np.inf, 1.0, np.nan)
    told = track(
        1, drones=1, scans=4, covariances_m2=lambda k: np.where(np.eye(3) > 0, factors[k], 0.0)
    )
    expected = AlphaBeta(SMOOTHING).position_variance(0) ** 0.5
    np.testing.assert_allclose(told[-1].states.sigma_position_m, np.full((1, 3), expected))


def plots_of(**columns: list[float]) -> Plots:
    n = len(columns["range_m"])
    given = {name: np.array(column) for name, column in columns.items()}
    return Plots.of(t_utc_ns=np.zeros(n, np.int64), **given)


def test_stated_errors_of_range_and_angles_become_a_covariance() -> None:
    """By differences of the place; an error without bounds has none."""
    place, sigmas = np.array([3000.0, 60.0, 25.0]), np.array([8.0, 0.4, 0.9])
    steps = [
        (np.subtract(*(aer_to_enu(*(place + sign * each)[[1, 2, 0]]) for sign in (1, -1))) / 2e-3)
        for each in 1e-3 * np.diag(sigmas)
    ]
    names = ("range_m", "azimuth_deg", "elevation_deg")
    stated = {f"sigma_{name}": [s, s] for name, s in zip(names, sigmas, strict=True)}
    stated["sigma_range_m"][1] = np.inf
    plots = plots_of(**{n: [x, x] for n, x in zip(names, place, strict=True)}, **stated)
    covariance_m2 = stated_covariance_m2(plots)
    np.testing.assert_allclose(covariance_m2[0], np.transpose(steps) @ steps, rtol=1e-6, atol=1e-3)
    assert np.isnan(covariance_m2[1]).all()


def test_a_level_covariance_is_taken_as_it_is() -> None:
    plots = plots_of(
        range_m=[1000.0], azimuth_deg=[10.0], covariance_east_m2=[9.0], covariance_north_m2=[4.0],
        covariance_east_north_m2=[-2.0],
    )  # fmt: skip
    expected = [[9.0, -2.0, 0.0], [-2.0, 4.0, 0.0], [0.0, 0.0, 0.0]]
    np.testing.assert_array_equal(stated_covariance_m2(plots)[0], expected)


FLIGHT = np.array([[1.0, 1.0], [0.0, 1.0]])  # a period of x and vT


@pytest.mark.parametrize("scans", [0.1, 0.5, 1.0, 3.0, 10.0, 100.0])
def test_variances_are_those_of_the_filters_equations_and_of_straight_flight(scans: float) -> None:
    """Covariance of x and vT for plots of variance 1."""
    design = AlphaBeta(scans)
    assert design.alpha == pytest.approx(1 - np.exp(-2 / scans), rel=1e-9)
    gain = np.array([[design.alpha], [design.beta]])
    left = (np.eye(2) - gain @ np.array([[1.0, 0.0]])) @ FLIGHT
    covariance = solve_discrete_lyapunov(left, gain @ gain.T)
    assert design.velocity_variance() == pytest.approx(covariance[1, 1], rel=1e-9)
    for misses in range(6):
        assert design.position_variance(misses) == pytest.approx(covariance[0, 0], rel=1e-9)
        covariance = FLIGHT @ covariance @ FLIGHT.T


# The plain tracker: lives of tracks by M of N, the best pairs, misses, swaps and deception.


START_NS = 1_700_000_000 * S
MOTION = PlainMotion(density_m2_s3=1.0, initial_speed_m_s=15.0, gate_probability=0.999)
PLAIN_RULE = TrackRule(confirm_hits=3, confirm_window=5, drop_misses=3, period_ns=S)


def rule_of(confirm: tuple[int, int], drop_misses: int, **more: int) -> TrackRule:
    hits, window = confirm
    return TrackRule(
        confirm_hits=hits, confirm_window=window, drop_misses=drop_misses, period_ns=S, **more
    )


def plots(positions_m: list[tuple[float, ...]] | Array, t_ns: int, **more: Array) -> LocatedPlots:
    n = len(positions_m)
    return LocatedPlots(
        **{
            "t_utc_ns": np.full(n, t_ns),
            "channel": np.zeros(n, np.int64),
            "position_enu_m": np.array(positions_m, np.float64).reshape(n, 3),
            "covariance_m2": np.broadcast_to(25.0 * np.eye(3), (n, 3, 3)),
            "has_height": np.ones(n, np.bool_),
            **more,
        }
    )


def scan(tracker: PlainTracker, k: int, *positions_m: tuple[float, ...]) -> TrackStates:
    end_ns = START_NS + (k + 1) * S
    found = plots(list(positions_m), end_ns - S // 2)
    return tracker.take(found, start_ns=end_ns - S, end_ns=end_ns)


def tracker_of(rule: TrackRule = PLAIN_RULE, *, turns: bool = False) -> PlainTracker:
    return PlainTracker(rule, MOTION, turns=turns)


def test_a_track_begins_with_three_plots_coasts_and_ends_with_three_misses() -> None:
    """What is seen twice in five looks before is forgotten."""
    tracker = tracker_of()
    for k in (0, 3, 4, 5, 6, 7):
        assert not len(scan(tracker, k - 12, *([(0.0, 900.0, 50.0)] if k < 4 else [])))
    assert len(tracker) == 0
    there = [True, False, True, True, True, False, True, False, False, False, False]
    told = [
        scan(tracker, k, *([(10.0 * k, 500.0, 80.0)] if seen else []))
        for k, seen in enumerate(there)
    ]
    assert [t.track.tolist() for t in told] == [[]] * 3 + [[1]] * 7 + [[]]
    assert [t.first.tolist() for t in told[3:5]] == [[True], [False]]
    assert [int(t.misses[0]) for t in told[3:10]] == [0, 0, 1, 0, 1, 2, 3]
    assert [bool(t.last[0]) for t in told[3:10]] == [False] * 6 + [True]
    assert told[5].age_s == pytest.approx([1.5])
    for k in range(4, 8):
        off_m = told[k].position_enu_m[0] - np.array([10.0 * (k + 0.5), 500.0, 80.0])
        assert np.abs(off_m / told[k].sigma_position_m[0]).max() < 3
    assert len(tracker) == 0


def test_a_beam_that_turns_tells_of_a_target_once_a_turn_and_misses_it_half_a_turn_late() -> None:
    tracker, told = tracker_of(turns=True), []
    for k in range(40):  # eighths of a turn; the target is in the third of each, but for turns 3, 4
        end_ns = START_NS + (k + 1) * S // 8
        seen = k % 8 == 2 and k // 8 not in (3, 4)
        found = plots([(0.0, 700.0, 60.0)] if seen else [], end_ns - 1000)
        told.append(tracker.take(found, start_ns=end_ns - S // 8, end_ns=end_ns))
    assert [k for k, t in enumerate(told) if len(t)] == [18, 30, 38]
    assert [int(t.misses[0]) for t in told if len(t)] == [0, 1, 2]


def test_time_in_which_nobody_looked_counts_for_nothing_and_two_channels_are_one_track() -> None:
    tracker = tracker_of()
    for k in (0, 1, 2, 30, 31):
        end_ns = START_NS + (k + 1) * S
        twice = plots([(0.0, 700.0, 60.0), (4.0, 702.0, 61.0)], end_ns, channel=np.array([0, 1]))
        told = tracker.take(twice, start_ns=end_ns - S, end_ns=end_ns)
    assert told.track.tolist() == [1]
    assert told.misses.tolist() == [0]
    assert len(tracker) == 1


def test_targets_that_meet_may_swap_since_nobody_knows_which_is_which() -> None:
    """Two that fly towards each other and turn back look like two that pass."""
    tracker, order = tracker_of(), []
    for k in range(31):
        off_m = 20.0 * abs(k - 15)
        told = scan(tracker, k, (-off_m, 500.0, 80.0), (off_m, 500.0, 80.0))
        order.append(told.track[np.argsort(told.position_enu_m[:, 0])].tolist())
    assert order[10] == [1, 2]
    assert order[-1] == [2, 1]


def test_false_alarms_become_tracks_as_often_as_chance_brings_them_together() -> None:
    """Two of two: a lone alarm begins a track if any of the next scan's falls within its gate.

    Each has a cell of its own, wider than the gate, so that these are independent.
    """
    rule = rule_of((2, 2), 1)
    side_m, alarms_a_cell, n = 400.0, 20.0, 12
    rng, tracker = np.random.default_rng(5), tracker_of(rule)
    cells = side_m * (np.indices((n, n, n)).reshape(3, -1).T + 0.5)
    again = n * side_m * rng.random((rng.poisson(alarms_a_cell * n**3), 3))
    scan(tracker, 0, *map(tuple, cells))
    begun = len(scan(tracker, 1, *map(tuple, again)))
    sigma_m = np.sqrt(25.0 + 225.0 + 1.0 / 3 + 25.0)  # of two plots, velocity and acceleration
    gate_m3 = 4 / 3 * np.pi * (sigma_m * np.sqrt(stats.chi2.ppf(0.999, 3))) ** 3
    chance = 1 - np.exp(-alarms_a_cell * gate_m3 / side_m**3)
    assert 0.1 < chance < 0.9
    assert_sum(begun, n**3 * chance, n**3 * chance * (1 - chance), "tracks begun")


def flown(turn_deg_s: float) -> tuple[float, float]:
    """Mean squared errors of 40 drones' tracks, over what these claim and in m2, along each axis.

    They fly at 10 m/s for 20 s and turn for 20 s, in turns; plots are off by 20 m along each axis.
    """
    rng, drones, heading = np.random.default_rng(34), 40, 0.0
    motion = PlainMotion(density_m2_s3=9.0, initial_speed_m_s=15.0, gate_probability=0.999999)
    tracker = PlainTracker(PLAIN_RULE, motion, turns=False)
    place_m = np.column_stack([np.arange(drones) * 5000.0, np.zeros((drones, 2))])
    errors_m2 = np.broadcast_to(400.0 * np.eye(3), (drones, 3, 3))
    off, claimed = [], []
    for k in range(150):
        heading += np.radians(turn_deg_s) * (k // 20 % 2)
        place_m = place_m + 10.0 * np.array([np.sin(heading), np.cos(heading), 0.0])
        end_ns = START_NS + (k + 1) * S
        found = plots(
            place_m + 20.0 * rng.standard_normal((drones, 3)), end_ns, covariance_m2=errors_m2
        )
        told = tracker.take(found, start_ns=end_ns - S, end_ns=end_ns)
        if k >= 20:
            off.append(told.position_enu_m - place_m)
            claimed.append(told.sigma_position_m)
    off_m, sigma_m = np.array(off), np.array(claimed)
    return float((off_m**2 / sigma_m**2).mean()), float((off_m**2).mean())


def test_tracks_err_as_they_claim_and_less_where_drones_fly_straight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within the bounds of 150 correlated reports of 40 drones; beside a density that stays."""
    straight, straight_m2 = flown(0.0)
    turning, turning_m2 = flown(15.0)
    assert 0.7 < straight < 1.0
    assert 0.85 < turning < 1.3
    monkeypatch.setattr("plotfeed.models.plain_tracker.LEAST_SHARE", 1.0)
    assert straight_m2 < 0.7 * flown(0.0)[1]
    assert turning_m2 < 1.1 * flown(15.0)[1]


costs = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(-20, -1)),
    unique_by=lambda each: each[:2],
    max_size=14,
)


@given(costs)
def test_pairs_have_the_least_sum(pairs: list[tuple[int, int, int]]) -> None:
    row, column, cost = (np.array([p[i] for p in pairs], np.int64) for i in range(3))
    chosen = least_sum(row, column, cost.astype(np.float64))
    assert len(set(row[chosen].tolist())) == len(set(column[chosen].tolist())) == len(chosen)
    of_pair = {(r, c): x for r, c, x in pairs}
    best = min(
        sum(of_pair.get((r, c), 0) for r, c in enumerate(order)) for order in permutations(range(5))
    )
    assert cost[chosen].sum() == best


# Kalman's filter against least squares, its own law of composition, and its stated errors.


SIGMA_M = 3.0


def test_without_acceleration_it_is_a_straight_line_by_least_squares() -> None:
    rng = np.random.default_rng(1)
    t_s = np.array([0.0, 1.0, 2.5, 3.0, 4.7])
    measured_m = rng.normal(0, 50, (5, 3))
    errors_m2 = SIGMA_M**2 * np.eye(3)[None]
    states = np.concatenate([measured_m[:1], np.zeros((1, 3))], axis=1)
    spread = np.zeros((1, 6, 6))
    spread[0, :3, :3], spread[0, 3:, 3:] = errors_m2[0], 1e8 * np.eye(3)
    for k in range(1, 5):
        states, spread = predicted(states, spread, t_s[k : k + 1] - t_s[k - 1], 0.0)
        states, spread = updated(states, spread, measured_m[k : k + 1], errors_m2)
    design = np.stack([np.ones(5), t_s - t_s[-1]], axis=1)
    line = np.linalg.lstsq(design, measured_m, rcond=None)[0]
    covariance = SIGMA_M**2 * np.linalg.inv(design.T @ design)
    assert states[0] == pytest.approx(line.ravel(), abs=1e-4)
    assert spread[0][np.ix_([0, 3], [0, 3])] == pytest.approx(covariance, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_predictions_are_one_over_both_times(sign: float) -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 6, 6))
    states, spread = rng.normal(size=(4, 6)), root @ root.transpose(0, 2, 1)
    first_s, second_s = sign * rng.uniform(0, 3, 4), sign * rng.uniform(0, 3, 4)
    twice = predicted(*predicted(states, spread, first_s, 2.0), second_s, 2.0)
    once = predicted(states, spread, first_s + second_s, 2.0)
    assert twice[0] == pytest.approx(once[0])
    assert twice[1] == pytest.approx(once[1])


def test_errors_are_as_large_as_their_covariances_say() -> None:
    """NEES of 2,000 targets with white acceleration, and distances of their next plots: chi2."""
    n, density, rng = 2000, 4.0, np.random.default_rng(3)
    truth = np.concatenate([rng.normal(0, 1000, (n, 3)), rng.normal(0, 15, (n, 3))], axis=1)
    errors_m2 = np.broadcast_to(np.diag([4.0, 25.0, 100.0]), (n, 3, 3))
    sigma_m = np.array([2.0, 5.0, 10.0])
    step = np.linalg.cholesky(density * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))
    states = np.concatenate([truth[:, :3] + sigma_m * rng.normal(size=(n, 3)), np.zeros((n, 3))], 1)
    spread = np.zeros((n, 6, 6))
    spread[:, :3, :3], spread[:, 3:, 3:] = errors_m2, 225 * np.eye(3)
    for _ in range(8):
        truth[:, :3] += truth[:, 3:]
        kicks = np.einsum("ab,nbk->nak", step, rng.normal(size=(n, 2, 3)))
        truth += kicks.reshape(n, 6)
        measured_m = truth[:, :3] + sigma_m * rng.normal(size=(n, 3))
        states, spread = predicted(states, spread, np.ones(n), density)
        far2 = distances2(states, spread, measured_m, errors_m2)
        states, spread = updated(states, spread, measured_m, errors_m2)
    for values, freedom in ((nees(states - truth, spread), 6), (far2, 3)):
        assert_chance(float(stats.kstest(values, stats.chi2(freedom).cdf).pvalue), str(freedom))


DRONES = 3
HIT, MISS, ABSENT = "hit", "miss", "absent"

rules = st.integers(1, 8).flatmap(
    lambda window: st.builds(
        rule_of, st.tuples(st.integers(1, window), st.just(window)), st.integers(1, 6)
    )
)
scans = st.lists(
    st.tuples(*[st.sampled_from([HIT, HIT, HIT, MISS, MISS, ABSENT])] * DRONES), max_size=60
)


@dataclass
class Account:
    """One drone's, kept as the rule says it in words."""

    hits: deque[bool]
    track: int = 0
    misses: int = 0
    told: list[tuple[int, int, bool, bool]] = field(default_factory=list)


def feed(lives: TrackLives, scan: int, seen: tuple[str, ...], period_ns: int = S) -> LivingTracks:
    drone = np.array([d for d, what in enumerate(seen) if what != ABSENT], np.int64)
    hit = np.array([seen[d] == HIT for d in drone], np.bool_)
    end_ns = START_NS + (scan + 1) * period_ns
    times_ns = np.full(len(drone), end_ns)
    return lives.take(drone, times_ns, hit, start_ns=end_ns - period_ns, end_ns=end_ns)


@given(rules, scans)
def test_tracks_begin_and_end_as_the_rule_says(
    rule: TrackRule, seen: list[tuple[str, ...]]
) -> None:
    lives, newest = TrackLives(rule), 0
    accounts = [Account(deque(maxlen=rule.confirm_window)) for _ in range(DRONES)]
    for scan, looks in enumerate(seen):
        expected = []
        for drone, account in enumerate(accounts):
            hit = looks[drone] == HIT
            account.hits.append(hit)
            account.misses = 0 if hit else account.misses + 1
            first = not account.track and hit and sum(account.hits) >= rule.confirm_hits
            if first:
                newest += 1
                account.track = newest
            last = account.misses >= rule.drop_misses
            if account.track:
                expected.append((drone, account.track, account.misses, first, last))
            if account.track and last:
                account.track = 0
                account.hits.clear()
        told = feed(lives, scan, looks)
        columns = (told.drone, told.track, told.misses, told.first, told.last)
        assert list(zip(*(c.tolist() for c in columns), strict=True)) == expected


def test_nobody_looked_in_a_skipped_scan_and_a_beam_may_come_half_a_turn_late() -> None:
    lives = TrackLives(rule_of((2, 3), 2))
    feed(lives, 0, (HIT,))
    assert feed(lives, 1, (HIT,)).first.tolist() == [True]
    for scan in (50, 51, 90):
        told = feed(lives, scan, (HIT,) if scan != 51 else (ABSENT,))
        assert told.track.tolist() == [1]
        assert not told.last.any()
        assert told.hit_utc_ns.tolist() == [START_NS + (51 if scan < 90 else 91) * S]
    lives = TrackLives(rule_of((1, 1), 2, patience_ns=S // 2))
    turns = [feed(lives, k, (ABSENT if k else HIT,), S // 8) for k in range(30)]
    assert [k for k, t in enumerate(turns) if len(t)] == [0, 12, 20]
    assert [t.misses.tolist() for t in turns if len(t)] == [[0], [1], [2]]
    assert turns[20].last.tolist() == [True]


def test_numbers_start_again_and_leave_out_those_in_use() -> None:
    lives = TrackLives(rule_of((1, 1), 1, last_number=3))
    assert feed(lives, 0, (HIT, HIT)).track.tolist() == [1, 2]
    assert feed(lives, 1, (HIT, MISS)).track.tolist() == [1, 2]
    assert feed(lives, 2, (HIT, HIT, HIT, HIT)).track.tolist() == [1, 3, 2]  # and none is left
    assert feed(lives, 3, (MISS, HIT, HIT, MISS)).last.tolist() == [True, False, False]
    assert feed(lives, 4, (MISS, HIT, HIT, HIT)).track.tolist() == [3, 2, 1]
