"""The passive radar put together: channels, the flat solution and its errors, baselines, alarms.

Statistical tests fail for one seed in 10,000 each.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.significance import assert_mean, assert_sum

from plotfeed.models import propagation
from plotfeed.models.beam import AzimuthCover, Timetable
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.sensors.bistatic_places import flat_solution
from plotfeed.models.sensors.passive_radar import Illuminator, PassiveRadar
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures

BASELINE_M = 20e3
SCAN = Timetable(1_000_000_000, 1).sector(7, 0)


def transmitter(azimuth_deg, baseline_m=BASELINE_M, up_m=0.0, **changes):
    east_m, north_m, _ = aer_to_enu(azimuth_deg, 0.0, baseline_m)
    case = {
        "erp_w": 10e3,
        "frequency_hz": 600e6,
        "bandwidth_hz": 7.61e6,
        "position_enu_m": (float(east_m), float(north_m), up_m),
        "external_noise_db": -4.45,
        "range_floor_m": 0.0,
    }
    return Illuminator(**(case | changes))


def section_4(*transmitters, **changes):
    """The paper's, with the target in the north; its transmitter is in the east."""
    case = {
        "transmitters": transmitters or (transmitter(90.0),),
        "gain_rx_dbi": 2.0,
        "azimuth_beamwidth_deg": 2.0,
        "integration_s": 0.3,
        "loss_db": 4.0,
        "sidelobe_db": -22.0,
        "cancellation_db": -60.0,
        "line_loss_db": 0.5,
        "antenna_loss_db": 0.5,
        "receiver_noise_figure_db": 4.0,
        "pfa": 1e-6,
        "n_reference": 16,
        "range_min_m": 0.0,
        "range_max_m": 10e3,
        "azimuth_cover": AzimuthCover(-30.0, 30.0),
        "elevation_min_deg": -90.0,
        "elevation_max_deg": 90.0,
        "doppler_cells": 1,
        "azimuth_floor_deg": 0.0,
    }
    return PassiveRadar(**(case | changes))


def targets_at(position_enu_m, rcs_m2=0.01):
    position_enu_m = np.atleast_2d(np.asarray(position_enu_m, dtype=np.float64))
    n = len(position_enu_m)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.full(n, 5, np.int64),
        position_enu_m=position_enu_m,
        true_position_enu_m=position_enu_m,
        signatures=Signatures(
            rcs_m2=np.full(n, rcs_m2), sound_power_db=np.full(n, np.nan), emitters=[()] * n
        ),
    )


def in_the_north(range_m, up_m=50.0):
    range_m = np.asarray(range_m, dtype=np.float64)
    ground_m = np.sqrt(range_m**2 - up_m**2)
    return np.stack([0 * ground_m, ground_m, np.full_like(ground_m, up_m)], axis=-1)


def solve(target_enu_m, transmitter_enu_m):
    target, at = np.asarray(target_enu_m), np.asarray(transmitter_enu_m)
    excess_m = propagation.bistatic_range(target, at)
    return flat_solution(excess_m, enu_to_aer(target)[0], at)


def test_section_4_detects_as_the_paper_says():
    ranges_m = np.array([7e3, 5e3, 4e3, 3e3, 2e3])
    found = section_4().predict(targets_at(in_the_north(ranges_m)))
    assert found.pd == pytest.approx([0.317, 0.560, 0.691, 0.813, 0.912], abs=5e-4)
    ranges_m = np.linspace(1e3, 8e3, 7001)
    pd = section_4().predict(targets_at(in_the_north(ranges_m))).pd
    assert ranges_m[pd >= 0.8].max() == pytest.approx(3100, abs=150)


@pytest.mark.parametrize(("beta_deg", "bias_m"), [(90.0, 9.90), (45.0, 33.17), (10.0, 615.98)])
def test_a_drone_100_m_up_at_500_m_is_placed_too_far(beta_deg, bias_m):
    """In its distance over the ground: nobody told the sensor that it is high."""
    found = solve([0.0, 500.0, 100.0], aer_to_enu(beta_deg, 0.0, BASELINE_M))
    assert float(found.range_m) - 500 == pytest.approx(bias_m, abs=0.01)
    radar = section_4(transmitter(beta_deg), azimuth_floor_deg=0.0)
    loud = targets_at(np.tile([0.0, 500.0, 100.0], (4000, 1)), rcs_m2=1e4)
    _, plots = radar.observe(loud, np.random.default_rng(2))
    assert len(plots) > 3990
    assert np.median(plots.range_m) - 500 == pytest.approx(bias_m, abs=0.1)
    np.testing.assert_allclose(plots.true_range_m, np.hypot(500, 100))


@given(
    st.floats(1.0, 2e4),
    st.floats(0, 360),
    st.floats(0, 360),
    st.floats(500, 5e4),
    st.floats(0, 2e3),
)
def test_slopes_and_covariance_are_those_of_finite_differences(
    excess_m, azimuth_deg, tx_azimuth_deg, baseline_m, up_m
):
    assume(abs(float(wrap_180(azimuth_deg - tx_azimuth_deg))) > 2)
    at = aer_to_enu(tx_azimuth_deg, 0.0, baseline_m) + np.array([0.0, 0.0, up_m])

    def place(excess, azimuth):
        solved = flat_solution(np.array(excess), np.array(azimuth), at)
        return aer_to_enu(azimuth, 0.0, solved.range_m)[:2]

    step_m, step_deg = 1e-5 * excess_m, 1e-4
    by_range = place(excess_m + step_m, azimuth_deg) - place(excess_m - step_m, azimuth_deg)
    by_azimuth = place(excess_m, azimuth_deg + step_deg) - place(excess_m, azimuth_deg - step_deg)
    sigma_m, sigma_deg = 3.0, 0.2
    jacobian = np.stack(
        [by_range / (2 * step_m) * sigma_m, by_azimuth / (2 * step_deg) * sigma_deg], axis=1
    )
    expected = jacobian @ jacobian.T
    flat = flat_solution(np.array(excess_m), np.array(azimuth_deg), at)
    east, north, both = flat.covariance_m2(np.array(sigma_m), np.array(sigma_deg))
    scale = float(np.trace(expected))
    assert [east, north, both] == pytest.approx(
        [expected[0, 0], expected[1, 1], expected[0, 1]], rel=1e-4, abs=1e-5 * scale
    )
    out = aer_to_enu(azimuth_deg, 0.0, 1.0)[:2]
    along = float(np.sqrt(out @ expected @ out))
    assert float(flat.sigma_m(np.array(sigma_m), np.array(sigma_deg))) == pytest.approx(
        along, rel=1e-4, abs=1e-5 * scale**0.5
    )


def test_predicted_errors_are_the_rms_of_plots_about_their_mean():
    """Seed 4; by the channel with the highest Pd, here the first."""
    radar = section_4(transmitter(60.0), transmitter(-100.0, erp_w=100.0))
    n = 60_000
    target = targets_at(np.tile(in_the_north(5000.0, 100.0), (n, 1)))
    predicted = radar.predict(targets_at(in_the_north(5000.0, 100.0)))
    looks, plots = radar.observe(target, np.random.default_rng(4))
    first = plots.rows(plots.channel == 0)
    assert float(predicted.snr[0]) == pytest.approx(looks.snr[0])
    range_error_m = first.range_m - first.range_m.mean()
    assert np.sqrt(np.mean(range_error_m**2)) == pytest.approx(predicted.sigma_range_m[0], rel=0.02)
    assert_mean(wrap_180(first.azimuth_deg) ** 2, predicted.sigma_azimuth_deg[0] ** 2, "azimuth")
    reported = len(np.unique(plots.drone))
    pd = float(predicted.pd[0])
    assert_sum(reported, n * pd, n * pd * (1 - pd), "reported by either")
    assert np.isnan(predicted.sigma_elevation_deg).all()


@pytest.mark.parametrize("range_m", [9950.0, 10_000.0])
def test_at_the_end_of_the_range_half_of_the_plots_are_lost(range_m):
    radar = section_4(transmitter(100.0))
    position = np.tile(in_the_north(range_m), (40_000, 1))
    _, plots = radar.observe(targets_at(position, rcs_m2=0.1), np.random.default_rng(5))
    predicted = radar.predict(targets_at(in_the_north(range_m), rcs_m2=0.1)).pd[0]
    assert len(plots) / len(position) == pytest.approx(predicted, abs=0.03)


@pytest.mark.parametrize("up_m", [0.0, 10.0, 50.0])
@pytest.mark.parametrize("range_m", [50.0, 500.0, 3000.0, 9000.0])
def test_on_the_baseline_plots_vanish_and_nothing_is_infinite(range_m, up_m):
    """The drone is between the receiver and the transmitter."""
    radar = section_4(transmitter(0.0))
    position = np.tile([0.0, range_m, up_m], (4000, 1))
    looks, plots = radar.observe(targets_at(position), np.random.default_rng(6))
    assert looks.detected.sum() > 500
    predicted = radar.predict(targets_at(position[:1]))
    if up_m == 0 or range_m > 1000:
        assert len(plots) < 0.05 * looks.detected.sum()
        assert predicted.pd[0] < 0.05
    assert_sound(radar, plots)
    for column in dataclasses.astuple(predicted):
        assert column is None or not np.isinf(column).any()


def test_behind_the_receiver_and_behind_the_transmitter():
    radar = section_4(transmitter(180.0), transmitter(0.0, 2e3))
    _, plots = radar.observe(
        targets_at(in_the_north([5000.0] * 500), 1.0), np.random.default_rng(7)
    )
    behind, beyond = (plots.rows(plots.channel == i) for i in (0, 1))
    assert np.median(behind.range_m) == pytest.approx(5000, abs=5)
    assert np.median(beyond.range_m) == pytest.approx(5000, abs=20)


def test_a_transmitter_at_the_receiver_gives_no_plots_and_no_warnings():
    radar = section_4(transmitter(0.0, 0.0))
    looks, plots = radar.observe(targets_at(in_the_north([100.0] * 9)), np.random.default_rng(8))
    assert (looks.snr == 0).all()
    assert len(plots) == 0
    assert radar.predict(targets_at(in_the_north([100.0]))).pd[0] == 0


def test_cover_takes_distance_azimuth_and_elevation():
    radar = section_4(range_min_m=100.0, elevation_min_deg=-5.0, elevation_max_deg=60.0)
    position = aer_to_enu(
        np.array([0, 29, 331, 31, 0, 0, 0, 0, 0]),
        np.array([0, 0, 0, 0, 61, -6, 0, 0, 90.0]),
        np.array([500, 500, 500, 500, 500, 500, 99, 10_001, 500.0]),
    )
    looks, _ = radar.observe(targets_at(position), np.random.default_rng(9))
    assert looks.drone.tolist() == [0, 1, 2]
    assert len(radar.observe(targets_at(position[3:]), np.random.default_rng(9))[0]) == 0


def test_amplitude_is_the_echo_that_such_a_detection_is_of():
    """Before the correlator; averaged over fluctuation it is the mean echo, within the noise."""
    radar = section_4()
    position = np.tile(in_the_north(500.0), (20_000, 1))
    _, plots = radar.observe(targets_at(position), np.random.default_rng(10))
    mean_w = np.mean(10 ** (plots.amplitude_dbm / 10 - 3))
    expected_w = float(radar.target_power_w(position[:1], np.array([0.01]))[0, 0])
    assert mean_w == pytest.approx(expected_w, rel=0.04)


def assert_sound(radar, plots):
    """What is stated is finite and within bounds; what is not measured is absent."""
    for name in (
        "range_m",
        "azimuth_deg",
        "bistatic_range_m",
        "snr",
        "amplitude_dbm",
        "sigma_range_m",
        "sigma_azimuth_deg",
        "sigma_bistatic_range_m",
        "covariance_east_m2",
        "covariance_north_m2",
        "covariance_east_north_m2",
    ):
        assert np.isfinite(getattr(plots, name)).all(), name
    for name in ("elevation_deg", "height_m", "sigma_elevation_deg", "run_length_deg"):
        assert np.isnan(getattr(plots, name)).all(), name
    assert ((plots.range_m >= radar.range_min_m) & (plots.range_m <= radar.range_max_m)).all()
    assert (plots.range_m > 0).all()
    assert (plots.bistatic_range_m > 0).all()
    assert ((plots.azimuth_deg >= 0) & (plots.azimuth_deg < 360)).all()
    trace = plots.covariance_east_m2 + plots.covariance_north_m2
    minor = plots.covariance_east_m2 * plots.covariance_north_m2
    assert (minor - plots.covariance_east_north_m2**2 >= -1e-9 * trace**2).all()


@st.composite
def transmitters(draw):
    return transmitter(
        draw(st.floats(0, 360)),
        draw(st.floats(1.0, 2e5)),
        draw(st.floats(-100, 3000)),
        erp_w=draw(st.floats(1e-3, 1e6)),
        frequency_hz=draw(st.floats(1e6, 1e10)),
        bandwidth_hz=draw(st.floats(1e3, 1e9)),
        external_noise_db=draw(st.floats(-20, 80)),
    )


@st.composite
def radars(draw):
    range_max_m = draw(st.floats(100, 4e5))
    return section_4(
        *draw(st.lists(transmitters(), min_size=1, max_size=3)),
        gain_rx_dbi=draw(st.floats(-10, 40)),
        azimuth_beamwidth_deg=draw(st.floats(0.1, 360)),
        integration_s=draw(st.floats(1e-3, 10)),
        loss_db=draw(st.floats(0, 20)),
        sidelobe_db=draw(st.floats(-80, 0)),
        cancellation_db=draw(st.floats(-120, 0)),
        line_loss_db=draw(st.floats(0, 3)),
        antenna_loss_db=draw(st.floats(0, 3)),
        receiver_noise_figure_db=draw(st.floats(0, 20)),
        pfa=draw(st.floats(1e-15, 0.1)),
        n_reference=draw(st.integers(1, 1000)),
        range_min_m=draw(st.floats(0, 0.5)) * range_max_m,
        range_max_m=range_max_m,
        azimuth_cover=AzimuthCover(0.0, draw(st.floats(0.1, 360))),
        azimuth_floor_deg=draw(st.floats(0, 10)),
    )


@given(radars(), st.integers(0, 2**32), st.floats(1e-5, 1e4))
def test_whatever_the_parameters_plots_are_finite_and_odds_are_odds(radar, seed, rcs_m2):
    rng = np.random.default_rng(seed)
    direction = aer_to_enu(rng.uniform(0, 360, 40), rng.uniform(-90, 90, 40), 1.0)
    spread_m = radar.range_max_m * 10.0 ** rng.uniform(-6, 0.2, (40, 1))
    on_lines = radar.positions_enu_m * rng.uniform(-1, 2, (len(radar.transmitters), 1))
    places = [direction * spread_m, on_lines, radar.positions_enu_m, np.zeros((1, 3))]
    targets = targets_at(np.concatenate(places), rcs_m2)
    looks, plots = radar.observe(targets, rng)
    assert ((looks.pd >= 0) & (looks.pd <= 1)).all()
    caps = np.array([t.bandwidth_hz for t in radar.transmitters]) * radar.integration_s
    assert (looks.snr <= caps[looks.channel]).all()
    rising = np.argsort(looks.snr)
    assert (np.diff(looks.pd[rising]) >= -1e-15).all()
    assert_sound(radar, plots)
    predicted = radar.predict(targets)
    assert ((predicted.pd >= 0) & (predicted.pd <= 1)).all()
    for column in dataclasses.astuple(predicted):
        assert column is None or not np.isinf(column).any()
    if sum(radar.resolution_cells) < 1e5:
        assert_sound(radar, radar.draw_false_alarms(SCAN, rng))
    assert 0 <= radar.false_alarms_per_scan <= sum(radar.resolution_cells) * radar.pfa * 1.0000001
