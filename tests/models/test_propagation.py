"""Propagation, errors and optics against references and closed forms; what moves beside drones."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import brentq
from support.given_files import reference
from support.significance import Array, assert_law, assert_standard_normal, assert_sum

from plotfeed.models import accuracy, optics, propagation
from plotfeed.models.clutter import Spikes, inside, k_exceedance
from plotfeed.models.effects.surroundings import Pillar
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.movers import Wander, rotor_knots, wander_variance_m2
from plotfeed.models.numerics import nan_without_warnings, root
from plotfeed.models.propagation import C_M_S, GALACTIC, MAN_MADE, external_noise_db, two_ray_factor
from plotfeed.models.smoothing import smooth

metres = st.floats(-50e3, 50e3)
points = st.tuples(metres, metres, metres)


def triples(table, prefix):
    return np.stack([table[f"{prefix}_{axis}"] for axis in "enu"], axis=-1)


def radar_snr(t):
    echo = t["p_av_w"], t["gt_dbi"], t["gr_dbi"], C_M_S / t["freq_hz"], t["rcs_m2"], t["t_int_s"]
    ways = t["r_tx_m"], t["r_rx_m"], t["loss_db"], t["noise_fig_db"]
    return propagation.radar_snr(*echo, *ways)


def from_bistatic(t, told):
    of = (t["bistatic_range"], t["rb"], t["beta_rx_deg"])
    return propagation.range_from_bistatic(*of)[told]


def passive_snr(t):
    """The table leaves out 600 MHz and 0.01 m2."""
    dipole = t["erp_w"], propagation.DIPOLE_GAIN_DBI, t["gr_dbi"], C_M_S / 600e6, 0.01, 1.0
    over_noise = propagation.radar_snr(*dipole, t["r_tx_m"], t["r_rx_m"], t["loss_db"], 0.0)
    direct_w = propagation.direct_signal_power_w(
        erp_w=t["erp_w"], gain_rx_dbi=t["gr_dbi"], wavelength_m=C_M_S / 600e6,
        sidelobe_db=t["sidelobe_db"], cancellation_db=t["cancel_db"], baseline_m=t["baseline_m"],
    )  # fmt: skip
    noise_w = propagation.passive_noise_power_w(t["bandwidth_hz"], t["fa_db"])
    return propagation.correlated_snr(
        over_noise * propagation.noise_density_w_hz(0.0),
        direct_w + noise_w,
        t["t_int_s"] * t["bandwidth_hz"],
    )


def sound_level_db(t):
    absorbed_db = propagation.sound_absorption_db_per_m(1e3, 15, 70, 101.325) * t["slant_m"]
    middle_m = (t["h_source_m"] + t["h_receiver_m"]) / 2
    lost_db = absorbed_db + propagation.ground_attenuation_db(middle_m, t["slant_m"]) + 6
    lost_db = lost_db + propagation.sound_divergence_db(t["slant_m"])
    return propagation.sound_level_db(t["lw_db"], t["dc_db"], lost_db)


# Table, column, relative error, and what it should be from the other columns.
REFERENCE = [
    ("radar_equation", "snr", 1e-14, radar_snr),
    ("bistatic", "bistatic_range", 1e-12,
     lambda t: propagation.bistatic_range(triples(t, "t"), triples(t, "tx"))),
    ("bistatic", "r_rx_from_range_and_beta", 1e-12, lambda t: from_bistatic(t, 0)),
    ("bistatic", "drrx_dsum", 1e-12, lambda t: from_bistatic(t, 1)),
    ("bistatic", "drrx_dbeta_m_per_rad", 1e-12, lambda t: from_bistatic(t, 2)),
    ("passive_snr", "snr", 1e-13, passive_snr),
    ("iso9613_1_alpha", "alpha_db_per_m", 1e-13, lambda t: propagation.sound_absorption_db_per_m(
        t["freq_hz"], t["temp_c"], t["rh_pct"], t["pressure_kpa"])),
    ("iso9613_2_level", "level_db_with_abar3_amisc3", 1e-12, sound_level_db),
]  # fmt: skip


@pytest.mark.parametrize(("name", "column", "digits", "equation"), REFERENCE)
def test_equations_agree_with_the_reference(name, column, digits, equation):
    table = reference(f"{name}.csv")
    # Straight behind the receiver this slope vanishes, and rounding of 180 degrees is all there is.
    atol = 1e-11 if column == "drrx_dbeta_m_per_rad" else 0
    np.testing.assert_allclose(equation(table), table[column], rtol=digits, atol=atol)


def test_beam_gain():
    assert propagation.beam_gain_dbi(2.0, 6.0) == pytest.approx(35.36, abs=5e-3)
    half = propagation.beam_gain_dbi([2.0, 3.0], 6.0, 0.5)
    np.testing.assert_allclose(half, propagation.beam_gain_dbi([4.0, 6.0], 6.0), rtol=1e-15)


@given(points, points)
def test_range_comes_back_from_bistatic_range_and_angle(target, transmitter):
    t, b = np.array(target), np.array(transmitter)
    distance, baseline = np.linalg.norm(t), np.linalg.norm(b)
    assume(min(distance, baseline) >= 1)
    apart = np.linalg.norm(t / distance - b / baseline)
    angle_deg = np.degrees(2 * np.arcsin(min(apart / 2, 1)))
    assume(angle_deg >= 0.1)
    excess = propagation.bistatic_range(t, b)
    found = propagation.range_from_bistatic(excess, baseline, angle_deg)[0]
    assert found == pytest.approx(distance, rel=1e-8)


def test_a_place_next_to_the_baseline_comes_back() -> None:
    baseline_m, along_m, off_m = 20_000.0, 7000.0, 1e-5
    detour_m = off_m**2 / 2 * (1 / along_m + 1 / (baseline_m - along_m))
    angle_rad = math.atan2(off_m, along_m)
    depth_m = baseline_m * (1 - math.cos(angle_rad))
    plain_m = detour_m * (detour_m + 2 * baseline_m) / (2 * (detour_m + depth_m))
    assert abs(plain_m - along_m) > 1000
    found_m = propagation.range_from_bistatic(detour_m, baseline_m, math.degrees(angle_rad))[0]
    assert found_m == pytest.approx(along_m, rel=1e-12)


def test_bistatic_special_places():
    transmitter = np.array([20e3, 0.0, 100.0])
    away = np.linalg.norm(transmitter)
    for share, excess_m in ((0.0, 0.0), (1.0, 0.0), (1.5, away), (-0.1, 0.2 * away)):
        found = propagation.bistatic_range(share * transmitter, transmitter)
        assert found == pytest.approx(excess_m, rel=1e-15)
    for target, excess_m in (([3.0, 4.0, 0.0], 10), ([0.0, 0.0, 0.0], 0)):
        assert propagation.bistatic_range(target, [0.0, 0.0, 0.0]) == excess_m
    assert np.isnan(propagation.bistatic_range([np.nan, 0.0, 0.0], transmitter))


def test_range_from_bistatic_where_it_ends():
    assert np.isnan(propagation.range_from_bistatic(0.0, 20e3, 0.0)[0])
    assert propagation.range_from_bistatic(0.0, 20e3, 30.0)[0] == 0
    assert propagation.range_from_bistatic(10.0, 0.0, 77.0)[0] == pytest.approx(5)


def test_correlator_gain_is_capped_by_time_and_bandwidth():
    snr = propagation.correlated_snr([0.0, 1e-20, np.inf], 1e-14, 1e6)
    np.testing.assert_allclose(snr, [0.0, 1.0, 1e6], rtol=1e-5)


def test_sound_at_no_distance():
    assert propagation.ground_attenuation_db(10.0, 0.0) == 0
    assert propagation.sound_divergence_db(0.0) == -np.inf


# Two rays over flat ground at their limits: sums of two waves are proved by the oracle.


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


def test_powers_of_man_made_and_galactic_noise_add_where_their_lines_hold():
    """Man-made noise is c at 1 MHz and loses d a decade."""
    c_and_d = {"city": (76.8, 27.7), "residential": (72.5, 27.7), "rural": (67.2, 27.7),
               "quiet-rural": (53.6, 28.6)}  # fmt: skip
    assert GALACTIC.median_db(100e6) == pytest.approx(6.0)
    # rural at 100 MHz is 11.8 dB; 15.14 + 3.98 is 19.12
    found_db = external_noise_db("rural", [1e6, 100e6, 101e6])
    assert found_db == pytest.approx([67.2, 12.814, 11.68], abs=0.01)
    for environment, line in MAN_MADE.items():
        c, d = c_and_d[environment]
        assert line.median_db([1e6, 10e6]) == pytest.approx([c, c - d], abs=1e-12)
        edges_hz = 1e6 * np.array([line.min_mhz, line.max_mhz])
        assert np.isfinite(external_noise_db(environment, edges_hz)).all()
        outside = np.array([0.0, -1.0, 0.99 * edges_hz[0], 1.01 * edges_hz[1], np.inf, np.nan])
        assert np.isnan(external_noise_db(environment, outside)).all()


# Measurement errors: scale, limits, statistics, and the fold over the zenith.


@pytest.mark.parametrize("sigma", [accuracy.sigma_range_m, accuracy.sigma_angle_deg])
def test_limits_of_the_signal(sigma):
    np.testing.assert_array_equal(
        sigma([0.0, np.inf, -1.0, np.nan], 3.0), [np.inf, 0, np.nan, np.nan]
    )


def test_floor_stands_where_the_signal_is_infinite():
    assert accuracy.with_floor(accuracy.sigma_range_m(np.inf, 10.0), 1.5) == 1.5
    np.testing.assert_array_equal(
        accuracy.with_floor([3.0, np.inf, 0.0], [4.0, 1.0, 0.0]), [5, np.inf, 0]
    )


@given(st.floats(-720, 720), st.floats(-269, 269))
def test_folding_keeps_the_direction(azimuth, elevation):
    folded_azimuth, folded_elevation = accuracy.fold_over_zenith(azimuth, elevation)
    assert 0 <= folded_azimuth < 360
    assert -90 <= folded_elevation <= 90
    np.testing.assert_allclose(
        aer_to_enu(folded_azimuth, folded_elevation, 1.0),
        aer_to_enu(azimuth, elevation, 1.0),
        rtol=0,
        atol=1e-13,
    )


# Constants of the errors, against signals: apertures and channels with noise, measured at best.


SAMPLES = 64
SNR = 1000.0  # Of all samples of an aperture together: 30 dB
CELL_TO_3_DB = 0.886  # Width at 3 dB of what a uniform aperture resolves, over one over its length


def noise(rng: np.random.Generator, *shape: int) -> Array:
    """Complex and Gaussian, of power 1."""
    return np.asarray(rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2))


def errors_over_an_aperture(trials: int, rng: np.random.Generator) -> Array:
    """Of the most likely slope of a phase along it, in turns over its length.

    A tone in time, a wave along an antenna and an echo across a band are all this.
    """
    k, true = np.arange(SAMPLES), rng.uniform(-0.5, 0.5, trials)
    signal = np.exp(2j * np.pi * true[:, None] * k / SAMPLES)
    signal = np.sqrt(SNR / SAMPLES) * signal + noise(rng, trials, SAMPLES)
    tried = np.linspace(-1, 1, 401)
    power = np.abs(signal @ np.exp(-2j * np.pi * np.outer(k, tried) / SAMPLES)) ** 2
    row, top = np.arange(trials), power.argmax(axis=1)
    low, mid, high = power[row, top - 1], power[row, top], power[row, top + 1]
    finer = (low - high) / (2 * (low - 2 * mid + high))
    return np.asarray(tried[top] + finer * (tried[1] - tried[0]) - true)


@pytest.mark.parametrize(
    ("sigma", "width"),
    [
        (accuracy.sigma_rate_m_s, 1.0),
        (accuracy.sigma_angle_deg, CELL_TO_3_DB),
        (accuracy.sigma_range_m, CELL_TO_3_DB),
    ],
)
def test_errors_are_those_of_the_best_estimate_of_signals(
    sigma: Callable[[float, float], Array], width: float
) -> None:
    """Rates by whole Doppler cells, angles and ranges by their width at 3 dB; seed 91."""
    errors = errors_over_an_aperture(2000, np.random.default_rng(91))
    assert_standard_normal(errors / sigma(SNR, width), "seed 91")


@pytest.mark.parametrize(("snr", "samples"), [(100.0, 16), (1.0, 1000), (0.2, 5000)])
def test_phases_between_two_channels_err_by_the_noise_of_both(snr: float, samples: int) -> None:
    """A signal as noise, the same in both; strong, as strong as noise, and weaker; seed 92."""
    rng, errors = np.random.default_rng(92), []
    for _ in range(20):
        common = np.sqrt(snr) * noise(rng, 50, samples)
        one, other = (common + noise(rng, 50, samples) for _ in range(2))
        errors.append(np.angle((one * other.conj()).sum(axis=1)))
    sigma = 1 / np.sqrt(accuracy.paired_snr(snr) * samples)
    assert_standard_normal(np.concatenate(errors) / sigma, "seed 92")


def test_a_pair_of_channels_keeps_strong_signals_and_squares_weak_ones() -> None:
    found = accuracy.paired_snr([1e9, 1e-9, 0.0, np.inf, -1.0, np.nan])
    np.testing.assert_allclose(found, [1e9, 2e-18, 0, np.inf, np.nan, np.nan], rtol=1e-8)
    snr = 10.0 ** np.arange(-12, 13)
    np.testing.assert_allclose(accuracy.snr_of_pair(accuracy.paired_snr(snr)), snr, rtol=1e-14)


# What cameras resolve, against closed forms and values of other programmes.


@pytest.mark.parametrize(
    ("x", "expected"), [(0.5, 0.107734), (1.0, 0.5), (1.5, 0.820611235962048), (2.0, 0.944899)]
)
def test_a_task_is_done_as_the_transfer_function_has_it(x: float, expected: float) -> None:
    assert optics.task_probability(6.4 * x, 6.4) == pytest.approx(expected, rel=1e-4)
    plain = x ** (2.7 + 0.7 * x)
    assert optics.task_probability(x, 1.0) == pytest.approx(plain / (1 + plain), rel=1e-13)


def test_a_task_with_very_many_cycles_or_none_has_a_probability() -> None:
    found = optics.task_probability([0.0, 1e-300, 190.0, 1e6, np.inf], 1.0)
    np.testing.assert_array_equal(found, [0.0, 0.0, 1.0, 1.0, 1.0])


def test_a_spot_is_found_with_a_pfa_below_the_rounding_of_one() -> None:
    """Without one less the Pfa, which is 1 in float64."""
    assert optics.hot_spot_pd(0.0, 1e-17) == pytest.approx(1e-17, rel=1e-9)
    threshold = float(stats.norm.isf(1e-17))
    assert optics.hot_spot_pd(threshold, 1e-17) == pytest.approx(0.5, rel=1e-12)


def test_the_picture_is_a_rectangle_about_the_line_of_sight() -> None:
    rng = np.random.default_rng(1)
    for pan_deg, tilt_deg in ((0.0, 0.0), (200.0, 50.0), (-30.0, -20.0)):
        right, above = rng.uniform(-0.3, 0.3, 500), rng.uniform(-0.2, 0.2, 500)
        sight = optics.directions_enu(right, above, pan_deg, tilt_deg) * 700.0
        found = optics.picture_axes(sight, pan_deg, tilt_deg)
        np.testing.assert_allclose(found, [700 * right, 700 * above, np.full(500, 700.0)])
        fields_deg = 2 * np.degrees(np.arctan([0.1, 0.05]))
        inside = optics.in_picture(sight, pan_deg, tilt_deg, *fields_deg)
        np.testing.assert_array_equal(inside, (np.abs(right) <= 0.1) & (np.abs(above) <= 0.05))
        assert not optics.in_picture(-sight, pan_deg, tilt_deg, 90.0, 90.0).any()


# What moves beside drones: wandering flocks, traffic, rotors, and the strips of towers.


@pytest.mark.parametrize(
    ("t_s", "expected_m2"), [(1e-6, 8.99999970000001e-12), (20.0, 2043.6035098259)]
)
def test_the_variance_of_a_way_is_right_to_the_last_digits_however_short(t_s, expected_m2):
    assert float(wander_variance_m2(3.0, 10.0, t_s)) == pytest.approx(expected_m2, rel=1e-13)


def test_ways_and_velocities_are_drawn_together_whatever_the_step():
    """By one step of 3 s, and by thirty of 0.1 s: the joint law is that of the process."""
    tau_s, sigma = 4.0, 2.0
    u = 3.0 / tau_s
    variances = {
        "way": float(wander_variance_m2(sigma, tau_s, 3.0)), "velocity": sigma**2,
        "both": sigma**2 * tau_s * -np.expm1(-u),
    }  # fmt: skip
    for seed, steps in enumerate((1, 30)):
        wander = Wander(sigma_m_s=sigma, time_constant_s=tau_s)
        way, velocity = wander.walk(3.0 / steps, steps, (20_000,), np.random.default_rng(seed))
        x, v = way[-1], velocity[-1]
        assert (way[0] == 0).all()
        assert_standard_normal(x / np.sqrt(variances["way"]), "way")
        assert_standard_normal(v / sigma, "velocity")
        spread = np.sqrt(variances["way"] * sigma**2 + variances["both"] ** 2)
        total = float((x * v).sum())
        assert_sum(total, 20_000 * variances["both"], 20_000 * spread**2, "both")


def test_a_tip_goes_round_at_its_speed_across_its_axis():
    at_s, place, velocity = rotor_knots(30.0, 50.0, 80.0, 0.3, 48)
    axis = np.array([np.sin(np.radians(30)), np.cos(np.radians(30)), 0.0])
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), 50.0)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 80.0)
    np.testing.assert_allclose(place @ axis, 0.0, atol=1e-12)
    np.testing.assert_allclose((place * velocity).sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(place[0], place[-1], atol=1e-12)
    step = np.gradient(place, at_s, axis=0)[1:-1]
    np.testing.assert_allclose(step, velocity[1:-1], rtol=0.01, atol=0.3)


def test_a_tower_casts_the_shadow_of_a_transmitter_too_and_none_before_itself() -> None:
    tower, behind = Pillar((0.0, 3000.0, 100.0), 4.0), np.array([[0.0, 4000.0, 5.0]])
    assert tower.power_factor(np.array([[0.0, 2900.0, 5.0]]), 0.03) == 1.0
    from_there = tower.power_factor(np.zeros((1, 3)), 0.03, behind[0])
    np.testing.assert_allclose(from_there, tower.power_factor(behind, 0.03), rtol=1e-9)


def test_inside_a_polygon_with_a_notch():
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    east, north = np.array([1.0, 2.0, 3.5, 5.0, 2.0]), np.array([1.0, 3.0, 3.0, 1.0, 0.5])
    np.testing.assert_array_equal(inside(east, north, corners), [True, False, True, False, True])


# Clutter whose power is K-distributed: how often it crosses a threshold, and by how much.


@pytest.mark.parametrize(
    ("threshold", "order"), [(10.0, 0.5), (0.1, 0.05), (30.0, 3.0), (1e4, 1.5)]
)
def test_the_tail_is_that_of_fifty_digits(threshold: float, order: float) -> None:
    """Of order 0.5, ten times the mean comes with 0.0114, and with 4.5e-5 in noise."""
    with mp.workdps(50):
        vt = mp.mpf(order) * mp.mpf(threshold)
        bessel = mp.besselk(order, 2 * mp.sqrt(vt))
        exact = 2 / mp.gamma(order) * vt ** (mp.mpf(order) / 2) * bessel
    assert k_exceedance(threshold, order) == pytest.approx(float(exact), rel=1e-12)
    assert k_exceedance(10.0, 0.5) == pytest.approx(0.0114228909934669, rel=1e-12)


def test_of_a_high_order_it_is_noise_and_of_any_it_is_a_probability() -> None:
    assert k_exceedance(3.0, 300.0) == pytest.approx(np.exp(-3.0), rel=0.02)
    found = k_exceedance([0.0, 1e-9, 1.0, 1e3, 1e9], [[0.05], [1.0], [50.0]])
    assert np.isfinite(found).all()
    assert (found[:, 0] == 1.0).all()
    assert (np.diff(found, axis=1) <= 0).all()
    assert (found <= 1.0 + 1e-12).all()
    assert 0.0 < k_exceedance(3.0, 180.0) < k_exceedance(0.1, 180.0) < 1.0


@pytest.mark.parametrize("order", [0.3, 2.0])
def test_what_crosses_the_threshold_exceeds_it_by_the_law_of_the_tail(order: float) -> None:
    threshold, n, rng = 8.0, 4000, np.random.default_rng(1)
    tail = k_exceedance(threshold, order)

    def law(x: Array) -> Array:
        return 1 - k_exceedance(threshold * np.asarray(x), order) / tail

    fresh = Spikes(threshold=threshold, order=order, texture=None)
    assert_law(fresh.over_threshold(np.zeros(n, np.int64), rng), law, "fresh")
    texture = rng.standard_gamma(order, 200_000) / order
    stays = Spikes(threshold=threshold, order=order, texture=texture)
    chance = stays.chance(len(texture))
    spread = float(np.var(chance)) * len(texture)
    assert_sum(float(chance.sum()), float(tail) * len(texture), spread, "mean over textures")
    squares = rng.choice(len(texture), n, p=chance / chance.sum())
    assert_law(stays.over_threshold(squares, rng), law, "stays")


# Equations say nothing of what has no answer; whoever calls them keeps his own warnings.


ZERO = np.zeros(1)


@nan_without_warnings
def nothing(fails: bool = False, depth: int = 1) -> np.float64:
    """Quiet, also after an inner call that was; 0/0."""
    found = nothing(depth=0) if depth else ZERO[0]
    if fails:
        raise ValueError("no")
    return found + (ZERO / ZERO)[0]


@pytest.mark.filterwarnings("error")
def test_nothing_is_said_within_and_everything_outside_again() -> None:
    with np.errstate(all="raise"):
        assert np.isnan(nothing())
        with pytest.raises(FloatingPointError):
            _ = ZERO / ZERO
        with pytest.raises(ValueError, match="no"):
            nothing(fails=True)
        with pytest.raises(FloatingPointError):
            _ = ZERO / ZERO
    with pytest.raises(RuntimeWarning):
        _ = ZERO / ZERO


@pytest.mark.parametrize("steep", [0.1, 1.0, 50.0])
@pytest.mark.parametrize("at", [-4.0, 0.1, 9.0])
@pytest.mark.parametrize(
    "curve", [np.tanh, lambda x: np.exp(x / 50) - 1, lambda x: np.clip(x + 0.5, 0, 1) - 0.3]
)
def test_a_root_is_scipys_to_the_bit(curve: Any, at: float, steep: float) -> None:
    def of(x: float) -> float:
        return float(curve(steep * (x - at)))

    assert root(of, -10.0, 10.0) == brentq(of, -10.0, 10.0, xtol=1e-12, rtol=1e-14)


@pytest.mark.parametrize("level", [1.0, -1.0, np.nan])
def test_what_has_no_root_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="sign"):
        root(lambda _: level, 0.0, 1.0)


@given(st.integers(5, 40), st.floats(0.01, 10), st.floats(0.01, 10), st.integers(0, 2**32 - 1))
def test_it_is_the_smoothing_spline_of_lambda_sigma2_over_q(
    n: int, sigma_m: float, density: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.2, 2.0, n))
    position_m = rng.normal(size=(n, 2)) * 5
    smooth_m, velocity_m_s = smooth(t_s, position_m, (sigma_m, 2 * sigma_m), density)
    for k, sigma in enumerate((sigma_m, 2 * sigma_m)):
        spline = make_smoothing_spline(t_s, position_m[:, k], lam=sigma**2 / density)
        np.testing.assert_allclose(smooth_m[:, k], spline(t_s), atol=1e-6)
        np.testing.assert_allclose(velocity_m_s[:, k], spline.derivative()(t_s), atol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 30])
def test_straight_flight_is_left_as_it_is_and_one_sample_stands_still(n: int) -> None:
    t_s = np.cumsum(np.arange(n) % 3 + 0.5)
    velocity = np.array([3.0, -4.0, 0.5])
    position_m, velocity_m_s = smooth(t_s, t_s[:, None] * velocity, (3.0, 3.0, 1.0))
    np.testing.assert_allclose(position_m, t_s[:, None] * velocity, atol=1e-9)
    np.testing.assert_allclose(velocity_m_s, np.tile((n > 1) * velocity, (n, 1)), atol=1e-9)


@pytest.mark.parametrize("t_s", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0]])
def test_times_that_do_not_increase_are_refused(t_s: list[float]) -> None:
    with pytest.raises(ValueError, match="increasing"):
        smooth(t_s, np.zeros((3, 1)), (1.0,))
