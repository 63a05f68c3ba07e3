"""The microphone array's messages against section 3.3's closed forms, written out here again.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.significance import (
    Array,
    assert_counts,
    assert_law,
    assert_standard_normal,
    assert_uncorrelated,
)

from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import SITE, START_NS, Feed, flown, fly, held, scene, staring

ELEVATION_DEG = 5.0
RANGES_M = (60.0, 80.0, 95.0, 105.0, 115.0, 125.0, 135.0, 150.0, 170.0, 200.0)
AT_EACH = 20
SCANS = 200
SOUND_POWERS_DB = (80.0, 88.0, 96.0, 108.0, 120.0)
BEAMWIDTH_DEG = 40.0


def microphones(**changes: Any) -> dict[str, Any]:
    """Section 4's, on the ground of the site."""
    paper = {
        "id": "mic",
        "type": "acoustic",
        "scan": staring(),
        "noise_db": 0.0,
        "sensitivity_db": 32.0,
        "microphones": 8,
        "absorption_db_per_km": 5.0,
        "range_max_m": 1000.0,
        "azimuth_beamwidth_deg": BEAMWIDTH_DEG,
        "azimuth_floor_deg": 0.0,
        "height_above_ground_m": 1.5,
    }
    return paper | changes


def snr_db(range_m: Array, sound_power_db: float = 80.0) -> Array:
    """Power, directivity, spreading, air, ground, barrier, the rest, and eight microphones."""
    lift_m = range_m * np.sin(np.radians(ELEVATION_DEG)) + 2 * 1.5  # twice the mean height
    ground_db = np.maximum(4.8 - lift_m / range_m * (17 + 300 / range_m), 0)
    level_db = sound_power_db + 3 - 20 * np.log10(range_m) - 11 - 0.005 * range_m - ground_db - 6
    return np.asarray(level_db + 10 * np.log10(8))


def started(road: Feed) -> tuple[Any, Any]:
    """Looks and plots once the first sounds have arrived from everywhere."""
    late = START_NS + 3_000_000_000
    looks, plots = road.looks("mic"), road.plots("mic")
    return looks.rows(looks.time_utc_ns > late), plots.rows(plots.time_utc_ns > late)


@cache
def rings() -> Feed:
    drones = [
        held(f"{ring}-{i}", 18 * i + ring, ELEVATION_DEG, range_m, sound_power_db=80.0)
        for ring, range_m in enumerate(RANGES_M)
        for i in range(AT_EACH)
    ]
    return fly(scene([microphones(pfa=1e-3)], drones, seed=61), SCANS)


def test_scans_and_drones_fare_independently() -> None:
    looks, _ = started(rings())
    order = np.lexsort((looks.scan, looks.drone))
    excess = (looks.detected - looks.pd)[order]
    assert_uncorrelated(excess[:-1], excess[1:], "a drone's next scan")
    by_scan = excess[np.lexsort((looks.drone[order], looks.scan[order]))]
    assert_uncorrelated(by_scan[:-1], by_scan[1:], "a scan's next drone")


@cache
def loud() -> Feed:
    drones = [
        held(f"{level}-{i}", 17 * i + level, ELEVATION_DEG, 100.0, sound_power_db=power_db)
        for level, power_db in enumerate(SOUND_POWERS_DB)
        for i in range(AT_EACH)
    ]
    return fly(scene([microphones()], drones, seed=62), 120)


@pytest.mark.parametrize("level", range(len(SOUND_POWERS_DB)))
def test_bearing_errors_are_normal_with_the_sigma_of_their_signal(level: int) -> None:
    _, plots = started(loud())
    mine = plots.rows(np.char.startswith(plots.drone, f"{level}-"))
    assert len(mine) > 1000
    snr = 10 ** (float(snr_db(np.array(100.0), SOUND_POWERS_DB[level])) / 10)
    sigma_deg = BEAMWIDTH_DEG / (1.6 * np.sqrt(2 * snr))
    np.testing.assert_allclose(mine.sigma_azimuth_deg, sigma_deg, rtol=1e-4)
    error_deg = wrap_180(mine.azimuth_deg - mine.true_azimuth_deg)
    assert_standard_normal(error_deg / sigma_deg, f"{SOUND_POWERS_DB[level]:.0f} dB")


def test_only_bearings_are_reported() -> None:
    _, plots = started(loud())
    for absent in ("range_m", "elevation_deg", "height_m", "sigma_range_m", "amplitude_dbm"):
        assert np.isnan(plots.columns[absent]).all()


def crossing(name: str, north_m: float, speed_m_s: float) -> dict[str, Any]:
    """Eastward past the array, 5 m up."""
    ends = (SITE.to_geodetic(np.array([east_m, north_m, 5.0])) for east_m in (-150.0, 150.0))
    keys = ("latitude_deg", "longitude_deg", "height_m")
    path = [dict(zip(keys, map(float, end), strict=True)) for end in ends]
    return flown(name, *path, speed_m_s=speed_m_s, repeat=False, sound_power_db=150.0)


@pytest.mark.parametrize(("temperature_c", "sound_m_s"), [(20.0, 343.2), (0.0, 331.3)])
@pytest.mark.parametrize("speed_m_s", [20.0, 40.0])
def test_bearings_of_a_crossing_drone_lag_by_its_speed_over_that_of_sound(
    temperature_c: float, sound_m_s: float, speed_m_s: float
) -> None:
    """3.3 degrees at 20 m/s, near and far; where the drone passes closest."""
    sensor = microphones(scan=staring(0.1), temperature_c=temperature_c)
    distances_m = {"near": 100.0, "far": 500.0, "farthest": 900.0}
    drones = [crossing(name, north_m, speed_m_s) for name, north_m in distances_m.items()]
    road = fly(scene([sensor], drones, seed=64), 300 / speed_m_s)
    everything = road.plots("mic")
    for name, north_m in distances_m.items():
        plots = everything.rows(everything.drone == name)
        off_deg = wrap_180(plots.true_azimuth_deg)  # from the closest point, now
        lag_deg = wrap_180(plots.true_azimuth_deg - plots.azimuth_deg)
        exactly_deg = np.degrees(np.arcsin(speed_m_s / sound_m_s * np.cos(np.radians(off_deg))))
        np.testing.assert_allclose(lag_deg, exactly_deg, atol=0.02)
        passing = np.abs(off_deg) < min(10.0, np.degrees(30 / north_m))
        assert passing.sum() >= 8
        expected_deg = np.degrees(np.arctan(speed_m_s / sound_m_s))
        assert lag_deg[passing].mean() == pytest.approx(expected_deg, rel=0.01)


def test_looks_of_a_crossing_drone_are_where_it_is_heard() -> None:
    road = fly(scene([microphones(scan=staring(0.1))], [crossing("d", 500.0, 20.0)], seed=65), 14)
    looks, plots = road.looks("mic"), road.plots("mic")
    np.testing.assert_allclose(wrap_180(plots.azimuth_deg - looks.azimuth_deg), 0, atol=0.01)
    heard_east_m = looks.range_m * np.sin(np.radians(looks.azimuth_deg))
    seconds_ago = looks.range_m / 343.2
    now_east_m = -150 + 20 * (looks.time_utc_ns - START_NS) / 1e9
    np.testing.assert_allclose(heard_east_m, now_east_m - 20 * seconds_ago, atol=0.05)
    left_ns = looks.time_utc_ns - np.rint(seconds_ago * 1e9).astype(np.int64)
    np.testing.assert_allclose(looks.emitted_utc_ns - left_ns, 0, atol=20_000)
    then_east_m = -150 + 20 * (looks.emitted_utc_ns - START_NS) / 1e9
    np.testing.assert_allclose(heard_east_m, then_east_m, atol=0.02)
    true_east_m = plots.true_range_m * np.sin(np.radians(plots.true_azimuth_deg))
    np.testing.assert_allclose(true_east_m, now_east_m, atol=0.05)


def test_a_drone_is_not_heard_before_its_first_sound_arrives() -> None:
    place = held("d", 10.0, ELEVATION_DEG, 900.0, sound_power_db=150.0)
    looks = fly(scene([microphones(scan=staring(0.1))], [place], seed=66), 5).looks("mic")
    first_s = (looks.time_utc_ns.min() - START_NS) / 1e9
    assert 900 / 343.2 <= first_s <= 900 / 343.2 + 0.11


def test_a_quiet_drone_is_not_heard_and_a_far_one_is_gated() -> None:
    drones = [
        held("quiet", 10.0, ELEVATION_DEG, 50.0, sound_power_db=-300.0),
        held("gone", 20.0, ELEVATION_DEG, 1000.5, sound_power_db=300.0),
        held("just", 30.0, ELEVATION_DEG, 999.5, sound_power_db=300.0),
    ]
    looks, plots = started(fly(scene([microphones()], drones, seed=67), 30))
    assert set(looks.drone) == {"quiet", "just"}
    assert set(plots.drone) == {"just"}


COVERS = pytest.mark.parametrize("cover", [(-180.0, 180.0), (300.0, 360.0), (-60.0, 100.0)])


@COVERS
def test_false_alarms_are_binomial_over_the_beams_and_uniform(cover: tuple[float, float]) -> None:
    low, span = cover[0], cover[1] - cover[0]
    sensor = microphones(
        pfa=0.07, azimuth_min_deg=low, azimuth_max_deg=cover[1], azimuth_beamwidth_deg=10.0
    )
    road = fly(scene([sensor], [], seed=68), 1500)
    batches = [pb.PlotBatch.FromString(p) for p in road.payloads("mic/plots")]
    counts = np.array([len(batch.plots) for batch in batches])
    assert len(counts) == 1500
    assert_counts(counts, stats.binom(round(span / 10), 0.07), f"{cover}")
    assert_uncorrelated(counts[:-1], counts[1:], "scan by scan")
    plots = road.plots("mic")
    assert (plots.drone == "").all()
    assert_law((plots.azimuth_deg - low) % 360 / span, "uniform", f"{cover}")
    assert_law(plots.snr_db - 32, "expon", "level over the sensitivity")
    assert np.isnan(plots.range_m).all()


def test_detections_do_not_change_with_the_false_alarms() -> None:
    there = [held("d", 10.0, ELEVATION_DEG, 120.0)]
    few, many = (
        fly(scene([microphones(pfa=pfa)], there, seed=69), 200).plots("mic") for pfa in (1e-9, 0.1)
    )
    assert len(many) > 2 * len(few)
    same = many.rows(many.drone == "d")
    np.testing.assert_array_equal(same.azimuth_deg, few.azimuth_deg[few.drone == "d"])


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"azimuth_max_deg": -180.0}, "sensor[0].azimuth_max_deg"),
        ({"range_max_m": 20_000.0}, "sensor[0].range_max_m"),
        ({"slope_per_db": 0.0}, "sensor[0].slope_per_db"),
        ({"humidity_pct": 101.0}, "sensor[0].humidity_pct"),
        ({"report": ["asterix-048"]}, "sensor[0].report"),
        ({"scan": {"kind": "rotating", "period_s": 1.0}}, "sensor[0].scan.kind"),
    ],
)
def test_a_wrong_key_is_named(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene([microphones(**changes)], seed=1)
    assert any(name.startswith(key) for name, _ in refused.value.problems)


def test_absorption_follows_from_the_air_unless_it_is_given() -> None:
    """4.98 dB/km at 1 kHz, 20 degrees, 70 % and one atmosphere (ISO 9613-1, table 1)."""
    without = microphones()
    del without["absorption_db_per_km"]
    parts = scene([without, microphones(id="b")], seed=1)
    computed, given = (sensor.model(parts.scene.site) for sensor in parts.sensor)
    assert computed.absorption_db_per_m == pytest.approx(4.98e-3, abs=5e-6)
    assert given.absorption_db_per_m == 0.005
    assert given.array_gain_db == pytest.approx(9.03, abs=0.001)


def test_warnings_are_of_hurried_scans_and_of_gains_given_twice() -> None:
    parts = scene(
        [
            microphones(azimuth_floor_deg=2.0),
            microphones(id="b", azimuth_floor_deg=1.0, scan=staring(0.05), array_gain_db=9.03),
        ],
        seed=1,
    )
    good, bad = (list(sensor.warnings(parts.scene.site)) for sensor in parts.sensor)
    assert not good
    assert [text.split()[0] for text in bad] == ["scan.period_s", "microphones"]
