"""The range gate: everything within is reported, with Gaussian noise on each axis."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.significance import assert_standard_normal, assert_uncorrelated

from plotfeed.models.beam import Timetable
from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Floats, Plots, Signatures

SCAN = Timetable(1_000_000_000, 1).sector(0, 0)


def targets(position_enu_m: Any) -> Targets:
    positions = np.asarray(position_enu_m, dtype=np.float64).reshape(-1, 3)
    n = len(positions)
    return Targets(
        drone=np.arange(n) + 3,
        t_utc_ns=np.full(n, SCAN.end_ns),
        position_enu_m=positions,
        true_position_enu_m=positions,
        signatures=Signatures(
            rcs_m2=np.full(n + 3, np.nan),
            sound_power_db=np.full(n + 3, np.nan),
            emitters=[()] * (n + 3),
        ),
    )


def measured_enu_m(plots: Plots) -> Floats:
    return aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)


@pytest.mark.parametrize("place", [(300.0, -200.0, 40.0), (0.0, 0.0, 60.0), (3.0, 1.0, 2.0)])
def test_noise_is_gaussian_and_independent_on_each_axis(place: tuple[float, ...]) -> None:
    """Straight above and close by too; seed 2."""
    gate = RangeGate(range_max_m=1000.0, sigma_m=4.0)
    _, plots = gate.observe(targets(np.tile(place, (5000, 1))), np.random.default_rng(2))
    noise = (measured_enu_m(plots) - place) / 4.0
    for axis, values in zip(("east", "north", "up"), noise.T, strict=True):
        assert_standard_normal(values, f"{axis}, seed 2")
    for a, b in combinations(noise.T, 2):
        assert_uncorrelated(a, b, "seed 2")


def test_without_noise_the_truth_is_reported() -> None:
    places = aer_to_enu(np.array([0.0, 123.0, 359.0]), np.array([-5.0, 0.0, 70.0]), 400.0)
    _, plots = RangeGate(range_max_m=1e3, sigma_m=0.0).observe(
        targets(places), np.random.default_rng(3)
    )
    np.testing.assert_allclose(plots.range_m, plots.true_range_m)
    np.testing.assert_allclose(plots.azimuth_deg, plots.true_azimuth_deg)
    np.testing.assert_allclose(plots.elevation_deg, plots.true_elevation_deg)


def test_stated_and_predicted_errors_are_the_noise_over_the_range() -> None:
    """Seed 4."""
    gate = RangeGate(range_max_m=2000.0, sigma_m=3.0)
    there = targets(np.tile(aer_to_enu(40.0, 50.0, 900.0), (5000, 1)))
    _, plots = gate.observe(there, np.random.default_rng(4))
    predicted = gate.predict(there)
    for sigma in (plots.sigma_range_m, predicted.sigma_range_m):
        assert_standard_normal((plots.range_m - 900.0) / sigma, "range, seed 4")
    for sigma in (plots.sigma_azimuth_deg, predicted.sigma_azimuth_deg):
        assert_standard_normal((plots.azimuth_deg - 40.0) / sigma, "azimuth, seed 4")
    for sigma in (plots.sigma_elevation_deg, predicted.sigma_elevation_deg):
        assert_standard_normal((plots.elevation_deg - 50.0) / sigma, "elevation, seed 4")


def test_prediction_is_certain_within_and_none_beyond() -> None:
    predicted = RangeGate(range_max_m=1000.0, sigma_m=3.0).predict(
        targets(aer_to_enu(0.0, 5.0, np.array([10.0, 1000.0, 1000.1])))
    )
    assert predicted.pd.tolist() == [1.0, 1.0, 0.0]
    assert np.isnan(predicted.snr).all()


coordinates = st.floats(-1e6, 1e6)


@given(
    st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=5),
    st.floats(1e-6, 1e9),
    st.floats(0, 1e9),
)
def test_whatever_the_parameters_the_plots_of_the_gate_are_its_drones(
    places: list[tuple[float, float, float]], range_max_m: float, sigma_m: float
) -> None:
    there = targets(places)
    looks, plots = RangeGate(range_max_m=range_max_m, sigma_m=sigma_m).observe(
        there, np.random.default_rng(6)
    )
    range_m = enu_to_aer(there.position_enu_m)[2]
    inside = (range_m > 0) & (range_m <= range_max_m)
    assert looks.drone.tolist() == plots.drone.tolist() == there.drone[inside].tolist()
    assert np.isfinite(plots.range_m).all()


def test_the_mean_place_is_that_of_many_measurements() -> None:
    """Noise across the line of sight makes ranges longer, and elevations lower, on average."""
    n, at_m = 40_000, aer_to_enu(180.0, 40.0, 100.0)
    gate = RangeGate(range_max_m=1000.0, sigma_m=20.0)
    _, plots = gate.observe(targets(np.broadcast_to(at_m, (n, 3))), np.random.default_rng(1))
    expected = gate.mean_place(*(np.array([x]) for x in enu_to_aer(at_m)))
    measured = plots.azimuth_deg, plots.elevation_deg, plots.range_m
    for mean, values in zip(expected, measured, strict=True):
        third_order = 2 * (20.0 / 100.0) ** 3 * np.std(values)
        error = 4 * np.std(values) / np.sqrt(n)
        assert abs(values.mean() - mean[0]) < error + third_order
    assert expected[2][0] == pytest.approx(104.0)
