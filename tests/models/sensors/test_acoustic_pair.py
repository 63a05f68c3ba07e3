"""Two arrays that triangulate: crossings, their covariance, and what each array hears."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp
from support.microphones import SECTION_4, sounding

from plotfeed.models.effects.readings import own_axes
from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.models.sensors.acoustic import AcousticPair, crossing
from plotfeed.models.state import FALSE_ALARM, NS

ARRAY = replace(SECTION_4, sensitivity_db=0.0, azimuth_floor_deg=1.0)
PAIR = AcousticPair(range_max_m=1000.0, array=ARRAY, baseline_enu_m=(200.0, 0.0, 0.0))
ONE = np.ones(1)
targets = partial(sounding, 100 * NS)


@given(st.floats(-180, 180), st.floats(20, 900), st.floats(-300, 300), st.floats(30, 300))
def test_bearings_to_a_place_cross_there(
    azimuth_deg: float, range_m: float, east_m: float, north_m: float
) -> None:
    place = aer_to_enu(azimuth_deg, 0.0, range_m)
    other_deg, _, other_m = enu_to_aer(place - np.array([east_m, north_m, 0.0]))
    met = crossing(np.array([azimuth_deg]), other_deg, (east_m, north_m, 0.0), ONE, ONE)
    baseline_m = np.hypot(east_m, north_m)
    if np.hypot(*(place[:2] - [east_m, north_m])) < 1 or baseline_m < 1:
        return
    if abs(np.sin(np.radians(azimuth_deg - other_deg))) < 1e-4:
        return  # on the baseline
    assert met.range_m == pytest.approx(range_m, rel=1e-6)
    assert met.other_range_m == pytest.approx(float(other_m), rel=1e-6)


def test_arrays_that_stand_askew_both_read_so_and_hear_as_much() -> None:
    """A drone that flies: each array hears it elsewhere, by the true ground and by its own axes."""
    was_m = np.array([[60.0, 400.0, 50.0]])
    right = replace(
        targets(was_m, true_enu_m=was_m + np.array([20.0, 5.0, 0.0])), emitted_utc_ns=99 * NS * ONE
    )
    own = own_axes(azimuth_offset_deg=20.0, tilt_deg=5.0, tilt_azimuth_deg=70.0)
    askew = replace(right, position_enu_m=was_m @ own.T, own_axes=own)
    for array, skewed in (
        (right, askew),
        (PAIR.heard_by_second(right), PAIR.heard_by_second(askew)),
    ):
        np.testing.assert_allclose(skewed.position_enu_m, array.position_enu_m @ own.T, atol=1e-9)
        np.testing.assert_allclose(skewed.sensed_enu_m, array.position_enu_m, atol=1e-9)
    assert PAIR.predict(askew).snr == pytest.approx(PAIR.predict(right).snr, rel=1e-12)


def test_bearings_that_meet_behind_do_not_meet() -> None:
    met = crossing(np.array([-30.0]), np.array([30.0]), (200.0, 0.0, 0.0), ONE, ONE)
    assert np.isnan(met.range_m)


def test_bearings_a_billionth_of_a_degree_apart_keep_their_digits() -> None:
    first_deg, second_deg = 30.0, 30.0 - 1e-9
    met = crossing(np.array([first_deg]), np.array([second_deg]), (1e-9, 0.0, 0.0), ONE, ONE)
    with mp.workdps(40):
        first, second = (mp.radians(mp.mpf(x)) for x in (first_deg, second_deg))
        exact = mp.mpf(1e-9) * mp.cos(second) / mp.sin(first - second)
    plain = np.sin(np.radians(first_deg)) * np.cos(np.radians(second_deg))
    plain -= np.cos(np.radians(first_deg)) * np.sin(np.radians(second_deg))
    plain_m = 1e-9 * np.cos(np.radians(second_deg)) / plain
    assert met.range_m[0] == pytest.approx(float(exact), rel=1e-13)
    assert abs(plain_m / float(exact) - 1) > 1e-8


@pytest.mark.parametrize("place_enu_m", [(80.0, 150.0), (300.0, 100.0), (-50.0, -200.0)])
def test_the_covariance_is_that_of_places_by_noisy_bearings(
    place_enu_m: tuple[float, float],
) -> None:
    rng, n = np.random.default_rng(11), 40_000
    place = np.array([*place_enu_m, 0.0])
    first_deg = enu_to_aer(place)[0]
    second_deg = enu_to_aer(place - np.array(PAIR.baseline_enu_m))[0]
    sigmas = np.full(n, 0.3), np.full(n, 0.5)
    noisy = (
        first_deg + sigmas[0] * rng.standard_normal(n),
        second_deg + sigmas[1] * rng.standard_normal(n),
    )
    met = crossing(*noisy, PAIR.baseline_enu_m, *sigmas)
    found_m = aer_to_enu(noisy[0], 0.0, met.range_m)[:, :2]
    true = crossing(
        np.array([first_deg]), np.array([second_deg]), PAIR.baseline_enu_m, sigmas[0][:1],
        sigmas[1][:1],
    )  # fmt: skip
    expected = np.array(
        [[true.east_m2[0], true.east_north_m2[0]], [true.east_north_m2[0], true.north_m2[0]]]
    )
    np.testing.assert_allclose(np.cov(found_m.T), expected, rtol=0.06, atol=0.04 * expected.trace())
    along = place[:2] / np.linalg.norm(place)
    assert true.sigma_range_m[0] ** 2 == pytest.approx(along @ expected @ along, rel=1e-9)


def test_errors_grow_without_bounds_towards_the_baseline_and_are_refused_there() -> None:
    away_m = np.array([200.0, 50.0, 10.0, 3.0, 1.0])
    places = np.stack([np.full(5, 320.0), away_m, np.zeros(5)], axis=-1)
    found = PAIR.predict(targets(places, 110.0))
    assert (np.diff(found.sigma_range_m[:3]) > 0).all()
    assert found.pd[0] > 0.9
    assert found.pd[-1] == 0.0
    assert np.isnan(found.sigma_range_m[-1])
    _, plots = PAIR.observe(targets(places[-1:], 110.0), np.random.default_rng(1))
    assert (plots.sigma_range_m <= PAIR.range_max_m).all()


def test_the_second_array_hears_a_drone_where_it_was_when_its_sound_left_for_it() -> None:
    velocity, now = np.array([15.0, -8.0, 2.0]), np.array([250.0, 300.0, 60.0])
    delay_s = 1.0
    for _ in range(60):
        delay_s = np.linalg.norm(now - velocity * delay_s) / ARRAY.sound_speed_m_s
    heard = targets(now - velocity * delay_s, true_enu_m=now[None])
    heard = replace(heard, emitted_utc_ns=heard.t_utc_ns - int(delay_s * NS))
    other = PAIR.heard_by_second(heard)
    travelled_m = np.linalg.norm(other.position_enu_m[0])
    flown = (other.true_position_enu_m - other.position_enu_m)[0]
    np.testing.assert_allclose(flown, velocity * travelled_m / ARRAY.sound_speed_m_s, rtol=1e-6)
    np.testing.assert_allclose(other.true_position_enu_m[0], now - PAIR.baseline_enu_m)


def test_every_bearing_crosses_every_other_and_only_the_right_ones_are_of_drones() -> None:
    """Four drones north of both arrays: four plots of theirs, and ghosts where bearings meet."""
    sharp = replace(PAIR, array=replace(ARRAY, azimuth_floor_deg=0.01, sensitivity_db=-200.0))
    places = [[-60.0, 200.0, 0.0], [20.0, 260.0, 0.0], [150.0, 220.0, 0.0], [260.0, 240.0, 0.0]]
    _, plots = sharp.observe(targets(places, 130.0), np.random.default_rng(3))
    east, north = np.array(places).T[:2]
    first, second = np.arctan2(east, north), np.arctan2(east - 200.0, north)
    meets = np.sin(first[:, None] - second) > 0
    assert sorted(plots.drone[plots.drone != FALSE_ALARM].tolist()) == [0, 1, 2, 3]
    assert 0 < len(plots) - 4 <= meets.sum() - 4
    assert np.isnan(plots.true_range_m[plots.drone == FALSE_ALARM]).all()
