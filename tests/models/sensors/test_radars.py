"""Radars by themselves: the paper's scenario, bistatic places and heights, sums of ranges.

Statistical tests fail for one seed in 10,000 each.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from mpmath import mp
from support.significance import Array
from support.targets import targets_at

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.joined_sets import Sightings, covariance, linearised, range_sums_m, solved
from plotfeed.models.numerics import root
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.sensors.bistatic_places import HeightPrior, flat_solution, ground_range_m
from plotfeed.models.sensors.passive_radar import Illuminator, PassiveRadar
from plotfeed.models.state import Floats
from plotfeed.models.track_metrics import nees
from plotfeed.testing import SITE, scene, staring

PERIMETER = [
    {"power_w": 2000.0, "east_m": east_m, "north_m": north_m, "above_site_m": 0.0}
    for east_m, north_m in ((0.0, 100.0), (86.6, -50.0), (-86.6, -50.0))
]
MIMO = {
    "id": "mimo", "type": "mimo_radar", "scan": staring(), "transmitters": PERIMETER,
    "frequency_hz": 15e9, "gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6, "integration_s": 0.06,
    "noise_figure_db": 5.0, "range_resolution_m": 20.0, "range_max_m": 10_000.0,
    "azimuth_beamwidth_deg": 3.0, "elevation_beamwidth_deg": 10.0, "elevation_min_deg": -2.0,
    "elevation_max_deg": 28.0,
}  # fmt: skip


def mimo(**changes: Any) -> Any:
    made = scene([MIMO | changes], seed=1)
    return made.sensor[0].model(made.scene.site)


def in_the_north(range_m: Any, up_m: float = 50.0, azimuth_deg: float = 0.0) -> Floats:
    """Places at those slant ranges, that high."""
    elevation_deg = np.degrees(np.arcsin(up_m / np.asarray(range_m)))
    return np.asarray(aer_to_enu(azimuth_deg, elevation_deg, range_m))


def test_a_mimo_radar_reaches_as_far_as_the_paper_says() -> None:
    """Pd 0.8 near 4 km, from every side: the transmitters stand close to the receiver."""
    model, rcs_m2 = mimo(), np.array([0.01])
    for azimuth_deg in np.arange(0, 360, 30):

        def over(range_m: float, azimuth_deg: float = azimuth_deg) -> float:
            place = in_the_north([range_m], azimuth_deg=azimuth_deg)
            return float(model.pd(model.signal_snrs(place, rcs_m2))[0]) - 0.8

        assert root(over, 1000.0, 9000.0) == pytest.approx(3850, abs=20)


def test_a_place_of_a_transmitter_is_told_either_way() -> None:
    there = SITE.to_geodetic(np.array([300.0, 400.0, 0.0]))
    named = dict(zip(("latitude_deg", "longitude_deg"), map(float, there[:2]), strict=True))
    for place in (
        {"height_m": SITE.height_m + 10.0, **named},
        {"east_m": 300.0, "north_m": 400.0, "above_site_m": 10.0},
    ):
        model = mimo(transmitters=[{"power_w": 1.0} | place], position_enu_m=(30.0, 0.0, 2.0))
        found = model.transmitters[0].position_enu_m
        np.testing.assert_allclose(found, (270.0, 400.0, 8.0), atol=0.05)


def test_a_mimo_radar_has_defaults() -> None:
    """Thermal noise is -174 dBm/Hz at 290 K; a cell of 10 m takes 15 MHz."""
    (sensor,) = scene([MIMO], seed=1).sensor
    assert "asterix-048" not in sensor.report
    assert (sensor.pfa, sensor.loss_db, sensor.n_reference) == (1e-6, 1.1, 16)
    assert mimo(range_resolution_m=10.0).noise_dbm == pytest.approx(-173.975 + 76.758, abs=0.01)


# The passive radar.


BASELINE_M = 20e3


def mast(azimuth_deg: float, baseline_m: float = BASELINE_M, **changes: Any) -> Illuminator:
    east_m, north_m, _ = (float(x) for x in aer_to_enu(azimuth_deg, 0.0, baseline_m))
    case = {
        "erp_w": 10e3, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6, "external_noise_db": -4.45,
        "position_enu_m": (east_m, north_m, 0.0), "range_floor_m": 0.0,
    }  # fmt: skip
    return Illuminator(**(case | changes))


def passive(*transmitters: Illuminator, **changes: Any) -> PassiveRadar:
    """The paper's, with the target in the north; its transmitter is in the east."""
    case: dict[str, Any] = {
        "transmitters": transmitters or (mast(90.0),), "gain_rx_dbi": 2.0,
        "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "loss_db": 4.0, "sidelobe_db": -22.0,
        "cancellation_db": -60.0, "line_loss_db": 0.5, "antenna_loss_db": 0.5,
        "receiver_noise_figure_db": 4.0, "pfa": 1e-6, "n_reference": 16, "range_min_m": 0.0,
        "range_max_m": 10e3, "azimuth_cover": AzimuthCover(-30.0, 30.0),
        "elevation_min_deg": -90.0, "elevation_max_deg": 90.0, "doppler_cells": 1,
        "azimuth_floor_deg": 0.0,
    }  # fmt: skip
    return PassiveRadar(**(case | changes))


def test_a_passive_radar_detects_as_the_paper_says() -> None:
    found = passive().predict(targets_at(in_the_north([7e3, 5e3, 4e3, 3e3, 2e3])))
    assert found.pd == pytest.approx([0.317, 0.560, 0.691, 0.813, 0.912], abs=5e-4)
    ranges_m = np.linspace(1e3, 8e3, 701)
    pd = passive().predict(targets_at(in_the_north(ranges_m))).pd
    assert ranges_m[pd >= 0.8].max() == pytest.approx(3100, abs=150)


@pytest.mark.parametrize(("beta_deg", "bias_m"), [(90.0, 9.90), (45.0, 33.17), (10.0, 615.98)])
def test_a_drone_100_m_up_at_500_m_is_placed_too_far(beta_deg: float, bias_m: float) -> None:
    """In its distance over the ground: nobody told the sensor that it is high."""
    target, at = np.array([0.0, 500.0, 100.0]), aer_to_enu(beta_deg, 0.0, BASELINE_M)
    found = flat_solution(bistatic_range(target, at), enu_to_aer(target)[0], at)
    assert float(found.range_m) - 500 == pytest.approx(bias_m, abs=0.01)
    loud = targets_at(np.tile(target, (1000, 1)), rcs_m2=1e4)
    _, plots = passive(mast(beta_deg)).observe(loud, np.random.default_rng(2))
    assert np.median(plots.range_m) - 500 == pytest.approx(bias_m, abs=0.1)
    np.testing.assert_allclose(plots.true_range_m, np.hypot(500, 100))


@given(
    st.floats(1.0, 2e4), st.floats(0, 360), st.floats(0, 360), st.floats(500, 5e4),
    st.floats(0, 2e3),
)  # fmt: skip
def test_slopes_and_covariance_are_those_of_finite_differences(
    excess_m: float, azimuth_deg: float, tx_azimuth_deg: float, baseline_m: float, up_m: float
) -> None:
    assume(abs(float(wrap_180(azimuth_deg - tx_azimuth_deg))) > 2)
    at = aer_to_enu(tx_azimuth_deg, 0.0, baseline_m) + np.array([0.0, 0.0, up_m])

    def place(excess: float, azimuth: float) -> Array:
        solved_flat = flat_solution(np.array(excess), np.array(azimuth), at)
        return np.asarray(aer_to_enu(azimuth, 0.0, solved_flat.range_m)[:2])

    step_m, step_deg = 1e-5 * excess_m, 1e-4
    by_range = place(excess_m + step_m, azimuth_deg) - place(excess_m - step_m, azimuth_deg)
    by_azimuth = place(excess_m, azimuth_deg + step_deg) - place(excess_m, azimuth_deg - step_deg)
    sigmas = np.array(3.0), np.array(0.2)
    jacobian = np.stack([by_range / (2 * step_m) * 3.0, by_azimuth / (2 * step_deg) * 0.2], axis=1)
    expected = jacobian @ jacobian.T
    flat = flat_solution(np.array(excess_m), np.array(azimuth_deg), at)
    scale = float(np.trace(expected))
    assert [*flat.covariance_m2(*sigmas)] == pytest.approx(
        [expected[0, 0], expected[1, 1], expected[0, 1]], rel=1e-4, abs=1e-5 * scale
    )
    out = aer_to_enu(azimuth_deg, 0.0, 1.0)[:2]
    along = float(np.sqrt(out @ expected @ out))
    assert float(flat.sigma_m(*sigmas)) == pytest.approx(along, rel=1e-4, abs=1e-5 * scale**0.5)


@pytest.mark.parametrize(("range_m", "up_m"), [(50.0, 0.0), (500.0, 10.0), (9000.0, 50.0)])
def test_on_the_baseline_plots_vanish_and_nothing_is_infinite(range_m: float, up_m: float) -> None:
    """The drone is between the receiver and the transmitter; or that is at the receiver."""
    radar, place = passive(mast(0.0)), np.tile([0.0, range_m, up_m], (2000, 1))
    looks, plots = radar.observe(targets_at(place), np.random.default_rng(6))
    assert looks.detected.sum() > 250
    predicted = radar.predict(targets_at(place[:1]))
    if up_m == 0 or range_m > 1000:
        assert len(plots) < 0.05 * looks.detected.sum()
        assert predicted.pd[0] < 0.05
    for column in dataclasses.astuple(predicted):
        assert column is None or not np.isinf(column).any()
    radar = passive(mast(0.0, 0.0))
    looks, plots = radar.observe(targets_at(place[:9]), np.random.default_rng(8))
    assert (looks.snr == 0).all()
    assert len(plots) == radar.predict(targets_at(place[:1])).pd[0] == 0


def test_amplitude_is_the_echo_that_such_a_detection_is_of() -> None:
    """Before the correlator; averaged over fluctuation it is the mean echo, within the noise."""
    radar, place = passive(), np.tile(in_the_north(500.0), (10_000, 1))
    _, plots = radar.observe(targets_at(place), np.random.default_rng(10))
    mean_w = np.mean(10 ** (plots.amplitude_dbm / 10 - 3))
    expected_w = float(radar.target_power_w(place[:1], np.array([0.01]))[0, 0])
    assert mean_w == pytest.approx(expected_w, rel=0.05)


# Places of targets of unknown height: geometry, and the prior's moments.


MAST_ENU_M = (-14e3, 14e3, 150.0)


def at(azimuth_deg: Array, ground_m: Array, height_m: Array) -> Array:
    places_m = aer_to_enu(azimuth_deg, 0.0, ground_m)
    places_m[..., 2] = height_m
    return places_m


@given(
    st.floats(0, 360), st.floats(10, 50e3), st.floats(-200, 5e3),
    st.tuples(st.floats(-30e3, 30e3), st.floats(-30e3, 30e3), st.floats(-300, 800)),
)  # fmt: skip
def test_the_distance_over_the_ground_is_found_where_the_height_is_known(
    azimuth_deg: float, ground_m: float, height_m: float, mast_enu_m: tuple[float, float, float]
) -> None:
    """High above the middle of a baseline two have the same bistatic range; then the outer one."""
    transmitter, one = np.array(mast_enu_m), np.array([azimuth_deg])
    assume(np.hypot(*mast_enu_m[:2]) > 100)
    excess_m, beyond_m = (
        bistatic_range(at(one, np.array([ground_m + more_m]), height_m), transmitter)
        for more_m in (0.0, 0.1)
    )
    assume(excess_m[0] > 1)  # near the baseline it says nothing of the distance
    assume(beyond_m[0] - excess_m[0] > 1e-4)
    found = ground_range_m(excess_m, one, transmitter[None], height_m)
    np.testing.assert_allclose(found, ground_m, rtol=1e-6, atol=0.01)
    if height_m == 0:
        flat = flat_solution(excess_m, one, transmitter[None])
        np.testing.assert_allclose(found, flat.range_m, rtol=1e-9)


@pytest.mark.parametrize(("mean_m", "sigma_m"), [(60.0, 35.0), (120.0, 0.0)])
def test_positions_of_targets_of_the_heights_expected_err_as_stated(
    mean_m: float, sigma_m: float
) -> None:
    """None nearer than four usual heights: there those measured alike are other than all."""
    rng, n = np.random.default_rng(6), 10_000
    heights_m = mean_m + sigma_m * rng.standard_normal(n)
    places = at(rng.uniform(-15, 265, n), rng.uniform(4 * mean_m, 6000, n), heights_m)
    illuminator = mast(0.0, erp_w=1e5, position_enu_m=MAST_ENU_M, external_noise_db=0.0,
                       range_floor_m=2.0)  # fmt: skip
    model = passive(illuminator, gain_rx_dbi=10.0, cancellation_db=-80.0, azimuth_floor_deg=0.1,
                    range_max_m=20e3, azimuth_cover=AzimuthCover(-20.0, 270.0),
                    expected_height_m=mean_m, sigma_height_m=sigma_m)  # fmt: skip
    _, plots = model.observe(targets_at(places, rcs_m2=10.0), rng)
    assert len(plots) > 9_000
    true_enu_m = places[plots.drone]
    found_m = at(plots.azimuth_deg, plots.range_m, np.zeros(len(plots)))
    a, b, c = plots.covariance_east_m2, plots.covariance_north_m2, plots.covariance_east_north_m2
    covariance_m2 = np.moveaxis(np.array([[a, c], [c, b]]), -1, 0)
    assert nees((found_m - true_enu_m)[:, :2], covariance_m2).mean() == pytest.approx(2.0, rel=0.03)
    off_m = plots.range_m - np.hypot(true_enu_m[:, 0], true_enu_m[:, 1])
    assert abs(np.mean(off_m / plots.sigma_range_m)) < 0.04
    east, north, _ = aer_to_enu(plots.azimuth_deg, 0.0, 1.0).T
    along_m2 = east**2 * a + north**2 * b + 2 * east * north * c
    np.testing.assert_allclose(plots.sigma_range_m**2, along_m2, rtol=0.02)
    nearer = np.array([1.0]), np.array([45.0]), np.array([MAST_ENU_M])  # than any height expected
    assert np.isnan(HeightPrior(500.0, 1.0).ground_range_m(*nearer)[0]).all()


# Places by least squares from sums of ranges: the bound, the digits, and what heights leave.


MASTS_M = np.array(
    [[-8000.0, 15_000.0, 200.0], [17_000.0, 3000.0, 150.0], [2000.0, -17_500.0, 120.0]]
)
PLACE_M = np.array([1500.0, 2000.0, 100.0])


def sightings(sum_m: Floats, sigma_m: float = 20.0, **more: Any) -> Sightings:
    """Sums of ranges, and no directions unless more is said."""
    nothing = np.full((*sum_m.shape, 2), np.nan)
    usual = {
        "transmitters_m": MASTS_M, "receivers_m": np.zeros((3, 3)),
        "measured": np.concatenate([sum_m[..., None], nothing], -1),
        "sigmas": np.concatenate([np.full((*sum_m.shape, 1), sigma_m), nothing], -1),
        "height_m": 100.0, "sigma_height_m": 1e9,
    }  # fmt: skip
    return Sightings(**(usual | more))


def test_three_sums_near_the_ground_leave_no_usable_height() -> None:
    """Masts 120 to 200 m high, 17 km away, sums known to 20 m: heights to half a kilometre."""
    sums_m = range_sums_m(PLACE_M[None], MASTS_M, np.zeros((3, 3)))
    assert sums_m[0, 0] == pytest.approx(18603.5519207965, rel=1e-15)  # by hand
    without = solved(PLACE_M[None], sightings(sums_m)).covariance_m2[0]
    east_m, north_m, up_m = np.sqrt(np.diag(without))
    assert max(east_m, north_m) < 25
    assert up_m > 500
    known = solved(PLACE_M[None], sightings(sums_m, sigma_height_m=50.0)).covariance_m2[0]
    assert np.sqrt(known[2, 2]) == pytest.approx(50.0, rel=0.01)
    assert (np.diag(known)[:2] < np.diag(without)[:2]).all()
    for start_m in ((4000.0, 4000.0, 10.0), (-3000.0, -500.0, 300.0)):
        found = solved(np.array([start_m]), sightings(sums_m, sigma_height_m=50.0))
        np.testing.assert_allclose(found.place_m[0], PLACE_M, atol=1e-6)
        assert found.square[0] < 1e-12


def test_places_scatter_by_the_covariance_where_heights_are_as_expected() -> None:
    """The normalised square of errors has mean 3, by 10,000 sets of noisy sums."""
    rng, n = np.random.default_rng(5), 10_000
    places_m = PLACE_M + np.array([0.0, 0.0, 50.0]) * rng.standard_normal((n, 1))
    noisy_m = range_sums_m(places_m, MASTS_M, np.zeros((3, 3))) + 20 * rng.standard_normal((n, 3))
    start_m = np.tile([1000.0, 2600.0, 60.0], (n, 1))
    found = solved(start_m, sightings(noisy_m, sigma_height_m=50.0))
    assert nees(found.place_m - places_m, found.covariance_m2).mean() == pytest.approx(
        3.0, abs=0.12
    )
    assert found.square.mean() == pytest.approx(1.0, abs=0.08)


def test_a_covariance_of_bearings_a_millionth_of_a_radian_apart_keeps_its_digits() -> None:
    """By sixty digits of the same rows, of which the normal equations lose all but some."""
    a, b = 0.7, 0.7 + 1e-6
    jacobian = np.array([[[np.cos(a), np.sin(a), 0], [np.cos(b), np.sin(b), 0], [0, 0, 1.0]]])
    with mp.workdps(60):
        (a, b), (c, d) = ((mp.mpf(float(x)) for x in row[:2]) for row in jacobian[0, :2])
        exact = (a * a + c * c) / (a * d - b * c) ** 2
    plain = np.linalg.inv(jacobian[0].T @ jacobian[0])[1, 1]
    assert float(abs(covariance(jacobian)[0, 1, 1] / exact - 1)) < 1e-8
    assert float(abs(plain / exact - 1)) > 1e-4


def test_gradients_are_those_of_what_is_measured() -> None:
    full = sightings(
        np.full((1, 3), 2e4), sigma_height_m=35.0, measured=np.tile([2e4, 20.0, 3.0], (1, 3, 1)),
        receivers_m=np.array([[0.0, 0.0, 0.0], [3000.0, 0.0, 5.0], [0.0, -2000.0, 0.0]]),
        sigmas=np.tile([7.0, 1.5, 2.0], (1, 3, 1)),
    )  # fmt: skip
    jacobian, before = linearised(PLACE_M[None], full)
    for axis in range(3):
        _, after = linearised((PLACE_M + 1e-3 * np.eye(3)[axis])[None], full)
        np.testing.assert_allclose((before - after)[0] / 1e-3, jacobian[0, :, axis], atol=1e-6)
