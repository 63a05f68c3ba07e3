"""The plain tracker: lives of tracks by M of N, the best pairs, misses, swaps and deception."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.significance import Array, assert_chance, assert_sum

from plotfeed.models.plain_tracker import (
    LocatedPlots,
    PlainMotion,
    PlainTracker,
    distances2,
    least_sum,
    predicted,
    updated,
)
from plotfeed.models.tracks import LivingTracks, TrackLives, TrackRule, TrackStates

S = 1_000_000_000
START_NS = 1_700_000_000 * S
MOTION = PlainMotion(density_m2_s3=1.0, initial_speed_m_s=15.0, gate_probability=0.999)
RULE = TrackRule(confirm_hits=3, confirm_window=5, drop_misses=3, period_ns=S)


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


def tracker_of(rule: TrackRule = RULE, *, turns: bool = False) -> PlainTracker:
    return PlainTracker(rule, MOTION, turns=turns)


def test_a_track_begins_with_three_plots_coasts_and_ends_with_three_misses() -> None:
    tracker = tracker_of()
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


def test_what_is_seen_twice_in_five_looks_is_no_track_and_is_forgotten() -> None:
    tracker = tracker_of()
    for k in range(12):
        assert not len(scan(tracker, k, *([(0.0, 900.0, 50.0)] if k in (0, 3, 9) else [])))
    assert len(tracker) == 1  # the last one still may begin
    scan(tracker, 12)
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


def test_time_in_which_nobody_looked_counts_for_nothing() -> None:
    tracker = tracker_of()
    for k in range(3):
        scan(tracker, k, (0.0, 700.0, 60.0))
    after = scan(tracker, 30, (0.0, 700.0, 60.0))
    assert after.track.tolist() == [1]
    assert after.misses.tolist() == [0]


def test_two_transmitters_that_show_a_target_make_one_track_of_it() -> None:
    tracker = tracker_of()
    for k in range(6):
        end_ns = START_NS + (k + 1) * S
        twice = plots([(0.0, 700.0, 60.0), (4.0, 702.0, 61.0)], end_ns, channel=np.array([0, 1]))
        told = tracker.take(twice, start_ns=end_ns - S, end_ns=end_ns)
    assert told.track.tolist() == [1]
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


def test_numbers_are_those_of_the_rule() -> None:
    rule = TrackRule(
        confirm_hits=1, confirm_window=1, drop_misses=1, period_ns=S, first_number=7, last_number=8
    )
    tracker = tracker_of(rule)
    three = [(1000.0 * i, 500.0, 80.0) for i in range(3)]
    assert scan(tracker, 0, *three).track.tolist() == [7, 8]  # and none is left
    assert scan(tracker, 1).last.tolist() == [True, True]
    assert scan(tracker, 2, *three[:1]).track.tolist() == [7]


def test_false_alarms_become_tracks_as_often_as_chance_brings_them_together() -> None:
    """Two of two: a lone alarm begins a track if any of the next scan's falls within its gate.

    Each has a cell of its own, wider than the gate, so that these are independent.
    """
    rule = TrackRule(confirm_hits=2, confirm_window=2, drop_misses=1, period_ns=S)
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
    tracker = PlainTracker(RULE, motion, turns=False)
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
    off = states - truth
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off)
    for values, freedom in ((nees, 6), (far2, 3)):
        assert_chance(float(stats.kstest(values, stats.chi2(freedom).cdf).pvalue), str(freedom))


DRONES = 3
HIT, MISS, ABSENT = "hit", "miss", "absent"

rules = st.integers(1, 8).flatmap(
    lambda window: st.builds(
        TrackRule,
        confirm_hits=st.integers(1, window),
        confirm_window=st.just(window),
        drop_misses=st.integers(1, 6),
        period_ns=st.just(S),
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


@given(rules, scans)
def test_a_life_has_one_number_a_beginning_and_an_end(
    rule: TrackRule, seen: list[tuple[str, ...]]
) -> None:
    lives = TrackLives(rule)
    of_track: dict[int, list[tuple[int, bool, bool]]] = {}
    for scan, looks in enumerate(seen):
        told = feed(lives, scan, looks)
        assert len(set(told.track.tolist())) == len(told)
        for row in range(len(told)):
            report = (int(told.drone[row]), bool(told.first[row]), bool(told.last[row]))
            of_track.setdefault(int(told.track[row]), []).append(report)
    assert list(of_track) == list(range(1, len(of_track) + 1))
    for reports in of_track.values():
        assert len({drone for drone, _, _ in reports}) == 1
        assert [first for _, first, _ in reports] == [True] + [False] * (len(reports) - 1)
        assert not any(last for _, _, last in reports[:-1])


@given(scans)
def test_a_drone_that_is_out_of_sight_is_one_that_is_missed(seen: list[tuple[str, ...]]) -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=3, period_ns=S)
    one, other = TrackLives(rule), TrackLives(rule)
    for scan, looks in enumerate(seen):
        missed = tuple(MISS if what == ABSENT else what for what in looks)
        left, right = feed(one, scan, looks), feed(other, scan, missed)
        for name in ("drone", "track", "misses", "first", "last"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


def test_nobody_looked_in_a_skipped_scan() -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=2, period_ns=S)
    lives = TrackLives(rule)
    feed(lives, 0, (HIT,))
    assert feed(lives, 1, (HIT,)).first.tolist() == [True]
    for scan in (50, 51, 90):
        told = feed(lives, scan, (HIT,) if scan != 51 else (ABSENT,))
        assert told.track.tolist() == [1]
        assert not told.last.any()
        assert told.hit_utc_ns.tolist() == [START_NS + (51 if scan < 90 else 91) * S]


def test_a_beam_may_come_by_half_a_turn_late() -> None:
    rule = TrackRule(
        confirm_hits=1, confirm_window=1, drop_misses=2, period_ns=S, patience_ns=S // 2
    )
    lives = TrackLives(rule)
    told = [feed(lives, 0, (HIT,), S // 8)]
    told += [feed(lives, k, (ABSENT,), S // 8) for k in range(1, 30)]
    assert [k for k, t in enumerate(told) if len(t)] == [0, 12, 20]
    assert [t.misses.tolist() for t in told if len(t)] == [[0], [1], [2]]
    assert told[20].last.tolist() == [True]


def test_numbers_start_again_and_leave_out_those_in_use() -> None:
    rule = TrackRule(confirm_hits=1, confirm_window=1, drop_misses=1, period_ns=S, last_number=3)
    lives = TrackLives(rule)
    assert feed(lives, 0, (HIT, HIT)).track.tolist() == [1, 2]
    assert feed(lives, 1, (HIT, MISS)).track.tolist() == [1, 2]
    assert feed(lives, 2, (HIT, HIT, HIT, HIT)).track.tolist() == [1, 3, 2]  # and none is left
    assert feed(lives, 3, (MISS, HIT, HIT, MISS)).last.tolist() == [True, False, False]
    assert feed(lives, 4, (MISS, HIT, HIT, HIT)).track.tolist() == [3, 2, 1]


def test_drones_of_no_account_are_forgotten() -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=2, period_ns=S)
    lives = TrackLives(rule)
    feed(lives, 0, (HIT, MISS, ABSENT))
    assert lives.drones.tolist() == [0]
    for scan in range(1, 4):
        feed(lives, scan, (MISS, MISS, MISS))
    assert lives.drones.tolist() == []
