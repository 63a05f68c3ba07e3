"""The passive radar's messages against its closed forms, worked out here from the scene's numbers.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from scipy import stats
from support.significance import (
    Array,
    assert_counts,
    assert_law,
    assert_mean,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import Feed, FeedTable, fly, held, scene, staring, waypoint

LIGHT_M_S = 299_792_458.0
AZIMUTH_DEG = 45.0  # Of the drones


def tv(name: str, azimuth_deg: float, baseline_m: float, **more: Any) -> dict[str, Any]:
    place = waypoint(azimuth_deg, 0.2, baseline_m)
    paper = {"id": name, "erp_w": 10e3, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6}
    return paper | {"place": place} | more


EAST = tv("east", 135.0, 20e3)
PLACES_M = {"east": (135.0, 20e3), "near": (250.0, 6e3), "weak": (10.0, 35e3)}
THREE = [
    EAST,
    tv("near", *PLACES_M["near"], erp_w=50.0, frequency_hz=200e6, bandwidth_hz=1.5e6),
    tv("weak", *PLACES_M["weak"], erp_w=40e3, external_noise_db=3.0),
]


def passive(**changes: Any) -> dict[str, Any]:
    """The paper's section 4."""
    paper = {
        "id": "passive",
        "type": "passive_radar",
        "scan": staring(),
        "transmitters": [EAST],
        "gain_rx_dbi": 2.0,
        "azimuth_beamwidth_deg": 2.0,
        "bistatic_range_floor_m": 0.0,
        "azimuth_floor_deg": 0.0,
        "integration_s": 0.3,
        "external_noise_db": -4.45,
        "azimuth_min_deg": 15.0,
        "azimuth_max_deg": 75.0,
        "range_max_m": 10_000.0,
    }
    return paper | changes


def transmitter_enu_m(transmitter: dict[str, Any]) -> Array:
    azimuth_deg, baseline_m = PLACES_M[transmitter["id"]]
    return np.asarray(aer_to_enu(azimuth_deg, 0.2, baseline_m))


def channels(road: Feed) -> Array:
    """Of the plots, in their order."""
    batches = [pb.PlotBatch.FromString(p) for p in road.payloads("passive/plots")]
    return np.array([plot.channel for batch in batches for plot in batch.plots])


RANGES_M = (1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0, 6000.0, 7000.0, 9000.0)
AT_EACH = 20
SCANS = 200


@cache
def approach() -> Feed:
    drones = [
        held(f"{range_m}:{i}", AZIMUTH_DEG, 2.0, range_m, rcs_m2=0.01)
        for range_m in RANGES_M
        for i in range(AT_EACH)
    ]
    level = passive(expected_height_m=0.0, sigma_height_m=0.0)
    return fly(scene([level], drones, seed=61), SCANS)


def at_range(table: FeedTable, range_m: float) -> FeedTable:
    return table.rows(np.char.startswith(table.drone, f"{range_m}:"))


def measured_and_true_excess_m(
    plots: FeedTable, transmitter: dict[str, Any]
) -> tuple[Array, Array]:
    true_enu_m = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    at_enu_m = transmitter_enu_m(transmitter)
    there_m = np.linalg.norm(true_enu_m - at_enu_m, axis=-1)
    return plots.bistatic_range_m, there_m + plots.true_range_m - np.linalg.norm(at_enu_m)


@pytest.mark.parametrize("range_m", [1000.0, 3000.0, 5000.0])
def test_places_scatter_about_the_biased_place_as_their_covariance_states(range_m: float) -> None:
    """2 degrees up; whitened deviations from the noise-free flat solution are chi-square of 2."""
    plots = at_range(approach().plots("passive"), range_m)
    excess_m = float(measured_and_true_excess_m(plots, EAST)[1][0])
    baseline_m = 20e3
    outwards = np.asarray(aer_to_enu(AZIMUTH_DEG, 0.0, 1.0))
    cosine = float(outwards @ transmitter_enu_m(EAST)) / baseline_m
    flat_m = excess_m * (excess_m + 2 * baseline_m) / (2 * (excess_m + baseline_m * (1 - cosine)))
    de, dn, _ = np.moveaxis(
        aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m) - flat_m * outwards, -1, 0
    )
    a, b, c = plots.covariance_east_m2, plots.covariance_north_m2, plots.covariance_east_north_m2
    square = (b * de**2 - 2 * c * de * dn + a * dn**2) / (a * b - c**2)
    assert_law(square, stats.chi2(2).cdf, "whitened")
    assert plots.range_m.mean() - range_m * np.cos(np.radians(2)) == pytest.approx(
        flat_m - range_m * np.cos(np.radians(2)), abs=2.0
    )


def test_places_of_drones_of_usual_heights_err_as_stated_in_every_format() -> None:
    """The scene says nothing of heights: 60 m, give or take 35 m. Two squares of a mean of 1."""
    rng = np.random.default_rng(7)
    azimuth_deg, ground_m = rng.uniform(16, 74, 1500), rng.uniform(300, 3000, 1500)
    above_m = 60 + 35 * rng.standard_normal(1500)
    elevation_deg = np.degrees(np.arctan2(above_m, ground_m))
    places = zip(azimuth_deg, elevation_deg, np.hypot(ground_m, above_m), strict=True)
    drones = [held(f"{i}", *map(float, place), rcs_m2=1.0) for i, place in enumerate(places)]
    sensor = passive(report=["plots", "sapient"])
    road = fly(scene([sensor], drones, seed=64), 3)
    plots = road.plots("passive")
    plots = plots.rows(plots.drone != "")
    assert len(plots) > 3000
    true_m = plots.true_range_m * np.cos(np.radians(plots.true_elevation_deg))
    true_enu_m = aer_to_enu(plots.true_azimuth_deg, 0.0, true_m)
    error_m = aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m) - true_enu_m
    de, dn, _ = np.moveaxis(error_m, -1, 0)
    a, b, c = plots.covariance_east_m2, plots.covariance_north_m2, plots.covariance_east_north_m2
    square = (b * de**2 - 2 * c * de * dn + a * dn**2) / (a * b - c**2)
    assert_mean(square, 2.0, "position")
    assert_mean((plots.range_m - true_m) / plots.sigma_range_m, 0.0, "distance")
    reports = [SapientMessage.FromString(p) for p in road.payloads("passive/sapient")]
    told = [m.detection_report.range_bearing for m in reports if m.HasField("detection_report")]
    np.testing.assert_array_equal(
        [[place.range, place.range_error] for place in told if place.HasField("range")],
        np.stack([plots.range_m, plots.sigma_range_m], axis=1),
    )


def test_what_a_passive_radar_does_not_measure_is_absent() -> None:
    plots = approach().plots("passive")
    for absent in ("elevation_deg", "height_m", "sigma_elevation_deg"):
        assert np.isnan(plots.columns[absent]).all()
    assert (channels(approach()) == 0).all()


ALARM_SCANS = 1200
PFA = 1e-3


@cache
def alarms() -> Feed:
    sensor = passive(transmitters=THREE, pfa=PFA)
    return fly(scene([sensor], seed=62), ALARM_SCANS - 0.5)


def limits_m(transmitter: dict[str, Any], azimuth_deg: Array) -> Array:
    """The bistatic range at the instrumented range in those directions, or the instrumented."""
    points_enu_m = np.asarray(aer_to_enu(azimuth_deg, 0.0, 10_000.0))
    at_enu_m = transmitter_enu_m(transmitter)
    there_m = np.linalg.norm(points_enu_m - at_enu_m, axis=-1)
    return np.minimum(there_m + 10_000.0 - np.linalg.norm(at_enu_m), 10_000.0)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_false_alarms_of_a_channel_are_binomial_and_uniform_where_they_have_a_place(
    channel: int,
) -> None:
    transmitter = THREE[channel]
    cells = round(10_000 * transmitter["bandwidth_hz"] / LIGHT_M_S) * 30
    grid_deg = 15 + 60 * (np.arange(6000) + 0.5) / 6000
    depth_m = limits_m(transmitter, grid_deg)
    p = PFA * depth_m.mean() / 10_000
    plots = alarms().plots("passive").rows(channels(alarms()) == channel)
    scans = np.unique([b.scan for b in alarms().ledgers])
    counts = np.bincount(plots.scan - scans[0], minlength=len(scans))
    assert len(counts) == ALARM_SCANS - 1
    assert_sum(counts.sum(), len(counts) * cells * p, len(counts) * cells * p, "number")
    if counts.mean() > 3:
        assert_counts(counts, stats.binom(cells, p), "law")
    assert_law(plots.bistatic_range_m / limits_m(transmitter, plots.azimuth_deg), "uniform")
    below = np.concatenate([[0.0], np.cumsum(depth_m)]) / depth_m.sum()
    edges_deg = np.linspace(15, 75, 6001)
    assert_law(np.interp(plots.azimuth_deg, edges_deg, below), "uniform", "azimuth")


def test_alarms_of_one_channel_do_not_know_of_the_others() -> None:
    plots, channel = alarms().plots("passive"), channels(alarms())
    counts = [np.bincount(plots.scan[channel == c] - plots.scan.min()) for c in (0, 2)]
    n = min(map(len, counts))
    assert_uncorrelated(counts[0][:n], counts[1][:n], "channels")
    assert_uncorrelated(counts[0][: n - 1], counts[0][1:n], "scans")


@cache
def by_three() -> Feed:
    drones = [held(f"d{i}", AZIMUTH_DEG, 1.0, 3500.0, rcs_m2=0.02) for i in range(20)]
    return fly(scene([passive(transmitters=THREE)], drones, seed=63), SCANS)


def test_each_transmitter_makes_plots_of_its_own_and_all_point_at_the_drone() -> None:
    looks, plots, channel = (
        by_three().looks("passive"),
        by_three().plots("passive"),
        channels(by_three()),
    )
    for c, transmitter in enumerate(THREE):
        mine = plots.rows((channel == c) & (plots.drone != ""))
        assert len(mine) == looks.detected[looks.channel == c].sum() > 500
        cell_m = LIGHT_M_S / transmitter["bandwidth_hz"]
        power = 10 ** (mine.snr_db / 10)
        np.testing.assert_allclose(
            mine.sigma_bistatic_range_m, cell_m / (1.63 * np.sqrt(2 * power))
        )
        measured_m, true_m = measured_and_true_excess_m(mine, transmitter)
        assert_standard_normal((measured_m - true_m) / mine.sigma_bistatic_range_m, f"channel {c}")
        assert np.median(mine.range_m) == pytest.approx(3500, abs=60)


def test_in_a_noise_environment_the_scene_flies_or_is_refused_with_a_reason() -> None:
    fm = tv("near", 250.0, 6e3, frequency_hz=98e6, bandwidth_hz=150e3)
    quiet = passive(transmitters=[fm], noise_environment="quiet-rural")
    del quiet["external_noise_db"]
    assert len(scene([quiet], seed=64).sensor) == 1
    quiet["transmitters"] = [EAST]
    with pytest.raises(SceneError, match=r"quiet-rural noise from 0.3 to 100 MHz, not at the 600"):
        scene([quiet], seed=64)
    for changes, reason in (
        ({"noise_environment": "city"}, "leave it out"),
        ({"external_noise_db": None}, "external_noise_db of 'passive': needed"),
        ({"gain_rx_dbi": None}, "gain_rx_dbi of 'passive': needed"),
        ({"sidelobe_db": 22.0}, "sidelobe_db of 'passive': input should be less than"),
        ({"transmitters": [EAST, EAST]}, "used twice"),
        ({"transmitters": []}, "transmitters"),
        ({"scan": {"kind": "rotating", "period_s": 1.0}}, "scan"),
    ):
        sensor = {k: v for k, v in (passive() | changes).items() if v is not None}
        with pytest.raises(SceneError, match=reason):
            scene([sensor], seed=64)


def test_check_warns_of_directions_along_a_baseline_and_of_a_long_integration() -> None:
    floors = {"bistatic_range_floor_m": 2.0, "azimuth_floor_deg": 0.2}
    wide = passive(azimuth_min_deg=100.0, azimuth_max_deg=170.0, integration_s=2.0, **floors)
    flown = scene([wide, passive(id="narrow", **floors)], seed=65)
    site = flown.scene.site
    found = list(flown.sensor[0].warnings(site))
    assert len(found) == 2
    assert "integration_s is 2" in found[0]
    assert "transmitter east, at azimuth 135.0" in found[1]
    assert not list(flown.sensor[1].warnings(site))
