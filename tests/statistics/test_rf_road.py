"""The RF sensor's messages against closed forms, worked out here from the scene's numbers.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaincc, gammainccinv
from support.significance import (
    Array,
    assert_counts,
    assert_law,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, held, scene, staring, waypoint

C_M_S = 299_792_458.0
NOISE_DBM = 10 * np.log10(1.380649e-23 * 290.0 * 1e6) + 30 + 6
SAMPLES = 1000
PFA = 1e-6
ELEVATION_DEG = 5.0
CONTROL = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0, "kind": "control"}
VIDEO = {"frequency_hz": 2.46e9, "bandwidth_hz": 2e6, "eirp_dbm": 23.0, "kind": "video"}
REMOTE_ID = {
    "frequency_hz": 2.437e9,
    "bandwidth_hz": 1e6,
    "eirp_dbm": 15.0,
    "kind": "remote-id",
    "identity": "1596F3",
}


def finder(**changes: Any) -> dict[str, Any]:
    """A direction finder of 1 MHz channels over a town."""
    keys = {
        "id": "rf",
        "type": "rf",
        "scan": staring(),
        "frequency_min_hz": 2.40e9,
        "frequency_max_hz": 2.48e9,
        "channel_bandwidth_hz": 1e6,
        "integration_s": 1e-3,
        "gain_rx_dbi": 3.0,
        "loss_db": 1.0,
        "path_loss": {"kind": "log-distance", "exponent": 3.0, "reference_m": 100.0},
        "pfa": PFA,
        "range_max_m": 20_000.0,
        "baseline_m": 0.06,
        "azimuth_floor_deg": 0.0,
    }
    return keys | changes


def detector(**changes: Any) -> dict[str, Any]:
    """The same without directions."""
    keys = finder(id="omni", measures_azimuth=False)
    for of_directions in ("baseline_m", "azimuth_floor_deg"):
        del keys[of_directions]
    return keys | changes


def snr_db(range_m: Array, eirp_dbm: float = 20.0, frequency_hz: float = 2.44e9) -> Array:
    """Free space to 100 m, the cube of distance beyond."""
    loss_db = 20 * np.log10(4 * np.pi * 100 * frequency_hz / C_M_S) + 30 * np.log10(range_m / 100)
    return np.asarray(eirp_dbm + 3 - 1 - loss_db - NOISE_DBM)


def crossing(snr: Array) -> Array:
    """Probability that the energy of all samples crosses the threshold."""
    return np.asarray(gammaincc(SAMPLES, gammainccinv(SAMPLES, PFA) / (1 + snr)))


def pd(range_m: float) -> float:
    return float(crossing(10 ** (snr_db(np.array(range_m)) / 10)))


def reported(road: Feed, sensor: str = "rf") -> list[pb.Plot]:
    batches = [pb.PlotBatch.FromString(p) for p in road.payloads(f"{sensor}/plots")]
    return [plot for batch in batches for plot in batch.plots]


RANGES_M = (2e3, 7e3, 8e3, 8.4e3, 8.8e3, 9.2e3, 9.6e3, 10.4e3, 11.5e3, 14e3)
AT_EACH = 20
SCANS = 200


@cache
def rings(seed: int = 71, **changes: Any) -> Feed:
    drones = [
        held(f"{ring}-{i}", 18 * i + ring, ELEVATION_DEG, range_m - 0.005, emitters=[CONTROL])
        for ring, range_m in enumerate(RANGES_M)
        for i in range(AT_EACH)
    ]
    return fly(scene([finder(**changes)], drones, seed=seed), SCANS)


@pytest.mark.parametrize("ring", [0, 3, 5])
def test_bursts_that_miss_the_scan_are_missed(ring: int) -> None:
    road = rings(72, duty_cycle=0.2, bursts_per_dwell=3)
    p, n = pd(RANGES_M[ring]) * (1 - 0.8**3), AT_EACH * SCANS
    found = np.char.startswith(road.plots("rf").drone, f"{ring}-").sum()
    assert_sum(found, n * p, n * p * (1 - p), f"{RANGES_M[ring]:.0f} m")


def test_scans_fare_independently() -> None:
    looks = rings().looks("rf")
    order = np.lexsort((looks.scan, looks.drone))
    excess = (looks.detected - looks.pd)[order]
    assert_uncorrelated(excess[:-1], excess[1:], "a drone's next scan")


EIRPS_DBM = (0.0, 3.0, 8.0, 20.0, 40.0)
FOUND_M = 800.0


@cache
def strengths() -> Feed:
    """Mean signal-to-noise ratios of a sample from -7 to 33 dB."""
    drones = [
        held(f"{k}-{i}", 17 * i + k, ELEVATION_DEG, FOUND_M, emitters=[CONTROL | {"eirp_dbm": p}])
        for k, p in enumerate(EIRPS_DBM)
        for i in range(AT_EACH)
    ]
    return fly(scene([finder(loss_db=4.0)], drones, seed=73), 120)


STRENGTHS = pytest.mark.parametrize("k", range(len(EIRPS_DBM)))


@STRENGTHS
def test_bearing_errors_are_normal_with_the_sigma_of_their_detection(k: int) -> None:
    """Noise of a phase difference over 2 pi d / lambda, S as the plot itself has it."""
    everything = strengths().plots("rf")
    plots = everything.rows(np.char.startswith(everything.drone, f"{k}-"))
    assert len(plots) > 1000
    snr = 10 ** (plots.snr_db / 10)
    phase_rad = np.sqrt((1 + 1 / (2 * snr)) / (snr * SAMPLES))
    sigma_deg = np.degrees(phase_rad * C_M_S / 2.44e9 / (2 * np.pi * 0.06))
    np.testing.assert_allclose(plots.sigma_azimuth_deg, sigma_deg, rtol=1e-9)
    error_deg = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)
    assert_standard_normal(error_deg / sigma_deg, f"{EIRPS_DBM[k]:.0f} dBm")


@STRENGTHS
def test_signal_of_plots_is_the_energy_of_those_over_the_threshold(k: int) -> None:
    everything = strengths().plots("rf")
    plots = everything.rows(np.char.startswith(everything.drone, f"{k}-"))
    snr = 10 ** ((float(snr_db(np.array(FOUND_M + 0.005), EIRPS_DBM[k])) - 3) / 10)
    energies = SAMPLES * (1 + 10 ** (plots.snr_db / 10))
    above = float(crossing(np.array(snr)))
    assert_law(
        energies, lambda x: 1 - gammaincc(SAMPLES, x / (1 + snr)) / above, f"{EIRPS_DBM[k]:.0f} dBm"
    )
    np.testing.assert_allclose(plots.amplitude_dbm - plots.snr_db, NOISE_DBM, atol=1e-6)


def test_the_floor_of_two_degrees_is_there_unless_the_scene_says_otherwise() -> None:
    sensor = finder(baseline_m=1.0)
    del sensor["azimuth_floor_deg"]
    drones = [held(str(i), 18 * i, ELEVATION_DEG, 300.0, emitters=[CONTROL]) for i in range(20)]
    plots = fly(scene([sensor], drones, seed=74), 100).plots("rf")
    error_deg = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)
    assert_standard_normal(error_deg / 2.0, "floor")


@cache
def two_and_two() -> Feed:
    """Two drones of two and three emitters, a direction finder and a detector that reads."""
    drones = [
        held("a", 40.0, ELEVATION_DEG, 400.0, emitters=[CONTROL, REMOTE_ID]),
        held("b", 220.0, ELEVATION_DEG, 500.0, emitters=[VIDEO, CONTROL | {"frequency_hz": 9e8}]),
        held("silent", 100.0, ELEVATION_DEG, 100.0),
    ]
    reading = detector(decodes=["remote-id"], position_enu_m=(50.0, -20.0, 3.0))
    return fly(scene([finder(classifies=True), reading], drones, seed=75), 50)


def test_every_emitter_in_the_band_is_reported_on_its_channel() -> None:
    looks = two_and_two().looks("rf")
    assert {*zip(looks.drone, looks.channel, strict=True)} == {("a", 0), ("a", 1), ("b", 0)}
    for plot in reported(two_and_two()):
        near = abs(wrap_180(plot.azimuth_deg - 40.0)) < 30
        expected = {0: "control", 1: "remote-id"}[plot.channel] if near else "video"
        assert plot.kind == expected
        assert not plot.identity
    assert len(reported(two_and_two())) == len(looks) == 150


def test_a_detector_that_reads_has_no_direction_but_the_identity() -> None:
    plots = reported(two_and_two(), "omni")
    assert len(plots) == 150
    for plot in plots:
        for absent in ("azimuth_deg", "sigma_azimuth_deg", "elevation_deg", "range_m"):
            assert not plot.HasField(absent)
    read = [plot for plot in plots if plot.identity]
    assert len(read) == 50
    assert {(plot.kind, plot.identity, plot.channel) for plot in read} == {
        ("remote-id", "1596F3", 1)
    }
    assert {plot.kind for plot in plots if not plot.identity} == {""}


def test_a_drone_on_its_way_is_heard_where_it_is() -> None:
    """Radio takes no time: measured against the drone of that instant."""
    path = (waypoint(10.0, ELEVATION_DEG, 600.0), waypoint(50.0, ELEVATION_DEG, 600.0))
    drone = flown("d", *path, speed_m_s=20.0, repeat=False, emitters=[CONTROL])
    road = fly(scene([finder(baseline_m=10.0)], [drone], seed=76), 20)
    looks, plots = road.looks("rf"), road.plots("rf")
    assert len(plots) == len(looks) == 20
    np.testing.assert_allclose(plots.true_azimuth_deg, looks.azimuth_deg, rtol=1e-12)
    np.testing.assert_allclose(plots.azimuth_deg, looks.azimuth_deg, atol=0.05)
    np.testing.assert_allclose(np.diff(plots.time_utc_ns), NS)
    assert plots.time_utc_ns.min() > START_NS


CASES = pytest.mark.parametrize(
    ("changes", "low", "span", "cells"),
    [
        ({}, 0.0, 360.0, 80),
        ({"instantaneous_bandwidth_hz": 20e6, "azimuth_beamwidth_deg": 45.0}, 0.0, 360.0, 160),
        (
            {"azimuth_min_deg": -60.0, "azimuth_max_deg": 30.0, "azimuth_beamwidth_deg": 22.5},
            -60.0,
            90.0,
            320,
        ),
    ],
)


@CASES
def test_false_alarms_are_binomial_over_channels_and_beams_and_uniform(
    changes: dict[str, Any], low: float, span: float, cells: int
) -> None:
    road = fly(scene([finder(pfa=0.05, **changes)], [], seed=77), 500)
    counts = np.array(
        [len(pb.PlotBatch.FromString(payload).plots) for payload in road.payloads("rf/plots")]
    )
    assert len(counts) == 500
    assert_counts(counts, stats.binom(cells, 0.05), f"{cells} cells")
    plots = road.plots("rf")
    assert (plots.drone == "").all()
    assert_law((plots.azimuth_deg - low) % 360 / span, "uniform", f"{cells} cells")
    energies = SAMPLES * (1 + 10 ** (plots.snr_db / 10))
    assert_law(energies, lambda x: 1 - gammaincc(SAMPLES, x) / 0.05, "energy of noise")
    assert {(plot.kind, plot.identity) for plot in reported(road)} == {("", "")}


def test_false_alarms_of_a_detector_have_no_direction() -> None:
    road = fly(scene([detector(pfa=0.05)], [], seed=78), 500)
    counts = np.array(
        [len(pb.PlotBatch.FromString(payload).plots) for payload in road.payloads("omni/plots")]
    )
    assert_counts(counts, stats.binom(80, 0.05))
    assert not any(plot.HasField("azimuth_deg") for plot in reported(road, "omni"))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"frequency_max_hz": 2.3e9}, "frequency_min_hz"),
        ({"instantaneous_bandwidth_hz": 90e6}, "instantaneous_bandwidth_hz"),
        ({"channel_bandwidth_hz": 90e6}, "channel_bandwidth_hz"),
        ({"integration_s": 200.0}, "integration_s"),
        ({"azimuth_max_deg": -200.0}, "azimuth_max_deg"),
        ({"duty_cycle": 0.0}, "duty_cycle"),
        ({"path_loss": {"kind": "log-distance"}}, "path_loss.exponent"),
        ({"path_loss": {"kind": "friis", "exponent": 3.0}}, "path_loss.exponent"),
        ({"path_loss": {"kind": "two-ray"}}, "path_loss.kind"),
    ],
)
def test_a_wrong_key_is_named(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene([finder(**changes)], seed=1)
    assert [name for name, _ in refused.value.problems] == [f"sensor[0].{key}"]


def test_a_direction_finder_needs_a_baseline() -> None:
    sensor = finder()
    del sensor["baseline_m"]
    with pytest.raises(SceneError, match=r"sensor\[0\]\.baseline_m of 'rf': missing"):
        scene([sensor], seed=1)


def test_friis_is_the_default() -> None:
    without = finder()
    del without["path_loss"]
    parts = scene([without, finder(id="b", path_loss={"kind": "friis"})], seed=1)
    models = [sensor.model(parts.scene.site) for sensor in parts.sensor]
    assert models[0] == models[1]
    assert models[0].path_loss_exponent == 2.0


def test_warnings_are_of_long_integration_and_of_unused_keys() -> None:
    sensors = [
        finder(azimuth_floor_deg=2.0),
        detector(integration_s=1.5),
        detector(id="c", baseline_m=0.3),
    ]
    parts = scene(sensors, seed=1)
    good, slow, unused = (list(sensor.warnings(parts.scene.site)) for sensor in parts.sensor)
    assert not good
    assert slow[0].startswith("integration_s is 1.5, longer than a scan")
    assert unused[0].startswith("baseline_m: not used")
