"""Propagation against reference values of 60 digits, and where its formulas end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_files import reference

from plotfeed.models import propagation
from plotfeed.models.propagation import C_M_S, GALACTIC, MAN_MADE, external_noise_db, two_ray_factor

metres = st.floats(-50e3, 50e3)
points = st.tuples(metres, metres, metres)


def triples(table, prefix):
    return np.stack([table[f"{prefix}_{axis}"] for axis in "enu"], axis=-1)


def test_radar_equation_agrees_with_the_reference():
    table = reference("radar_equation.csv")
    snr = propagation.radar_snr(
        table["p_av_w"],
        table["gt_dbi"],
        table["gr_dbi"],
        C_M_S / table["freq_hz"],
        table["rcs_m2"],
        table["t_int_s"],
        table["r_tx_m"],
        table["r_rx_m"],
        table["loss_db"],
        table["noise_fig_db"],
    )
    np.testing.assert_allclose(snr, table["snr"], rtol=1e-14)


def test_thermal_noise_is_minus_174_dbm_per_hertz():
    density = propagation.noise_density_w_hz(0.0)
    assert density == pytest.approx(1.380649e-23 * 290, rel=1e-15)
    assert 10 * np.log10(density) + 30 == pytest.approx(-173.975, abs=1e-3)


def test_beam_gain():
    assert propagation.beam_gain_dbi(2.0, 6.0) == pytest.approx(35.36, abs=5e-3)
    half = propagation.beam_gain_dbi([2.0, 3.0], 6.0, 0.5)
    np.testing.assert_allclose(half, propagation.beam_gain_dbi([4.0, 6.0], 6.0), rtol=1e-15)


def test_bistatic_range_agrees_with_the_reference():
    table = reference("bistatic.csv")
    found = propagation.bistatic_range(triples(table, "t"), triples(table, "tx"))
    np.testing.assert_allclose(found, table["bistatic_range"], rtol=1e-12, atol=0)


def test_range_from_bistatic_agrees_with_the_reference():
    table = reference("bistatic.csv")
    case = (table["bistatic_range"], table["rb"], table["beta_rx_deg"])
    found = propagation.range_from_bistatic(*case)[0]
    np.testing.assert_allclose(found, table["r_rx_from_range_and_beta"], rtol=1e-12)
    _, by_range, by_angle = propagation.range_from_bistatic(*case)
    np.testing.assert_allclose(by_range, table["drrx_dsum"], rtol=1e-12)
    # Straight behind the receiver the slope vanishes, and rounding of 180 degrees is all there is.
    np.testing.assert_allclose(by_angle, table["drrx_dbeta_m_per_rad"], rtol=1e-12, atol=1e-11)


@given(points, points)
def test_range_comes_back_from_bistatic_range_and_angle(target, transmitter):
    t, b = np.array(target), np.array(transmitter)
    distance, baseline = np.linalg.norm(t), np.linalg.norm(b)
    if min(distance, baseline) < 1:
        return
    apart = np.linalg.norm(t / distance - b / baseline)
    angle_deg = np.degrees(2 * np.arcsin(min(apart / 2, 1)))
    if angle_deg < 0.1:
        return
    excess = propagation.bistatic_range(t, b)
    found = propagation.range_from_bistatic(excess, baseline, angle_deg)[0]
    assert found == pytest.approx(distance, rel=1e-8)


def test_bistatic_special_places():
    transmitter = np.array([20e3, 0.0, 100.0])
    for target in (0 * transmitter, transmitter):
        assert propagation.bistatic_range(target, transmitter) == 0
    beyond = propagation.bistatic_range(1.5 * transmitter, transmitter)
    assert beyond == pytest.approx(np.linalg.norm(transmitter), rel=1e-15)
    behind = propagation.bistatic_range(-0.1 * transmitter, transmitter)
    assert behind == pytest.approx(0.2 * np.linalg.norm(transmitter), rel=1e-15)
    assert propagation.bistatic_range([3.0, 4.0, 0.0], [0.0, 0.0, 0.0]) == 10
    assert propagation.bistatic_range([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]) == 0
    assert np.isnan(propagation.bistatic_range([np.nan, 0.0, 0.0], transmitter))


def test_tenth_of_a_millimetre_off_the_baseline_is_resolved():
    found = propagation.bistatic_range([10e3, 1e-4, 0.0], [20e3, 0.0, 0.0])
    assert found == pytest.approx(1e-8 / 10e3, rel=1e-12)


def test_range_from_bistatic_where_it_ends():
    assert np.isnan(propagation.range_from_bistatic(0.0, 20e3, 0.0)[0])
    assert propagation.range_from_bistatic(0.0, 20e3, 30.0)[0] == 0
    assert propagation.range_from_bistatic(10.0, 0.0, 77.0)[0] == pytest.approx(5)


def test_passive_radar_agrees_with_the_reference():
    """The table leaves out 600 MHz and 0.01 m2."""
    table = reference("passive_snr.csv")
    wavelength_m = C_M_S / 600e6
    target_w = propagation.echo_power_w(
        power_w=table["erp_w"],
        gains_db=propagation.DIPOLE_GAIN_DBI + table["gr_dbi"] - table["loss_db"],
        wavelength_m=wavelength_m,
        rcs_m2=0.01,
        range_tx_m=table["r_tx_m"],
        range_rx_m=table["r_rx_m"],
    )
    np.testing.assert_allclose(target_w, table["p_target_w"], rtol=1e-13)
    direct_w = propagation.direct_signal_power_w(
        erp_w=table["erp_w"],
        gain_rx_dbi=table["gr_dbi"],
        wavelength_m=wavelength_m,
        sidelobe_db=table["sidelobe_db"],
        cancellation_db=table["cancel_db"],
        baseline_m=table["baseline_m"],
    )
    np.testing.assert_allclose(direct_w, table["p_direct_w"], rtol=1e-13)
    noise_w = propagation.passive_noise_power_w(table["bandwidth_hz"], table["fa_db"])
    np.testing.assert_allclose(noise_w, table["p_noise_w"], rtol=1e-13)
    time_bandwidth = table["t_int_s"] * table["bandwidth_hz"]
    snr = propagation.correlated_snr(target_w, direct_w + noise_w, time_bandwidth)
    np.testing.assert_allclose(snr, table["snr"], rtol=1e-13)


def test_correlator_gain_is_capped_by_time_and_bandwidth():
    snr = propagation.correlated_snr([0.0, 1e-20, np.inf], 1e-14, 1e6)
    np.testing.assert_allclose(snr, [0.0, 1.0, 1e6], rtol=1e-5)


def test_sound_absorption_agrees_with_the_reference():
    table = reference("iso9613_1_alpha.csv")
    alpha = propagation.sound_absorption_db_per_m(
        table["freq_hz"], table["temp_c"], table["rh_pct"], table["pressure_kpa"]
    )
    np.testing.assert_allclose(alpha, table["alpha_db_per_m"], rtol=1e-13)


def test_sound_level_agrees_with_the_reference():
    table = reference("iso9613_2_level.csv")
    slant, source, receiver = table["slant_m"], table["h_source_m"], table["h_receiver_m"]
    divergence = propagation.sound_divergence_db(slant)
    np.testing.assert_allclose(divergence, table["a_div_db"], rtol=1e-13)
    absorption = propagation.sound_absorption_db_per_m(1e3, 15, 70, 101.325) * slant
    np.testing.assert_allclose(absorption, table["a_atm_db_15C_70pct_1kHz"], rtol=1e-12)
    ground = propagation.ground_attenuation_db((source + receiver) / 2, slant)
    np.testing.assert_allclose(ground, table["a_gr_db"], rtol=1e-12)
    level = propagation.sound_level_db(
        table["lw_db"], table["dc_db"], divergence + absorption + ground + 6
    )
    np.testing.assert_allclose(level, table["level_db_with_abar3_amisc3"], rtol=1e-12)


@given(st.floats(0, 200), st.floats(0.01, 1e5))
def test_ground_attenuation_lies_between_nothing_and_its_limit(height, distance):
    assert 0 <= propagation.ground_attenuation_db(height, distance) <= 4.8


def test_sound_at_no_distance():
    assert propagation.ground_attenuation_db(10.0, 0.0) == 0
    assert propagation.sound_divergence_db(0.0) == -np.inf


# Two rays over flat ground: against the sum of two waves, at its limits, and in every radio.


heights = st.floats(0.1, 500.0)
ranges = st.floats(10.0, 20_000.0)
wavelengths = st.floats(0.01, 3.0)
reflections = st.floats(-1.0, 1.0)


@given(heights, heights, ranges, wavelengths, reflections)
def test_the_factor_is_that_of_two_waves_that_meet(h1, h2, ground, wavelength, rho):
    detour = np.hypot(ground, h1 + h2) - np.hypot(ground, h1 - h2)
    waves = 1 + rho * np.exp(2j * np.pi * detour / wavelength)
    factor = two_ray_factor(h1, h2, ground, wavelength, rho)
    rounding = 2 * np.pi / wavelength * np.hypot(ground, h1 + h2) * 1e-15
    assert factor == pytest.approx(abs(waves) ** 2, rel=1e-9, abs=1e-13 + 10 * rounding)


def test_far_away_power_falls_with_the_fourth_power_of_distance_beyond_free_space():
    """Grazing a perfect mirror, F is the phase itself: F^2 goes as one over the square."""
    h1, h2, wavelength = 2.0, 3.0, 0.5
    ground = np.array([1e5, 1e6, 1e7, 1e8])
    closed = (4 * np.pi * h1 * h2 / (wavelength * ground)) ** 2
    np.testing.assert_allclose(two_ray_factor(h1, h2, ground, wavelength, -1.0), closed, rtol=1e-5)
    np.testing.assert_allclose(
        two_ray_factor(h1, h2, ground[2:], wavelength, -1.0), closed[2:], rtol=1e-9
    )


def test_on_the_ground_and_at_no_distance_there_is_a_number():
    assert two_ray_factor(0.0, 50.0, 100.0, 0.03, -0.9) == pytest.approx(0.01, rel=1e-12)
    assert two_ray_factor(-3.0, 50.0, 100.0, 0.03, -0.9) == pytest.approx(0.01, rel=1e-12)
    assert np.isfinite(two_ray_factor(0.0, 0.0, 0.0, 0.03, -0.9))
    assert np.isfinite(two_ray_factor(2.0, 2.0, 0.0, 0.03, -0.9))


# External noise: lines of ITU-R P.372, where they hold, and their sum.


ENVIRONMENTS = pytest.mark.parametrize("environment", MAN_MADE)


@pytest.mark.parametrize(
    ("environment", "at_1_mhz", "at_10_mhz"),
    [
        ("city", 76.8, 49.1),
        ("residential", 72.5, 44.8),
        ("rural", 67.2, 39.5),
        ("quiet-rural", 53.6, 25.0),
    ],
)
def test_man_made_noise_is_c_at_1_mhz_and_loses_d_a_decade(environment, at_1_mhz, at_10_mhz):
    line = MAN_MADE[environment]
    assert line.median_db([1e6, 10e6]) == pytest.approx([at_1_mhz, at_10_mhz], abs=1e-12)
    assert external_noise_db(environment, 1e6) == pytest.approx(at_1_mhz)  # nothing else there


def test_residential_noise_continued_to_600_mhz_is_what_section_4_gives():
    line = MAN_MADE["residential"]
    assert line.c_db - line.d_db * np.log10(600) == pytest.approx(-4.45, abs=0.005)
    assert np.isnan(external_noise_db("residential", 600e6))


def test_powers_of_man_made_and_galactic_noise_add():
    assert GALACTIC.median_db(100e6) == pytest.approx(6.0)
    # rural at 100 MHz is 11.8 dB; 15.14 + 3.98 is 19.12
    assert external_noise_db("rural", 100e6) == pytest.approx(12.814, abs=1e-3)
    assert external_noise_db("rural", 101e6) == pytest.approx(11.68, abs=0.01)


@ENVIRONMENTS
def test_there_is_no_noise_outside_the_range_of_the_line(environment):
    line = MAN_MADE[environment]
    edges_hz = 1e6 * np.array([line.min_mhz, line.max_mhz])
    assert np.isfinite(external_noise_db(environment, edges_hz)).all()
    outside = np.array([0.0, -1.0, 0.99 * edges_hz[0], 1.01 * edges_hz[1], 1e12, np.inf, np.nan])
    assert np.isnan(external_noise_db(environment, outside)).all()


@given(st.floats(0.3e6, 250e6))
def test_the_busier_the_place_the_louder(frequency_hz):
    city, residential, rural = (
        external_noise_db(place, frequency_hz) for place in ("city", "residential", "rural")
    )
    assert city > residential > rural
    quiet = external_noise_db("quiet-rural", frequency_hz)
    assert np.isnan(quiet) if frequency_hz > 100e6 else quiet < rural
