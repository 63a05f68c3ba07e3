"""Scores of sets of tracks, in steps of time, of flights and of tracks that follow them."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.signal import lfilter
from support.significance import assert_chance

from plotfeed.models.frames import LocalFrame
from plotfeed.models.track_metrics import (
    FlightPath,
    Grid,
    GridRows,
    Level,
    Segments,
    TrackHolder,
    TrackReports,
    along_enu,
    covered_at,
    followed,
    lag_parts,
    nees,
    on_grid,
    ospa2_m,
    rates,
    rates_by_differences,
    segments_of,
    set_score,
    stays_of,
    survival_quantile,
    swaps_of,
    t_gospa,
)
from plotfeed.models.verdicts import FigureSamples


def test_what_is_at_the_cut_off_or_unknown_is_missed_and_false() -> None:
    for distance in (50.0, 80.0, np.nan, np.inf):
        score = set_score(np.array([[distance]]), 50.0, 2.0)
        assert (score.localisation, score.missed, score.false) == (0.0, 1250.0, 1250.0)
        assert len(score.rows) == 0


def by_all_pairings(apart: np.ndarray, cutoff_m: float, order: float) -> tuple[float, float]:
    """GOSPA and OSPA by their definitions: every pairing is tried."""
    if apart.shape[0] > apart.shape[1]:
        apart = apart.T
    m, n = apart.shape
    limit = cutoff_m**order
    gospa = ospa = np.inf
    for chosen in permutations(range(n), m):
        each = apart[np.arange(m), list(chosen)]
        cut = np.minimum(each, cutoff_m) ** order
        ospa = min(ospa, cut.sum() + limit * (n - m))
        for mask in range(1 << m):
            paired = [i for i in range(m) if mask >> i & 1]
            if all(each[i] < cutoff_m for i in paired):
                cost = sum(each[i] ** order for i in paired)
                gospa = min(gospa, cost + limit / 2 * (m + n - 2 * len(paired)))
    return gospa ** (1 / order), (ospa / n) ** (1 / order) if n else 0.0


places = st.lists(st.floats(0, 100), max_size=4)


@given(places, places, st.floats(1, 60), st.sampled_from([1.0, 2.0]))
def test_no_pairing_is_better(
    truth: list[float], tracks: list[float], cutoff_m: float, order: float
) -> None:
    apart = np.abs(np.subtract.outer(np.array(truth, float), np.array(tracks, float)))
    score = set_score(apart, cutoff_m, order)
    gospa_m, ospa_m = by_all_pairings(apart, cutoff_m, order)
    assert score.gospa_m(order) == pytest.approx(gospa_m, rel=1e-9, abs=1e-6)
    assert score.ospa_m == pytest.approx(ospa_m, rel=1e-9, abs=1e-6)


NS = 1_000_000_000
T_NS = 1_767_268_800 * NS
GRID = Grid(start_utc_ns=T_NS, step_ns=NS, steps=10)


def reports(*rows: tuple[float, float, int], ended: tuple[int, ...] = ()) -> TrackReports:
    """Of a track that flies along the first axis at 2 m/s: time, when it came, number."""
    t_s, known_s, track = (np.array(column) for column in zip(*rows, strict=True))
    n = len(rows)
    return TrackReports(
        t_utc_ns=T_NS + np.round(t_s * NS).astype(np.int64),
        known_utc_ns=T_NS + np.round(known_s * NS).astype(np.int64),
        track=track.astype(np.int64),
        point=np.stack([2 * t_s, *[np.zeros(n)] * 3], axis=-1),
        rate=np.tile([2.0, 0.0, 0.0, 0.0], (n, 1)),
        ended=np.isin(np.arange(n), ended),
    )


def grid_places(rows: GridRows) -> dict[tuple[int, int], float]:
    return {
        (int(k), int(track)): float(point[0])
        for k, track, point in zip(rows.step, rows.track, rows.point, strict=True)
    }


def test_a_track_is_moved_on_until_it_is_stale() -> None:
    found = grid_places(on_grid(reports((0.5, 0.5, 0), (2.5, 2.5, 0)), GRID, 3.0, as_known=False))
    assert found == {(k, 0): pytest.approx(2.0 * k) for k in (1, 2, 3, 4, 5)}


def test_as_known_reports_count_from_when_they_came_and_none_that_was_overtaken() -> None:
    given = reports((0.0, 2.0, 0), (1.0, 2.5, 0), (2.0, 9.0, 0))
    rows = on_grid(given, GRID, 4.0, as_known=True)
    ages_s = dict(zip(rows.step.tolist(), rows.age_s.tolist(), strict=True))
    assert ages_s == {2: 2.0, 3: 2.0, 4: 3.0, 5: 4.0}
    given = reports((0.0, 5.0, 0), (1.0, 1.0, 0), (1.0, 1.0, 1), (2.0, 2.0, 1))
    rows = on_grid(given, GRID, 10.0, as_known=True)
    assert set(rows.report[rows.track == 0].tolist()) == {1}
    assert set(rows.report[rows.track == 1].tolist()) == {2, 3}


def test_rows_are_by_step_and_track_and_none_is_there_twice() -> None:
    rng = np.random.default_rng(1)
    given = reports(*sorted(((t, t + 0.1, k) for k in range(4) for t in rng.uniform(0, 9, 30)),
                            key=lambda row: (row[2], row[0])))  # fmt: skip
    for as_known in (False, True):
        rows = on_grid(given, GRID, 2.0, as_known=as_known)
        keys = rows.step * 10 + rows.track
        assert (np.diff(keys) > 0).all()
        for k, track, report in zip(rows.step, rows.track, rows.report, strict=True):
            of_track = np.flatnonzero(given.track == track)
            at_ns = (given.known_utc_ns if as_known else given.t_utc_ns)[of_track]
            assert report == of_track[at_ns <= T_NS + k * NS][-1]


def test_a_velocity_that_is_not_told_is_that_between_the_last_two_reports() -> None:
    given = reports((0.0, 0.0, 0), (1.0, 1.0, 0), (2.0, 2.0, 1), (20.0, 20.0, 1))
    rate = np.full((4, 4), np.nan)
    found = rates_by_differences(given.track, given.t_utc_ns, given.point, rate, 10.0)
    assert found[1].tolist() == [2.0, 0.0, 0.0, 0.0]
    assert np.isnan(found[[0, 2, 3]]).all()


CUTOFF_M = 10.0


def drawn(seed: int, steps: int, drones: int, tracks: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0, 20, (steps, drones, tracks)),
        rng.random((steps, drones)) < 0.8,
        rng.random((steps, tracks)) < 0.8,
    )


def by_dynamic_programming(
    apart: np.ndarray, drones: np.ndarray, tracks: np.ndarray, order: float, switch: float
) -> float:
    """T-GOSPA of one or two flights and tracks, over all ways to pair them at each step."""
    limit, change = CUTOFF_M**order, switch**order / 2
    _, flights, of_tracks = apart.shape
    single = list(product(range(flights), range(of_tracks)))
    pairings = [set(), *({one} for one in single)]
    pairings += [{a, b} for a, b in combinations(single, 2) if a[0] != b[0] and a[1] != b[1]]

    def cost(k: int, pairs: set[tuple[int, int]]) -> float:
        total = limit / 2 * (drones[k].sum() + tracks[k].sum())
        for i, j in pairs:
            if drones[k, i] and tracks[k, j]:
                total += min(apart[k, i, j], CUTOFF_M) ** order - limit
        return total

    best = [cost(0, pairs) for pairs in pairings]
    for k in range(1, len(apart)):
        best = [
            cost(k, now)
            + min(b + change * len(now ^ was) for b, was in zip(best, pairings, strict=True))
            for now in pairings
        ]
    return min(best)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("flights", "of_tracks"), [(1, 1), (1, 2), (2, 2)])
def test_it_is_the_cheapest_way_through_all_pairings(
    seed: int, flights: int, of_tracks: int
) -> None:
    """The linear programme may only be lower where it splits a pairing, which these do not."""
    apart, drones, tracks = drawn(seed, 6, flights, of_tracks)
    for switch in (0.0, 0.5, 4.0, 9.0):
        found = sum(t_gospa(apart, drones, tracks, cutoff_m=CUTOFF_M, order=2.0, switch_m=switch))
        best = by_dynamic_programming(apart, drones, tracks, 2.0, switch)
        assert found <= best + 1e-6
        if flights == 1 or switch == 0:
            assert found == pytest.approx(best)


@pytest.mark.parametrize(
    ("track_there", "found_m"),
    [
        ([[0], [0], [1], [1]], 5.5),  # it comes late: (10 + 10 + 1 + 1) / 4
        ([[1, 0], [1, 0], [0, 1], [0, 1]], ((5.5**2 + 10.0**2) / 2) ** 0.5),  # half of it each
    ],
)
def test_ospa2_of_a_flight_over_four_steps_and_tracks_1_m_off(
    track_there: list[list[int]], found_m: float
) -> None:
    there = np.array(track_there, np.bool_)
    apart = np.ones((4, 1, there.shape[1]))
    assert ospa2_m(apart, np.ones((4, 1), np.bool_), there, CUTOFF_M, 2.0) == pytest.approx(found_m)


FRAME = LocalFrame(40.45, -3.73, 650.0)


def turning(t_s: np.ndarray) -> np.ndarray:
    """15 m/s on a circle of 60 m: 3.75 m/s2."""
    angle = t_s * 15.0 / 60.0
    return np.stack([60 * np.cos(angle), 60 * np.sin(angle), 100 + 0 * t_s], axis=-1)


def path_of(t_s: np.ndarray, gap_s: float = 6.0) -> FlightPath:
    return FlightPath.of(at_ns(t_s), FRAME.to_ecef(turning(t_s)), round(gap_s * NS))


def at_ns(t_s: np.ndarray) -> np.ndarray:
    return T_NS + np.round(t_s * NS).astype(np.int64)


def test_between_looks_of_a_second_a_turn_is_known_to_centimetres() -> None:
    t_s = np.linspace(2.0, 27.0, 301)
    place_m, velocity_m_s = path_of(np.arange(0.0, 30.0, 1.0)).states_at(at_ns(t_s))
    wrong_m = np.linalg.norm(FRAME.from_ecef(place_m) - turning(t_s), axis=1)
    assert wrong_m.max() < 0.06
    assert np.abs(np.linalg.norm(velocity_m_s, axis=1) - 15.0).max() < 0.35


def test_beyond_the_ends_and_in_gaps_it_is_not_there() -> None:
    path = path_of(np.array([0.0, 1.0, 2.0, 10.0, 11.0]))
    place_m, _ = path.states_at(at_ns(np.array([-0.1, 0.0, 1.5, 5.0, 10.5, 11.0, 11.1])))
    there = np.isfinite(place_m[:, 0]).tolist()
    assert there == [False, True, True, False, True, True, False]


def test_cover_is_between_looks_that_are_near_each_other() -> None:
    looks = np.array([0, 1, 2, 10, 11])
    at = np.array([-1, 0, 1, 2, 5, 10, 11, 12])
    assert covered_at(looks, at, 3).tolist() == [False, *[True] * 3, False, True, True, False]
    assert stays_of(looks, 3) == [(0, 2), (10, 11)]
    assert stays_of(looks[:0], 3) == []


def test_errors_over_the_ground_are_east_and_north_at_the_drone() -> None:
    """20 km from the site, where the site's own horizontal leans by a fifth of a degree."""
    place = FRAME.to_ecef(np.array([14_000.0, 14_000.0, 300.0]))
    latitude_deg, longitude_deg, height_m = FRAME.to_geodetic([14_000.0, 14_000.0, 300.0])
    there = LocalFrame(float(latitude_deg), float(longitude_deg), float(height_m))
    assert np.linalg.norm(there.origin_ecef_m - place) < 1e-6
    wrong = there.to_geodetic(np.array([30.0, -40.0, 7.0]))
    level = Level(float(height_m))
    at = (np.array([each]) for each in (latitude_deg, longitude_deg))
    true_point = level.points(latitude_deg, longitude_deg, height_m)[None]
    point = level.points(wrong[0], wrong[1], wrong[2])[None]
    error_m = along_enu(point - true_point, *at)
    assert error_m[0] == pytest.approx([30.0, -40.0, 7.0], abs=2e-3)
    assert np.linalg.norm((point - true_point)[0, :3]) == pytest.approx(50.0, abs=2e-3)


def test_a_velocity_moves_a_point_as_far_as_it_says() -> None:
    at = np.array([40.0]), np.array([-3.0])
    rate = rates(*at, np.array([[3.0, -4.0, np.nan]]))[0]
    assert np.linalg.norm(rate[:3]) == pytest.approx(5.0)
    assert rate[3] == 0.0
    assert along_enu(rate[None], *at)[0] == pytest.approx([3.0, -4.0, 0.0])


def held(apart: np.ndarray, confirm: int = 2, end: int = 3) -> set[tuple[int, int, int]]:
    """Step, drone and track of all that is held, of distances (steps, drones, tracks)."""
    steps, drones, tracks = apart.shape
    holder = TrackHolder(drones, tracks, 10.0, confirm_steps=confirm, end_steps=end)
    found = set()
    for k in range(steps):
        of, whose, since = holder.step(k, np.arange(drones), np.arange(tracks), apart[k])
        for track, drone, first in zip(of, whose, since, strict=True):
            found |= {(step, int(drone), int(track)) for step in range(first, k + 1)}
    return found


def test_a_track_counts_from_its_first_step_once_a_second_confirms_it() -> None:
    apart = np.full((4, 1, 1), 1.0)
    apart[0] = 50.0
    assert held(apart) == {(1, 0, 0), (2, 0, 0), (3, 0, 0)}
    apart[2:] = 50.0
    assert held(apart) == set()


def test_a_crossing_is_no_swap_and_parting_is_one() -> None:
    """Two drones cross within the gate; then the tracks fly on with the other drone each."""
    along = np.linspace(-40, 40, 21)
    drones = np.stack([along, -along], axis=1)
    crossing = np.abs(drones[:, :, None] - drones[:, None, :])
    rows = held(crossing)
    assert rows == {(k, d, d) for k in range(21) for d in range(2)}
    exchanged = np.where(along[:, None] < 0, drones, drones[:, ::-1])
    rows = held(np.abs(drones[:, :, None] - exchanged[:, None, :]))
    step, drone, track = np.array(sorted(rows)).T
    assert swaps_of(segments_of(track, drone, step, 3)) == 2


def test_out_of_the_gate_for_two_steps_is_still_the_same() -> None:
    for out, (first, last) in ((5, ([0], [9])), (7, ([0, 7], [2, 9]))):
        apart = np.full((10, 1, 1), 1.0)
        apart[3:out] = 50.0
        step, drone, track = np.array(sorted(held(apart))).T
        parts = segments_of(track, drone, step, 3)
        assert (parts.first.tolist(), parts.last.tolist()) == (first, last)


def test_a_track_that_is_near_another_drone_for_two_steps_stays_whose_it_was() -> None:
    apart = np.full((12, 2, 1), 50.0)
    apart[:, 0] = 1.0
    apart[5:7] = np.array([[50.0], [1.0]])
    assert {drone for _, drone, _ in held(apart)} == {0}
    apart[5:] = np.array([[50.0], [1.0]])
    assert {(k, drone) for k, drone, _ in held(apart) if k >= 5} == {(k, 1) for k in range(7, 12)}


def segments(*rows: tuple[int, int, int]) -> Segments:
    track, first, last = (np.array(column) for column in zip(*rows, strict=True))
    return Segments(track=track, drone=np.zeros(len(rows), np.int64), first=first, last=last)


THERE = np.arange(20)


@pytest.mark.parametrize(
    ("rows", "changes", "breaks", "longest"),
    [
        ([(1, 0, 19)], 0, 0, 20),
        ([(1, 0, 9), (2, 10, 19)], 1, 0, 10),
        ([(1, 0, 9), (1, 15, 19)], 0, 1, 10),
        ([(1, 0, 9), (2, 5, 19)], 1, 0, 15),
        ([(1, 0, 12), (2, 3, 8), (3, 10, 19)], 1, 0, 13),
        ([(1, 2, 5), (2, 2, 19)], 0, 0, 18),
        ([(1, 0, 3), (2, 6, 9), (3, 12, 19)], 2, 2, 8),
    ],
)
def test_the_fewest_tracks_that_follow_a_drone(
    rows: list[tuple[int, int, int]], changes: int, breaks: int, longest: int
) -> None:
    found = followed(segments(*rows), THERE)
    assert (found.number_changes, found.breaks, found.longest_steps) == (changes, breaks, longest)


def test_while_a_drone_is_not_there_no_track_of_it_is_broken() -> None:
    there = np.concatenate([np.arange(8), np.arange(15, 20)])
    assert followed(segments((1, 0, 7), (2, 15, 19)), there).breaks == 0
    assert followed(segments((1, 0, 6), (2, 15, 19)), there).breaks == 1


N = 4000


@pytest.mark.parametrize("dimensions", [2, 3])
def test_nees_of_honest_errors_has_a_chi_squared_law(dimensions: int) -> None:
    """Of errors that have covariances of their own."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(N, dimensions, dimensions)) + 2 * np.eye(dimensions)
    errors = (root @ rng.normal(size=(N, dimensions, 1)))[:, :, 0]
    values = nees(errors, root @ root.transpose(0, 2, 1))
    assert_chance(float(stats.kstest(values, stats.chi2(dimensions).cdf).pvalue), "NEES")


def test_nees_is_nan_where_a_covariance_is_none() -> None:
    covariance = np.array([[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0], [0, 1.0]], np.eye(2)])
    values = nees(np.ones((3, 2)), covariance)
    assert np.isnan(values[:2]).all()
    assert values[2] == pytest.approx(2.0)


def correlated(rng: np.random.Generator, shape: tuple[int, ...], along: float) -> np.ndarray:
    """Normal numbers whose first axis is time, with that correlation from one to the next."""
    drawn_errors, own = rng.standard_normal(shape), (1 - along**2) ** 0.5
    drawn_errors[0] /= own
    return np.asarray(lfilter([own], [1.0, -along], drawn_errors, axis=0))


RUNS, STEPS = 300, 300


@pytest.mark.parametrize("along", [0.0, 0.8, 0.95])
def test_lag_and_nees_lie_within_their_intervals_however_errors_hang_together(along: float) -> None:
    """|z| > 1.96 in 5 of 100, and at most in 8 where few samples are left of 0.95."""
    rng, outside = np.random.default_rng(1), {"lag": 0, "nees": 0}
    one, five = np.zeros(STEPS, np.int64), np.repeat(np.arange(5), STEPS)
    for _ in range(RUNS):
        course = np.cumsum(rng.normal(0.0, 0.3, STEPS))
        velocity = 12.0 * np.stack([np.sin(course), np.cos(course)], axis=-1)
        errors = correlated(rng, (STEPS, 6, 2), along)
        late = -0.3 * velocity + 8.0 * errors[:, 5]
        lag = FigureSamples(*lag_parts(late, velocity), one).interval()
        squares = (errors[:, :5] ** 2).sum(axis=2).T.ravel()
        ratio = FigureSamples(squares, np.full(len(squares), 2.0), five).interval()
        outside["lag"] += not lag.low <= 0.3 <= lag.high
        outside["nees"] += not ratio.low <= 1.0 <= ratio.high
    assert outside["lag"] <= stats.binom.ppf(1 - 1e-4, RUNS, 0.05)
    assert outside["nees"] <= stats.binom.ppf(1 - 1e-4, RUNS, 0.07)


def test_hovering_has_no_lag() -> None:
    for n, velocity in ((5, 0.0), (0, 1.0)):
        parts, wholes = lag_parts(np.ones((n, 2)), np.full((n, 2), velocity))
        assert np.isnan(FigureSamples(parts, wholes, np.zeros(n, np.int64)).value)


def test_those_who_never_did_are_in_the_median() -> None:
    """Kaplan and Meier by hand: 1/4 by 2, then (3/4)(1/2) left after 5, below a half."""
    values, seen = np.array([2.0, 3.0, 5.0, 9.0]), np.array([True, False, True, False])
    assert survival_quantile(values, seen) == 5.0
    assert survival_quantile(values, seen, 0.2) == 2.0
    assert survival_quantile(values, np.zeros(4, np.bool_)) == float("inf")
    assert survival_quantile(values, np.ones(4, np.bool_)) == 3.0
    assert np.isnan(survival_quantile(values[:0], seen[:0]))
