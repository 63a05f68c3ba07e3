"""What hears, and the range gate: levels, bearings of sound, crossings, link budgets and bursts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp
from support.targets import targets_at

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.effects.readings import Readings, own_axes
from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.models.numerics import root
from plotfeed.models.sensors.acoustic import AcousticPair, MicrophoneArray, crossing
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.rf import RfDirectionFinder
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import FALSE_ALARM, NS, Emitter
from plotfeed.models.truth import EmitterTable

SECTION_4 = MicrophoneArray(
    frequency_hz=1000.0, directivity_db=3.0, absorption_db_per_m=0.005, barrier_db=3.0,
    misc_db=3.0, array_gain_db=9.03, noise_db=0.0, sensitivity_db=32.0, slope_per_db=1.0, pfa=1e-6,
    range_max_m=1000.0, height_above_ground_m=1.5, sound_speed_m_s=343.2,
    azimuth_cover=AzimuthCover(-180.0, 180.0), azimuth_beamwidth_deg=11.0,
    elevation_beamwidth_deg=None, azimuth_floor_deg=0.0, elevation_floor_deg=0.0, kind="",
)  # fmt: skip
sounding = partial(targets_at, t_utc_ns=100 * NS)


def phantom(range_m: Any) -> Targets:
    """The drone of section 4, 50 m above the ground, at those slant ranges."""
    slant_m = np.atleast_1d(np.asarray(range_m, dtype=np.float64))
    up_m = np.full(len(slant_m), 50.0 - SECTION_4.height_above_ground_m)
    ground_m = np.sqrt(slant_m**2 - up_m**2)
    return sounding(np.stack([0.6 * ground_m, 0.8 * ground_m, up_m], axis=-1))


def test_section_4_hears_half_at_131_metres() -> None:
    pd = SECTION_4.predict(phantom([200.0, 150.0, 100.0, 75.0])).pd
    assert pd == pytest.approx([0.018, 0.224, 0.926, 0.994], abs=5e-4)
    half_m = root(lambda r: float(SECTION_4.predict(phantom(r)).pd[0]) - 0.5, 60.0, 500.0)
    assert half_m == pytest.approx(131.4, abs=0.1)


def test_a_drone_of_unknown_sound_is_not_heard() -> None:
    both = sounding([[0.0, 50.0, 10.0], [0.0, 60.0, 10.0]], sound_power_db=[np.nan, 130.0])
    looks, plots = SECTION_4.observe(both, np.random.default_rng(2))
    assert looks.drone.tolist() == plots.drone.tolist() == [1]
    predicted = SECTION_4.predict(both)
    assert predicted.pd == pytest.approx([0.0, 1.0])
    assert np.isnan(predicted.snr).tolist() == [True, False]


# Two arrays that triangulate.


ARRAY = replace(SECTION_4, sensitivity_db=0.0, azimuth_floor_deg=1.0)
PAIR = AcousticPair(range_max_m=1000.0, array=ARRAY, baseline_enu_m=(200.0, 0.0, 0.0))
ONE = np.ones(1)


@given(st.floats(-180, 180), st.floats(20, 900), st.floats(-300, 300), st.floats(30, 300))
def test_bearings_to_a_place_cross_there(
    azimuth_deg: float, range_m: float, east_m: float, north_m: float
) -> None:
    place = aer_to_enu(azimuth_deg, 0.0, range_m)
    other_deg, _, other_m = enu_to_aer(place - np.array([east_m, north_m, 0.0]))
    met = crossing(np.array([azimuth_deg]), other_deg, (east_m, north_m, 0.0), ONE, ONE)
    if np.hypot(*(place[:2] - [east_m, north_m])) < 1:
        return
    if abs(np.sin(np.radians(azimuth_deg - other_deg))) < 1e-4:
        return  # on the baseline
    assert met.range_m == pytest.approx(range_m, rel=1e-6)
    assert met.other_range_m == pytest.approx(float(other_m), rel=1e-6)


def test_arrays_that_stand_askew_both_read_so_and_hear_as_much() -> None:
    """A drone that flies: each array hears it elsewhere, by the true ground and by its own axes."""
    was_m = np.array([[60.0, 400.0, 50.0]])
    right = replace(
        sounding(was_m, true_enu_m=was_m + np.array([20.0, 5.0, 0.0])), emitted_utc_ns=99 * NS * ONE
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


def test_bearings_a_billionth_of_a_degree_apart_keep_their_digits() -> None:
    """And those that meet behind do not meet."""
    first_deg, second_deg = 30.0, 30.0 - 1e-9
    met = crossing(np.array([first_deg]), np.array([second_deg]), (1e-9, 0.0, 0.0), ONE, ONE)
    with mp.workdps(40):
        first, second = (mp.radians(mp.mpf(x)) for x in (first_deg, second_deg))
        exact = mp.mpf(1e-9) * mp.cos(second) / mp.sin(first - second)
    assert met.range_m[0] == pytest.approx(float(exact), rel=1e-13)
    behind = crossing(np.array([-30.0]), np.array([30.0]), (200.0, 0.0, 0.0), ONE, ONE)
    assert np.isnan(behind.range_m)


def test_errors_grow_without_bounds_towards_the_baseline_and_are_refused_there() -> None:
    away_m = np.array([200.0, 50.0, 10.0, 3.0, 1.0])
    places = np.stack([np.full(5, 320.0), away_m, np.zeros(5)], axis=-1)
    found = PAIR.predict(sounding(places, sound_power_db=110.0))
    assert (np.diff(found.sigma_range_m[:3]) > 0).all()
    assert found.pd[0] > 0.9
    assert found.pd[-1] == 0.0
    assert np.isnan(found.sigma_range_m[-1])
    last = sounding(places[-1:], sound_power_db=110.0)
    _, plots = PAIR.observe(last, np.random.default_rng(1))
    assert (plots.sigma_range_m <= PAIR.range_max_m).all()


def test_the_second_array_hears_a_drone_where_it_was_when_its_sound_left_for_it() -> None:
    velocity, now = np.array([15.0, -8.0, 2.0]), np.array([250.0, 300.0, 60.0])
    delay_s = 1.0
    for _ in range(60):
        delay_s = np.linalg.norm(now - velocity * delay_s) / ARRAY.sound_speed_m_s
    heard = sounding(now - velocity * delay_s, true_enu_m=now[None])
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
    _, plots = sharp.observe(sounding(places, sound_power_db=130.0), np.random.default_rng(3))
    east, north = np.array(places).T[:2]
    first, second = np.arctan2(east, north), np.arctan2(east - 200.0, north)
    meets = np.sin(first[:, None] - second) > 0
    assert sorted(plots.drone[plots.drone != FALSE_ALARM].tolist()) == [0, 1, 2, 3]
    assert 0 < len(plots) - 4 <= meets.sum() - 4
    assert np.isnan(plots.true_range_m[plots.drone == FALSE_ALARM]).all()


# The RF sensor.


FINDER = RfDirectionFinder(
    frequency_min_hz=2.40e9, frequency_max_hz=2.48e9, instantaneous_bandwidth_hz=80e6,
    channel_bandwidth_hz=1e6, integration_s=1e-3, gain_rx_dbi=3.0, loss_db=1.0,
    noise_figure_db=6.0, path_loss_exponent=2.0, path_loss_reference_m=1.0, pfa=1e-6,
    duty_cycle=1.0, bursts_per_dwell=1, range_max_m=10_000.0,
    azimuth_cover=AzimuthCover(-180.0, 180.0), azimuth_beams=1, measures_azimuth=True,
    baseline_m=0.3, azimuth_floor_deg=0.0, classifies=False, decodes=frozenset(),
)  # fmt: skip
CONTROL = Emitter(frequency_hz=2.44e9, bandwidth_hz=1e6, eirp_dbm=20.0, kind="control")
REMOTE_ID = Emitter(
    frequency_hz=2.437e9, bandwidth_hz=1e6, eirp_dbm=15.0, kind="remote-id", identity="1596F3"
)
VIDEO = Emitter(frequency_hz=5.8e9, bandwidth_hz=20e6, eirp_dbm=27.0, kind="video")


def emitting(*each: Sequence[Emitter], range_m: float = 1000.0) -> Targets:
    """A drone with each of those emitters, all in one place."""
    places = np.tile(aer_to_enu(70.0, 5.0, range_m), (len(each), 1))
    return targets_at(places, emitters=[tuple(own) for own in each], t_utc_ns=NS)


# Centre and width in MHz, and the share in the band from 2400 to 2480.
SHARES = [
    (2440, 20, 1.0), (2400, 20, 0.5), (2490, 20, 0.0), (2440, 160, 0.5), (2400, 0, 1.0),
    (2399.9, 0, 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("centre_mhz", "width_mhz", "share"), SHARES)
def test_share_of_an_emission_in_the_band(
    centre_mhz: float, width_mhz: float, share: float
) -> None:
    emitter = replace(CONTROL, frequency_hz=centre_mhz * 1e6, bandwidth_hz=width_mhz * 1e6)
    there, rng = emitting([emitter], range_m=3000.0), np.random.default_rng(2)
    looks, _ = FINDER.observe(there, rng)
    whole = replace(
        FINDER, frequency_min_hz=1e9, frequency_max_hz=4e9, instantaneous_bandwidth_hz=3e9
    )
    of_whole = whole.observe(there, rng)[0].snr
    assert looks.snr == pytest.approx(share * of_whole if share else [], rel=1e-12)
    assert (FINDER.predict(there).pd > 0) == (share > 0)


def test_hops_outside_what_is_heard_at_once_are_missed_and_any_emitter_makes_a_report() -> None:
    hopping = emitting([replace(CONTROL, bandwidth_hz=80e6)], range_m=100.0)
    narrow = replace(FINDER, instantaneous_bandwidth_hz=20e6)
    now_and_then = replace(FINDER, duty_cycle=0.4)
    several = emitting([CONTROL, REMOTE_ID], [CONTROL], [], [VIDEO], range_m=300.0)
    for sensor, seen, pd in (
        (narrow, hopping, [0.25]),
        (replace(narrow, bursts_per_dwell=2, duty_cycle=0.5), hopping, [1 - 0.875**2]),
        (narrow, emitting([CONTROL], range_m=100.0), [1.0]),
        (FINDER, hopping, [1.0]),
        (now_and_then, several, [1 - 0.6**2, 0.4, 0.0, 0.0]),
    ):
        assert sensor.predict(seen).pd == pytest.approx(pd, rel=1e-9)
    predicted = now_and_then.predict(several)
    table = EmitterTable.of(several.signatures.emitters)
    emissions = now_and_then.in_band(table.emissions(several.drone))
    snr = now_and_then.mean_snr(emissions, np.full(4, 300.0))
    assert predicted.snr[:2] == pytest.approx([snr[:2].max(), snr[2]])
    assert np.isnan(predicted.snr[2])
    assert np.isnan(predicted.sigma_azimuth_deg).tolist() == [False, False, True, True]


# The range gate.


PLACES = aer_to_enu(np.array([0.0, 123.0, 359.0]), np.array([-5.0, 0.0, 70.0]), 400.0)


def test_without_noise_the_truth_is_reported_and_with_it_the_mean_is_told() -> None:
    """Noise across the line of sight makes ranges longer, and elevations lower, on average."""
    gate = RangeGate(range_max_m=1e3, sigma_m=0.0)
    _, plots = gate.observe(targets_at(PLACES), np.random.default_rng(3))
    for name in ("range_m", "azimuth_deg", "elevation_deg"):
        np.testing.assert_allclose(getattr(plots, name), getattr(plots, f"true_{name}"))
    n, at_m = 20_000, aer_to_enu(180.0, 40.0, 100.0)
    gate = RangeGate(range_max_m=1000.0, sigma_m=20.0)
    _, plots = gate.observe(targets_at(np.broadcast_to(at_m, (n, 3))), np.random.default_rng(1))
    expected = gate.mean_place(*(np.array([x]) for x in enu_to_aer(at_m)))
    assert expected[2][0] == pytest.approx(104.0)
    measured = plots.azimuth_deg, plots.elevation_deg, plots.range_m
    for mean, values in zip(expected, measured, strict=True):
        third_order = 2 * (20.0 / 100.0) ** 3 * np.std(values)
        error = 4 * np.std(values) / np.sqrt(n)
        assert abs(values.mean() - mean[0]) < error + third_order


def test_what_a_range_gate_reads_wrongly_does_not_scale_its_noise() -> None:
    gate, right = RangeGate(range_max_m=1000.0, sigma_m=3.0), targets_at(PLACES)
    wrong = replace(right, readings=Readings(range_scale=0.1, range_offset_m=5.0))
    ranges_m = [
        gate.observe(targets, np.random.default_rng(3))[1].range_m for targets in (right, wrong)
    ]
    np.testing.assert_allclose(ranges_m[1] - ranges_m[0], 0.1 * 400.0 + 5.0)


@pytest.mark.parametrize("range_m", [0.0, 5e-324, 1e-309])
def test_so_near_that_there_is_no_direction_none_is_predicted(range_m: float) -> None:
    gate = RangeGate(range_max_m=1000.0, sigma_m=3.0)
    found = gate.predict(targets_at([range_m, 0.0, 0.0]))
    assert found.pd.tolist() == [0.0]
    assert found.sigma_range_m.tolist() == [3.0]
    assert np.isnan(found.sigma_azimuth_deg).all()
    np.testing.assert_array_equal(gate.predict(targets_at([1000.1, 0.0, 0.0])).pd, [0.0])
    assert not np.isnan(gate.mean_place(ONE, ONE, ONE)[2]).any()
