"""What a sensor reads in place of what it finds."""

from __future__ import annotations

import numpy as np

from plotfeed.models.chance import Chance
from plotfeed.models.effects.readings import Drift, Readings

S = 1_000_000_000
TIMES_NS = np.array([5, 5, 9, 5]) * S


def drifting(sigma_range_m: float, sigma_azimuth_deg: float) -> tuple[Readings, Drift]:
    drift = Drift(Chance(1, "radar"), step_ns=S, time_constant_ns=30 * S, n=2)
    return (
        Readings(
            range_scale=1e-3,
            range_offset_m=5.0,
            sigma_range_m=sigma_range_m,
            sigma_azimuth_deg=sigma_azimuth_deg,
            drift=drift,
        ),
        drift,
    )


def test_a_range_is_scaled_and_offset():
    readings = Readings(range_scale=-0.01, range_offset_m=3.0)
    assert readings.range_m(np.array([100.0, 200.0]), TIMES_NS[:2]).tolist() == [102.0, 201.0]
    azimuth_deg = np.array([1.0, 359.0])
    assert readings.azimuth_deg(azimuth_deg, TIMES_NS[:2]) is azimuth_deg


def test_drifts_are_those_of_the_time_and_of_each_quantity_its_own():
    readings, drift = drifting(2.0, 0.5)
    off = drift.at(TIMES_NS)
    read_m = readings.range_m(np.full(4, 1000.0), TIMES_NS)
    np.testing.assert_allclose(read_m, 1006.0 + 2.0 * off[:, 0], rtol=1e-15)
    read_deg = readings.azimuth_deg(np.full(4, 10.0), TIMES_NS)
    np.testing.assert_allclose(read_deg, 10.0 + 0.5 * off[:, 1], rtol=1e-15)
    assert read_m[0] == read_m[1] == read_m[3] != read_m[2]
    assert not np.allclose(off[:, 0], off[:, 1])


def test_what_does_not_drift_costs_no_draw():
    readings, _ = drifting(0.0, 0.0)
    np.testing.assert_allclose(readings.range_m(np.array([1000.0]), TIMES_NS[:1]), 1006.0, 1e-15)
    azimuth_deg = np.array([1.0])
    assert readings.azimuth_deg(azimuth_deg, TIMES_NS[:1]) is azimuth_deg
