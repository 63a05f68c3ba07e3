"""Rain, gases, wind and jammers: values worked out elsewhere, and laws that they must obey."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.effects.jamming import Jammer, Jamming, jamming_over_noise
from plotfeed.models.effects.weather import (
    RainEcho,
    gases_db_per_km,
    rain_coefficients,
    rain_db_per_km,
    rain_reflectivity_m2_m3,
    wind_noise_db,
)
from plotfeed.models.propagation import BOLTZMANN_J_K, C_M_S, T0_K, radar_snr


@pytest.mark.parametrize(
    ("f_ghz", "k_h", "alpha_v", "two_way_db"),
    [
        (9.4, 0.00925396596390006, 1.25742121078036, 1.17721543459635),
        (16, 0.0528173680489059, 1.02729004495201, 3.74620943487922),
        (24.15, 0.144638204425097, 0.955047612574112, 7.4312043054002),
    ],
)
def test_rain_weakens_as_the_formula_of_p838_says(f_ghz, k_h, alpha_v, two_way_db):
    assert float(rain_coefficients(f_ghz * 1e9, "horizontal")[0]) == pytest.approx(k_h, rel=1e-12)
    assert float(rain_coefficients(f_ghz * 1e9, "vertical")[1]) == pytest.approx(alpha_v, rel=1e-12)
    assert float(2 * rain_db_per_km(f_ghz * 1e9, 25)) == pytest.approx(two_way_db, rel=1e-12)


def test_circular_waves_are_weakened_between_the_other_two_and_dry_air_weakens_nothing():
    f_hz = np.linspace(10e9, 90e9, 200)
    each = [rain_db_per_km(f_hz, 10, p) for p in ("horizontal", "vertical", "circular")]
    assert (each[2] <= np.maximum(each[0], each[1]) * 1.01).all()
    assert (each[2] >= np.minimum(each[0], each[1]) * 0.99).all()
    assert (rain_db_per_km(f_hz, 0.0) == 0).all()


def test_gases_weaken_by_what_the_recommendations_figures_say():
    """Over 20 km at 7.5 and 15 g/m3, by the full sum of lines: within a tenth."""
    f_hz = np.array([10e9, 16e9, 24e9])
    np.testing.assert_allclose(20 * gases_db_per_km(f_hz, 7.5), [0.28, 0.71, 3.5], rtol=0.1)
    np.testing.assert_allclose(20 * gases_db_per_km(f_hz, 15.0), [0.44, 1.3, 6.7], rtol=0.1)
    assert np.isnan(gases_db_per_km(60e9, 7.5))
    line = gases_db_per_km(np.linspace(18e9, 28e9, 401), 7.5)
    assert np.linspace(18, 28, 401)[line.argmax()] == pytest.approx(22.235, abs=0.6)


def test_rain_sends_back_what_was_worked_out_elsewhere():
    found = float(rain_reflectivity_m2_m3(C_M_S / 16e9, 25))
    assert 10 * np.log10(found) == pytest.approx(-40.9883655952417, abs=1e-6)
    beams = np.radians(2) * np.radians(6)
    echo = RainEcho.of(1.0, found, beams, 10.0, 0.0)
    at_3_km_m2 = echo.over_noise_at_1_m * 3000.0**2  # a target of 1 m2 falls off by R^2 more
    assert 10 * np.log10(at_3_km_m2) == pytest.approx(11.7, abs=0.05)


def test_wind_is_19_db_louder_when_it_is_twice_as_fast_and_silent_when_there_is_none():
    wind = np.array([2.0, 4.0, 8.0])
    level_db = wind_noise_db(wind, 200.0, 0.09)
    np.testing.assert_allclose(np.diff(level_db), 63 * np.log10(2))
    assert float(wind_noise_db(10.0, 100.0, 0.1)) == pytest.approx(40 + 15, abs=1e-9)
    assert float(wind_noise_db(0.0, 100.0, 0.1)) == -np.inf


def test_a_target_that_jams_for_itself_is_drowned_as_the_equation_of_self_screening_says():
    """J/S = 4 pi R^2 ERP/B / (P G sigma T), whatever the receiver."""
    range_m, eirp_w, width_hz, noise_figure_db = 3000.0, 0.5, 20e6, 5.0
    power_w, gain_db, rcs_m2, time_s = 500.0, 20.0, 0.01, 0.06
    noise = BOLTZMANN_J_K * T0_K * 10 ** (noise_figure_db / 10)
    over_noise = jamming_over_noise(
        eirp_w=eirp_w, jammer_hz=10e9, jammer_width_hz=width_hz, range_m=range_m, gain_dbi=35.0,
        frequency_hz=10e9, bandwidth_hz=15e6, noise_w_hz=noise,
    )  # fmt: skip
    snr = radar_snr(power_w, gain_db, 35.0, C_M_S / 10e9, rcs_m2, time_s, range_m, range_m, 0.0,
                    noise_figure_db)  # fmt: skip
    radiated = power_w * 10 ** (gain_db / 10) * rcs_m2 * time_s
    expected = 4 * np.pi * range_m**2 * (eirp_w / width_hz) / radiated
    assert float(over_noise / snr) == pytest.approx(float(expected), rel=1e-9)


@pytest.mark.parametrize(
    ("jammer_ghz", "width_mhz", "share"),
    [(10.0, 100.0, 1.0), (10.005, 10.0, 0.5), (10.1, 20.0, 0.0), (10.0, 2.0, 0.2)],
)
def test_a_receiver_hears_what_lies_in_its_band(jammer_ghz, width_mhz, share):
    heard = {"eirp_w": 1.0, "range_m": 1e3, "gain_dbi": 30.0, "noise_w_hz": 1e-20}
    width = {"jammer_width_hz": width_mhz * 1e6, "frequency_hz": 10e9}
    found = jamming_over_noise(**heard, **width, jammer_hz=jammer_ghz * 1e9, bandwidth_hz=10e6)
    whole = jamming_over_noise(**heard, **width, jammer_hz=10e9, bandwidth_hz=1.0)
    assert float(found) == pytest.approx(share * float(whole), rel=1e-9)


def test_beside_the_beam_a_jammer_is_heard_by_its_gain_and_then_by_side_lobes():
    jammer = Jammer(
        position_enu_m=(0.0, 1e3, 0.0), frequency_hz=1e10, azimuth_deg=359.5, elevation_deg=0.0,
        over_noise=(1000.0, 10.0), sidelobe_db=-20.0,
    )  # fmt: skip
    jamming = Jamming(jammers=(jammer, jammer), azimuth_beamwidth_deg=2.0,
                      elevation_beamwidth_deg=4.0)  # fmt: skip
    azimuth_deg = np.array([359.5, 0.5, 358.5, 100.0, 359.5])
    elevation_deg = np.array([0.0, 0.0, 0.0, 0.0, 2.0])
    found = jamming.over_noise(azimuth_deg, elevation_deg)
    np.testing.assert_allclose(found[:, 0], [2000, 1000, 1000, 20, 1000], rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], found[:, 0] / 100, rtol=1e-12)
