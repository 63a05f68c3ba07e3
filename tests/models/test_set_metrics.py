from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.track_metrics import set_score


def distances(truth: list[float], tracks: list[float]) -> np.ndarray:
    return np.abs(np.subtract.outer(np.array(truth, float), np.array(tracks, float)))


def test_the_worked_case() -> None:
    """Truths at 0 and 100, tracks at 3, 104 and 500, c 50, p 2."""
    score = set_score(distances([0, 100], [3, 104, 500]), 50.0, 2.0)
    assert (score.localisation, score.missed, score.false) == (25.0, 0.0, 1250.0)
    assert score.gospa_m() == pytest.approx(35.7071, abs=1e-4)
    assert score.ospa_m == pytest.approx(29.0115, abs=1e-4)
    assert (score.rows.tolist(), score.columns.tolist()) == ([0, 1], [0, 1])


@pytest.mark.parametrize(
    ("shape", "gospa_m", "ospa_m"),
    [((0, 0), 0.0, 0.0), ((2, 0), 50.0, 50.0), ((0, 1), 50 / 2**0.5, 50.0)],
)
def test_nothing_on_one_side(shape: tuple[int, int], gospa_m: float, ospa_m: float) -> None:
    score = set_score(np.zeros(shape), 50.0, 2.0)
    assert score.gospa_m() == pytest.approx(gospa_m)
    assert score.ospa_m == ospa_m


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
    apart = distances(truth, tracks)
    score = set_score(apart, cutoff_m, order)
    gospa_m, ospa_m = by_all_pairings(apart, cutoff_m, order)
    assert score.gospa_m(order) == pytest.approx(gospa_m, rel=1e-9, abs=1e-6)
    assert score.ospa_m == pytest.approx(ospa_m, rel=1e-9, abs=1e-6)


@given(places, places, st.randoms())
def test_the_order_of_either_does_not_matter(truth: list, tracks: list, chance: object) -> None:
    apart = distances(truth, tracks)
    rows, columns = list(range(len(truth))), list(range(len(tracks)))
    chance.shuffle(rows)  # type: ignore[attr-defined]
    chance.shuffle(columns)  # type: ignore[attr-defined]
    one, other = set_score(apart, 40.0), set_score(apart[rows][:, columns], 40.0)
    assert other[:4] == pytest.approx(one[:4], rel=1e-9, abs=1e-6)
