"""Places of targets of unknown height: geometry, and the prior's moments by Monte Carlo."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.significance import Array, assert_mean

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.sensors.bistatic_places import HeightPrior, flat_solution, ground_range_m
from plotfeed.models.sensors.passive_radar import Illuminator, PassiveRadar
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Plots, Signature

MAST_ENU_M = (-14e3, 14e3, 150.0)


def at(azimuth_deg: Array, ground_m: Array, height_m: Array) -> Array:
    enu_m = np.array(
        np.broadcast_arrays(*np.moveaxis(aer_to_enu(azimuth_deg, 0.0, ground_m), -1, 0))
    )
    return np.stack([enu_m[0], enu_m[1], np.broadcast_to(height_m, enu_m[0].shape)], axis=-1)


transmitters = st.tuples(st.floats(-30e3, 30e3), st.floats(-30e3, 30e3), st.floats(-300, 800))


@given(st.floats(0, 360), st.floats(10, 50e3), st.floats(-200, 5e3), transmitters)
def test_the_distance_over_the_ground_is_found_where_the_height_is_known(
    azimuth_deg: float, ground_m: float, height_m: float, mast_enu_m: tuple[float, float, float]
) -> None:
    """High above the middle of a baseline two have the same bistatic range; then the outer one."""
    transmitter = np.array(mast_enu_m)
    assume(np.hypot(*mast_enu_m[:2]) > 100)
    here = at(np.array([azimuth_deg]), np.array([ground_m]), np.array([height_m]))
    further = at(np.array([azimuth_deg]), np.array([ground_m + 0.1]), np.array([height_m]))
    excess_m, beyond_m = (bistatic_range(place, transmitter) for place in (here, further))
    assume(excess_m[0] > 1)  # near the baseline it says nothing of the distance
    assume(beyond_m[0] - excess_m[0] > 1e-4)
    found = ground_range_m(excess_m, np.array([azimuth_deg]), transmitter[None], height_m)
    np.testing.assert_allclose(found, ground_m, rtol=1e-6, atol=0.01)


def test_level_targets_are_where_the_flat_solution_has_them() -> None:
    rng = np.random.default_rng(1)
    excess_m, azimuth_deg = rng.uniform(10, 1e4, 500), rng.uniform(0, 360, 500)
    mast = np.broadcast_to(MAST_ENU_M, (500, 3))
    flat = flat_solution(excess_m, azimuth_deg, mast)
    level_m = ground_range_m(excess_m, azimuth_deg, mast, 0.0)
    np.testing.assert_allclose(level_m, flat.range_m, rtol=1e-9)


@pytest.mark.parametrize("azimuth_deg", [45.0, 90.0, 180.0, 300.0])
@pytest.mark.parametrize("excess_m", [500.0, 3000.0])
def test_mean_and_variance_are_those_of_heights_drawn(azimuth_deg: float, excess_m: float) -> None:
    prior, n = HeightPrior(60.0, 35.0), 200_000
    heights_m = 60 + 35 * np.random.default_rng(2).standard_normal(n)
    one = np.array([excess_m]), np.array([azimuth_deg]), np.array([MAST_ENU_M])
    mean_m, variance_m2 = prior.ground_range_m(*one)
    drawn_m = ground_range_m(*(np.repeat(column, n, axis=0) for column in one), heights_m)
    assert_mean(drawn_m, float(mean_m[0]), "mean")
    assert_mean((drawn_m - mean_m[0]) ** 2, float(variance_m2[0]), "variance")


def test_a_target_nearer_than_any_height_expected_is_nowhere() -> None:
    one = np.array([1.0]), np.array([45.0]), np.array([MAST_ENU_M])
    mean_m, _ = HeightPrior(500.0, 1.0).ground_range_m(*one)
    assert np.isnan(mean_m).all()


def radar(**changes: Any) -> PassiveRadar:
    keys: dict[str, Any] = {
        "transmitters": (
            Illuminator(
                erp_w=1e5, frequency_hz=600e6, bandwidth_hz=7.61e6, position_enu_m=MAST_ENU_M,
                external_noise_db=0.0, range_floor_m=2.0,
            ),
        ),
        "gain_rx_dbi": 10.0, "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "loss_db": 4.0,
        "sidelobe_db": -22.0, "cancellation_db": -80.0, "line_loss_db": 0.5,
        "antenna_loss_db": 0.5, "receiver_noise_figure_db": 4.0, "pfa": 1e-6, "n_reference": 16,
        "doppler_cells": 1, "azimuth_floor_deg": 0.1,
        "range_min_m": 0.0, "range_max_m": 20e3, "elevation_min_deg": -90.0,
        "elevation_max_deg": 90.0, "azimuth_cover": AzimuthCover(-20.0, 270.0),
    }  # fmt: skip
    return PassiveRadar(**keys | changes)


def placed(model: PassiveRadar, heights_m: Array, seed: int) -> tuple[Array, Plots]:
    """Plots of targets at those heights, all around but near the baseline, and true places.

    None is nearer than four times a usual height: there the heights of what is measured alike are
    others than those of all.
    """
    rng = np.random.default_rng(seed)
    n, nearest_m = len(heights_m), 4 * heights_m.mean()
    places = at(rng.uniform(-15, 265, n), rng.uniform(nearest_m, 6000, n), heights_m)
    targets = Targets.of_one(Signature(rcs_m2=10.0), places)
    tagged = Targets(
        drone=np.arange(n),
        t_utc_ns=targets.t_utc_ns,
        position_enu_m=places,
        true_position_enu_m=places,
        signatures=type(targets.signatures)(
            rcs_m2=np.full(n, 10.0), sound_power_db=np.full(n, np.nan), emitters=[()] * n
        ),
    )
    _, plots = model.observe(tagged, rng)
    return places[plots.drone], plots


def squares(true_enu_m: Array, plots: Plots) -> Array:
    """Errors of positions over the ground, squared, by the covariances stated: of two each."""
    stated = at(plots.azimuth_deg, plots.range_m, np.zeros(len(plots)))
    de, dn, _ = np.moveaxis(stated - true_enu_m, -1, 0)
    a, b, c = plots.covariance_east_m2, plots.covariance_north_m2, plots.covariance_east_north_m2
    return np.asarray((b * de**2 - 2 * c * de * dn + a * dn**2) / (a * b - c**2))


@pytest.mark.parametrize(("mean_m", "sigma_m"), [(60.0, 35.0), (300.0, 100.0), (120.0, 0.0)])
def test_positions_of_targets_of_the_heights_expected_err_as_stated(
    mean_m: float, sigma_m: float
) -> None:
    heights_m = mean_m + sigma_m * np.random.default_rng(5).standard_normal(20_000)
    true_enu_m, plots = placed(
        radar(expected_height_m=mean_m, sigma_height_m=sigma_m), heights_m, seed=6
    )
    assert len(plots) > 18_000
    assert np.mean(squares(true_enu_m, plots)) == pytest.approx(2.0, rel=0.02)
    off_m = plots.range_m - np.hypot(true_enu_m[:, 0], true_enu_m[:, 1])
    assert abs(np.mean(off_m / plots.sigma_range_m)) < 0.03
    np.testing.assert_allclose(plots.sigma_range_m**2, _along(plots), rtol=0.02)


def _along(plots: Plots) -> Array:
    """Variance of positions along their directions."""
    east, north, _ = np.moveaxis(aer_to_enu(plots.azimuth_deg, 0.0, 1.0), -1, 0)
    return np.asarray(
        east**2 * plots.covariance_east_m2
        + north**2 * plots.covariance_north_m2
        + 2 * east * north * plots.covariance_east_north_m2
    )


def test_in_the_plane_high_targets_are_far_beyond_what_is_stated() -> None:
    """That is what leaving the height out comes to."""
    heights_m = 300.0 + 100.0 * np.random.default_rng(5).standard_normal(5000)
    true_enu_m, plots = placed(radar(), heights_m, seed=6)
    assert np.mean(squares(true_enu_m, plots)) > 20


def test_azimuths_and_bistatic_ranges_do_not_depend_on_what_is_expected() -> None:
    heights_m = np.full(2000, 200.0)
    level, expecting = (
        placed(model, heights_m, seed=7)[1]
        for model in (radar(), radar(expected_height_m=200.0, sigma_height_m=50.0))
    )
    np.testing.assert_array_equal(level.bistatic_range_m, expecting.bistatic_range_m)
    assert not wrap_180(level.azimuth_deg - expecting.azimuth_deg).any()
    for name in ("sigma_bistatic_range_m", "sigma_azimuth_deg"):
        np.testing.assert_array_equal(getattr(level, name), getattr(expecting, name))
