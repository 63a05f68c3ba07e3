"""The microphone array: levels, section 4 of the paper, bearings of the sound, false alarms."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from support.microphones import SECTION_4, sounding
from support.significance import assert_standard_normal

from plotfeed.models import propagation
from plotfeed.models.beam import AzimuthCover, Timetable
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Floats

SCAN = Timetable(1_000_000_000, 1).sector(7, 0)
targets = partial(sounding, SCAN.end_ns)


def array(**changes: Any) -> MicrophoneArray:
    return replace(SECTION_4, **changes)


def phantom(range_m: Any) -> Targets:
    """The drone of section 4, 50 m above the ground, at those slant ranges."""
    slant_m = np.atleast_1d(np.asarray(range_m, dtype=np.float64))
    up_m = np.full(len(slant_m), 50.0 - SECTION_4.height_above_ground_m)
    ground_m = np.sqrt(slant_m**2 - up_m**2)
    return targets(np.stack([0.6 * ground_m, 0.8 * ground_m, up_m], axis=-1))


def test_section_4_by_slant_range() -> None:
    pd = SECTION_4.predict(phantom([200.0, 150.0, 100.0, 75.0])).pd
    assert pd == pytest.approx([0.018, 0.224, 0.926, 0.994], abs=5e-4)


def test_section_4_hears_half_at_131_metres() -> None:
    half_m = brentq(lambda r: float(SECTION_4.predict(phantom(r)).pd[0]) - 0.5, 60, 500)
    assert half_m == pytest.approx(131, abs=10)
    assert half_m == pytest.approx(131.4, abs=0.1)


def test_level_is_the_sum_of_its_terms_by_hand() -> None:
    """ISO 9613-2: 80 + 3 - (20 log10 100 + 11) - 0.5 - 0 - 3 - 3, far above the ground."""
    high = targets([0.0, 60.0, 80.0])
    level_db = SECTION_4.level_db(np.array([80.0]), high.position_enu_m)
    assert level_db == pytest.approx([80 + 3 - 51 - 0.5 - 6])
    assert SECTION_4.observe(high, np.random.default_rng(1))[0].snr == pytest.approx(
        [10 ** ((25.5 + 9.03) / 10)]
    )


def test_the_ground_attenuates_what_comes_along_it() -> None:
    """2 h/r (17 + 300/r) short of 4.8 dB, h the mean of the two heights above the ground."""
    low = np.array([[0.0, 400.0, 2.5]])
    range_m = float(enu_to_aer(low)[2][0])
    mean_height_m = ((1.5 + 2.5) + 1.5) / 2
    expected_db = 4.8 - 2 * mean_height_m / range_m * (17 + 300 / range_m)
    over_high_ground = array(height_above_ground_m=1000.0)
    difference_db = over_high_ground.level_db(np.array([80.0]), low) - SECTION_4.level_db(
        np.array([80.0]), low
    )
    assert difference_db == pytest.approx([expected_db])
    assert expected_db > 4


def test_a_source_below_the_ground_is_taken_to_be_on_it() -> None:
    deep, on_it = (targets([0.0, 100.0, up]) for up in (-30.0, -1.5))
    attenuation_db = propagation.ground_attenuation_db(0.75, enu_to_aer(deep.position_enu_m)[2])
    assert SECTION_4.predict(deep).snr < SECTION_4.predict(on_it).snr
    assert attenuation_db > 0
    assert np.isfinite(SECTION_4.predict(deep).snr).all()


def test_a_drone_of_unknown_sound_is_not_heard() -> None:
    both = targets([[0.0, 50.0, 10.0], [0.0, 60.0, 10.0]], [np.nan, 130.0])
    looks, plots = SECTION_4.observe(both, np.random.default_rng(2))
    assert looks.drone.tolist() == plots.drone.tolist() == [1]
    predicted = SECTION_4.predict(both)
    assert predicted.pd[0] == 0
    assert np.isnan(predicted.snr[0])
    assert predicted.pd[1] == pytest.approx(1)


def test_cover_ends_at_the_range_at_the_azimuths_and_at_the_zenith() -> None:
    model = array(azimuth_cover=AzimuthCover(-30.0, 60.0))
    azimuths = np.array([0.0, 0.0, 59.0, 61.0, 331.0, 329.0])
    ranges = np.array([999.9, 1000.1, 10.0, 10.0, 10.0, 10.0])
    positions = aer_to_enu(azimuths, 5.0, ranges)
    positions = np.concatenate([positions, [[0.0, 0.0, 50.0], [0.0, 0.0, 0.0]]])
    looks, _ = model.observe(targets(positions), np.random.default_rng(3))
    assert looks.drone.tolist() == [0, 2, 4]


def test_bearings_are_of_the_sound_and_true_columns_of_the_drone() -> None:
    heard = np.tile([[300.0, 400.0, 30.0]], (1000, 1))
    now = heard + np.array([29.1, 0.0, 0.0])
    looks, plots = SECTION_4.observe(targets(heard, 140.0, now), np.random.default_rng(4))
    np.testing.assert_allclose(looks.azimuth_deg, enu_to_aer(heard)[0])
    np.testing.assert_allclose(plots.true_azimuth_deg, enu_to_aer(now)[0])
    np.testing.assert_allclose(plots.true_range_m, enu_to_aer(now)[2])
    error_deg = wrap_180(plots.azimuth_deg - enu_to_aer(heard)[0])
    assert_standard_normal(error_deg / plots.sigma_azimuth_deg, "seed 4")
    assert abs(error_deg).max() < 0.1


def test_speed_of_sound() -> None:
    """343.2 m/s at 20 degrees Celsius (ISO 9613-1); 331.3 at freezing point."""
    assert propagation.speed_of_sound_m_s(20.0) == pytest.approx(343.2)
    assert propagation.speed_of_sound_m_s(0.0) == pytest.approx(331.3, abs=0.05)


decibels = st.floats(-300, 300)
losses = st.floats(0, 300)
arrays = st.builds(
    array,
    directivity_db=decibels,
    absorption_db_per_m=st.floats(0, 0.3),
    barrier_db=losses,
    misc_db=losses,
    array_gain_db=decibels,
    noise_db=decibels,
    sensitivity_db=decibels,
    slope_per_db=st.floats(0.01, 100),
    pfa=st.floats(1e-15, 0.1),
    range_max_m=st.floats(1e-3, 1e4),
    height_above_ground_m=st.floats(0, 1000),
    azimuth_beamwidth_deg=st.floats(0.01, 360),
    elevation_beamwidth_deg=st.none() | st.floats(0.01, 360),
    azimuth_floor_deg=st.floats(0, 1e3),
    elevation_floor_deg=st.floats(0, 1e3),
)


def places(count: int) -> st.SearchStrategy[Floats]:
    coordinate = st.floats(-2e4, 2e4)
    return st.lists(
        st.tuples(coordinate, coordinate, coordinate), min_size=count, max_size=count
    ).map(np.array)


@given(arrays, places(4), decibels, st.integers(0, 2**32))
def test_whatever_the_parameters_nothing_is_undefined(
    model: MicrophoneArray, place: Floats, sound_power_db: float, seed: int
) -> None:
    looks, plots = model.observe(targets(place, sound_power_db), np.random.default_rng(seed))
    assert ((looks.pd >= 0) & (looks.pd <= 1)).all()
    assert np.isfinite(looks.snr).all()
    assert ((plots.azimuth_deg >= 0) & (plots.azimuth_deg < 360)).all()
    assert np.isfinite(plots.sigma_azimuth_deg).all()
    if model.elevation_beamwidth_deg is not None:
        assert (np.abs(plots.elevation_deg) <= 90).all()
    alarms = model.draw_false_alarms(SCAN, np.random.default_rng(seed))
    assert np.isfinite(alarms.azimuth_deg).all()
    assert np.isfinite(alarms.snr).all()


@given(arrays, places(1), decibels, decibels)
def test_a_louder_drone_is_never_heard_less(
    model: MicrophoneArray, place: Floats, a: float, b: float
) -> None:
    quiet, loud = (model.predict(targets(place, level)) for level in sorted((a, b)))
    if np.linalg.norm(place) > 0:
        assert quiet.snr <= loud.snr
        assert 0 <= quiet.pd <= loud.pd <= 1
