"""Doppler by itself: rates of ranges, what looks alike, and what passes the notch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.effects.doppler import Doppler, range_rate_m_s
from plotfeed.models.propagation import bistatic_range

CHANNEL = np.zeros(1, np.int64)
metres = st.floats(-20e3, 20e3)
speeds = st.floats(-60.0, 60.0)
triples = st.tuples(metres, metres, metres)
velocities = st.tuples(speeds, speeds, speeds)


def doppler(**changes) -> Doppler:
    keys = {"cells_m_s": (0.25,), "spans_m_s": (40.0,), "floors_m_s": (0.0,), "folds": True}
    return Doppler(**(keys | {"notch_m_s": 1.0} | changes))


@given(triples, velocities, triples)
def test_the_rate_of_a_bistatic_range_is_its_derivative(place, velocity, transmitter):
    place, velocity, transmitter = map(np.array, (place, velocity, transmitter))
    near = min(np.linalg.norm(place), np.linalg.norm(place - transmitter))
    if near < 100.0 or np.linalg.norm(transmitter) < 100.0:
        return
    step_s = 1e-3
    ahead, behind = (bistatic_range(place + s * velocity, transmitter) for s in (step_s, -step_s))
    rate = range_rate_m_s(place, velocity) + range_rate_m_s(place, velocity, transmitter)
    assert rate == pytest.approx((ahead - behind) / (2 * step_s), abs=1e-4)


@given(st.floats(-1e4, 1e4))
def test_a_folded_rate_is_the_nearest_to_zero_of_those_that_look_alike(rate):
    seen = doppler().folded(np.array([rate]), CHANNEL)[0]
    assert abs(seen) <= 20.0 * (1 + 1e-12)
    turns = (rate - seen) / 40.0
    assert turns == pytest.approx(round(turns), abs=1e-9)
    if abs(rate) <= 20.0:
        assert seen == rate


@given(st.floats(-1e4, 1e4), st.floats(0.01, 30.0), st.booleans())
def test_a_share_is_a_share_and_standing_still_has_none(rate, notch, folds):
    case = doppler(notch_m_s=notch, folds=folds)
    share = case.share_passed(np.array([rate]), CHANNEL)[0]
    assert 0 <= share <= 1
    assert case.share_passed(np.zeros(1), CHANNEL)[0] == 0
    assert share == case.share_passed(np.array([-rate]), CHANNEL)[0]


def test_a_rate_a_millionth_of_the_notch_passes_a_trillionth():
    """The plain form, one less an exponential near one, keeps four digits of it."""
    share = doppler().share_passed(np.array([1e-6]), CHANNEL)[0]
    assert share == pytest.approx(1e-12, rel=1e-11)
    assert abs((1 - np.exp(-1e-12)) / 1e-12 - 1) > 1e-5
