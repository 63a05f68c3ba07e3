from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models import track_metrics
from plotfeed.models.track_metrics import ospa2_m, set_score, t_gospa

CUTOFF_M, ORDER, SWITCH_M = 10.0, 1.0, 2.0


def worked(track_there: list[list[int]]) -> float:
    """One flight over four steps, tracks 1 m off it."""
    there = np.array(track_there, np.bool_)
    return t_gospa(
        np.ones((4, 1, there.shape[1])),
        np.ones((4, 1), np.bool_),
        there,
        cutoff_m=CUTOFF_M,
        order=ORDER,
        switch_m=SWITCH_M,
    ).t_gospa_m(ORDER)


def test_a_hand_over_half_way_costs_a_switch() -> None:
    assert worked([[1, 0], [1, 0], [0, 1], [0, 1]]) == pytest.approx(6.0)


def test_a_track_that_ends_half_way_costs_what_is_missed() -> None:
    assert worked([[1], [1], [0], [0]]) == pytest.approx(12.0)


def test_one_track_throughout_costs_its_error_alone() -> None:
    assert worked([[1], [1], [1], [1]]) == pytest.approx(4.0)


def drawn(seed: int, steps: int, drones: int, tracks: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0, 20, (steps, drones, tracks)),
        rng.random((steps, drones)) < 0.8,
        rng.random((steps, tracks)) < 0.8,
    )


def test_without_switching_costs_it_is_gospa_step_by_step() -> None:
    apart, drones, tracks = drawn(1, 5, 3, 4)
    whole = t_gospa(apart, drones, tracks, cutoff_m=CUTOFF_M, order=2.0, switch_m=0.0)
    each = [
        set_score(apart[k][drones[k]][:, tracks[k]], CUTOFF_M, 2.0).gospa_m() ** 2 for k in range(5)
    ]
    assert sum(whole) == pytest.approx(sum(each))


def by_dynamic_programming(
    apart: np.ndarray, drones: np.ndarray, tracks: np.ndarray, order: float, switch: float
) -> float:
    """T-GOSPA of one or two flights and two tracks, over all ways to pair them at each step."""
    limit, change = CUTOFF_M**order, switch**order / 2
    pairings = [set(), {(0, 0)}, {(0, 1)}]
    if apart.shape[1] == 2:
        pairings += [{(1, 0)}, {(1, 1)}, {(0, 0), (1, 1)}, {(0, 1), (1, 0)}]

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
@pytest.mark.parametrize("flights", [1, 2])
def test_it_is_the_cheapest_way_through_all_pairings(seed: int, flights: int) -> None:
    """The linear programme may only be lower where it splits a pairing, which these do not."""
    apart, drones, tracks = drawn(seed, 6, flights, 2)
    for switch in (0.5, 4.0):
        found = sum(t_gospa(apart, drones, tracks, cutoff_m=CUTOFF_M, order=2.0, switch_m=switch))
        assert found <= by_dynamic_programming(apart, drones, tracks, 2.0, switch) + 1e-6
        if flights == 1:
            best = by_dynamic_programming(apart, drones, tracks, 2.0, switch)
            assert found == pytest.approx(best)


@pytest.mark.parametrize("seed", range(5))
def test_pairs_without_rivals_are_as_the_programme_has_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    saved = rng.uniform(-100, 0, (8, 3)) * (rng.random((8, 3)) < 0.5)
    number = np.arange(3)
    for change in (1.0, 30.0):
        costs = []
        for weights in (
            track_metrics._alone(saved, change),
            track_metrics._together(saved, number, number, change),
        ):
            moves = np.abs(np.diff(weights, axis=0)).sum()
            costs.append((weights * saved).sum() + change * moves)
        assert costs[0] == pytest.approx(costs[1])


def test_ospa2_of_a_track_that_comes_late() -> None:
    """A flight over four steps; a track 1 m off over the last two: (10 + 10 + 1 + 1) / 4."""
    there = np.array([[0], [0], [1], [1]], np.bool_)
    found_m = ospa2_m(np.ones((4, 1, 1)), np.ones((4, 1), np.bool_), there, CUTOFF_M, 2.0)
    assert found_m == pytest.approx(5.5)


def test_ospa2_of_one_flight_and_two_tracks() -> None:
    """Half of it each: ((5.5^2 + 10^2) / 2)^(1/2)."""
    there = np.array([[1, 0], [1, 0], [0, 1], [0, 1]], np.bool_)
    found_m = ospa2_m(np.ones((4, 1, 2)), np.ones((4, 1), np.bool_), there, CUTOFF_M, 2.0)
    assert found_m == pytest.approx(((5.5**2 + 100) / 2) ** 0.5)


def test_ospa2_of_nothing_is_nothing() -> None:
    none = np.zeros((4, 0), np.bool_)
    assert ospa2_m(np.zeros((4, 0, 0)), none, none, CUTOFF_M) == 0.0
