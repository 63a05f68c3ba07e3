"""Two microphone arrays through the whole road: places and covariances of what both hear.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.significance import assert_law

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import FALSE_ALARM
from plotfeed.testing import START_NS, flown, fly, held, scene, staring, waypoint

APART_M = 150.0


def pair(**changes: Any) -> dict[str, Any]:
    usual = {
        "id": "pair", "type": "acoustic_pair", "scan": staring(), "noise_db": 0.0,
        "sensitivity_db": 32.0, "microphones": 8, "absorption_db_per_km": 5.0,
        "range_max_m": 800.0, "azimuth_beamwidth_deg": 40.0, "azimuth_floor_deg": 0.3,
        "second_array": {"east_m": APART_M, "north_m": 0.0, "above_site_m": 0.0},
    }  # fmt: skip
    return usual | changes


@cache
def one_at_a_time(azimuth_deg: float, range_m: float, power_db: float) -> SimulatedSensor:
    drone = held("d", azimuth_deg, 0.1, range_m, sound_power_db=power_db)
    return simulate(scene([pair()], [drone], seed=81), 300, start_utc_ns=START_NS)["pair"]


@pytest.mark.parametrize(("azimuth_deg", "range_m"), [(30.0, 140.0), (-40.0, 100.0)])
def test_places_scatter_by_the_stated_covariance(azimuth_deg: float, range_m: float) -> None:
    """The normalised square of errors is chi-square of two degrees of freedom, to first order."""
    plots = one_at_a_time(azimuth_deg, range_m, 115.0).plots
    assert len(plots) > 250
    found = aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m)[:, :2]
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)[:, :2]
    east, north = (found - true).T
    across = plots.covariance_east_north_m2
    determinant = plots.covariance_east_m2 * plots.covariance_north_m2 - across**2
    square = plots.covariance_north_m2 * east**2 + plots.covariance_east_m2 * north**2
    assert_law((square - 2 * across * east * north) / determinant, lambda x: 1 - np.exp(-x / 2))


def test_two_drones_make_ghosts_where_their_bearings_cross() -> None:
    drones = [
        held(f"d{i}", a, 0.1, 220.0, sound_power_db=125.0) for i, a in enumerate((10.0, 55.0))
    ]
    plots = simulate(scene([pair()], drones, seed=82), 60, start_utc_ns=START_NS)["pair"].plots
    ghosts = plots.rows(plots.drone == FALSE_ALARM)
    assert len(ghosts) == pytest.approx(len(plots) / 3, rel=0.1)
    first = aer_to_enu(np.array([10.0, 55.0]), 0.1, 220.0)[:, :2]
    toward = first - [APART_M, 0.0]
    ghost_m = APART_M * toward[0, 1] / (toward[0, 1] * np.tan(np.radians(55)) - toward[0, 0])
    expected_m = ghost_m / np.cos(np.radians(55))
    if expected_m > 0:
        of_second = ghosts.rows(np.abs(ghosts.azimuth_deg - 55) < 20)
        assert np.median(of_second.range_m) == pytest.approx(expected_m, rel=0.05)


def test_a_drone_that_moves_is_placed_where_bearings_of_two_times_cross() -> None:
    """At 20 m/s past arrays 300 and 450 m away, up to 26 m behind where it is."""
    path = (waypoint(0.0, 2.0, 300.0), waypoint(80.0, 2.0, 1200.0))
    drone = flown("d", *path, speed_m_s=20.0, sound_power_db=125.0)
    sharp = pair(azimuth_floor_deg=0.0, azimuth_beamwidth_deg=1.0)
    plots = simulate(scene([sharp], [drone], seed=83), 12, start_utc_ns=START_NS)["pair"].plots
    assert len(plots) > 5
    found = aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m)[:, :2]
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)[:, :2]
    lag_m = np.linalg.norm(found - true, axis=1)
    assert (lag_m > 8).all()
    assert (lag_m < 45).all()


def test_beams_in_elevation_give_a_height() -> None:
    drone = held("d", 30.0, 25.0, 200.0, sound_power_db=125.0)
    tall = pair(elevation_beamwidth_deg=20.0, elevation_floor_deg=0.3, report=["plots", "sapient"])
    plots = fly(scene([tall], [drone], seed=84), 40).plots("pair")
    late = plots.rows(plots.time_utc_ns > START_NS + 2_000_000_000)
    assert len(late) > 30
    assert late.range_m.mean() == pytest.approx(200.0, abs=4)
    assert late.elevation_deg.mean() == pytest.approx(25.0, abs=1)
    error = (late.elevation_deg - late.true_elevation_deg) / late.sigma_elevation_deg
    assert np.std(error) < 1.6


def test_category_015_has_its_ranges() -> None:
    drone = held("d", 30.0, 0.1, 140.0, sound_power_db=115.0)
    road = fly(scene([pair()], [drone], seed=85), 5)
    records = road.records("pair", 15)
    plots = road.plots("pair")
    ranges_m = [float(record.get("I015/625/R")) for record in records]
    np.testing.assert_allclose(ranges_m, plots.range_m, atol=0.06)
    assert {record.get("I015/020/MOMU") for record in records} == {0}


def test_a_second_array_that_stands_too_near_or_too_far_is_warned_of() -> None:
    for east_m, words in ((10.0, "less than a twentieth"), (2000.0, "little in common")):
        place = {"east_m": east_m, "north_m": 0.0, "above_site_m": 0.0}
        made = scene([pair(second_array=place)], seed=1)
        assert words in " ".join(made.sensor[0].warnings(made.scene.site))
    with pytest.raises(SceneError, match="second_array"):
        scene([{k: v for k, v in pair().items() if k != "second_array"}], seed=1)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"bias": {"range_offset_m": 5.0}}, "bias.range_offset_m: not modelled of two arrays"),
        ({"drift": {"time_constant_s": 9.0, "sigma_range_m": 5.0}}, "drift.sigma_range_m: not"),
    ],
)
def test_errors_of_ranges_which_arrays_do_not_measure_are_refused(
    keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(SceneError, match="not modelled of two arrays") as caught:
        scene([pair(**keys)], seed=1)
    assert message.partition(": ")[2] in str(caught.value)
    scene([pair(bias={"azimuth_offset_deg": 5.0, "time_offset_s": 1.0})], seed=1)
