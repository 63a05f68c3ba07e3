"""Rain, gases, wind and jammers: values worked out elsewhere, and laws that they must obey."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.effects.jamming import jamming_over_noise
from plotfeed.models.effects.weather import (
    gases_db_per_km,
    rain_coefficients,
    rain_db_per_km,
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
