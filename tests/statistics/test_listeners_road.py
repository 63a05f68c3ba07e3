"""What hears, on the road: where sound and radio come from, who is read, what hides whom."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import FAR_SENSORS, MICROPHONES, RF
from support.significance import assert_law, assert_sum

from plotfeed.feeds.engine.simulation import Simulation, simulate
from plotfeed.models.effects.surroundings import CITIES
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.models.track_metrics import nees
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, Feed, flown, fly, held, scene, staring, waypoint

ELEVATION_DEG = 5.0


def microphones(**changes: Any) -> dict[str, Any]:
    """Section 4's, on the ground of the site."""
    paper = {
        "id": "mic", "sensitivity_db": 32.0, "microphones": 8, "absorption_db_per_km": 5.0,
        "range_max_m": 1000.0, "azimuth_beamwidth_deg": 40.0, "elevation_beamwidth_deg": None,
        "azimuth_floor_deg": 0.0, "height_above_ground_m": 1.5,
    }  # fmt: skip
    keys = MICROPHONES | paper | changes
    return {name: value for name, value in keys.items() if value is not None}


def crossing(name: str, north_m: float, speed_m_s: float) -> dict[str, Any]:
    """Eastward past the array, 5 m up."""
    ends = (SITE.to_geodetic(np.array([east_m, north_m, 5.0])) for east_m in (-150.0, 150.0))
    keys = ("latitude_deg", "longitude_deg", "height_m")
    path = [dict(zip(keys, map(float, end), strict=True)) for end in ends]
    return flown(name, *path, speed_m_s=speed_m_s, repeat=False, sound_power_db=150.0)


@pytest.mark.parametrize(("temperature_c", "sound_m_s"), [(20.0, 343.2), (0.0, 331.3)])
@pytest.mark.parametrize("speed_m_s", [20.0, 40.0])
def test_a_crossing_drone_is_heard_where_it_was_as_long_ago_as_its_sound_took(
    temperature_c: float, sound_m_s: float, speed_m_s: float
) -> None:
    """Bearings lag by 3.3 degrees at 20 m/s, near and far; where the drone passes closest."""
    sensor = microphones(scan=staring(0.1), temperature_c=temperature_c)
    distances_m = {"near": 100.0, "far": 500.0, "farthest": 900.0}
    drones = [crossing(name, north_m, speed_m_s) for name, north_m in distances_m.items()]
    road = fly(scene([sensor], drones, seed=64), 300 / speed_m_s)
    for name in distances_m:
        looks, plots = (
            each.rows(each.drone == name) for each in (road.looks("mic"), road.plots("mic"))
        )
        assert len(plots) == len(looks) > 30
        off_deg = wrap_180(plots.true_azimuth_deg)  # from the closest point, now
        lag_deg = wrap_180(plots.true_azimuth_deg - plots.azimuth_deg)
        exactly_deg = np.degrees(np.arcsin(speed_m_s / sound_m_s * np.cos(np.radians(off_deg))))
        np.testing.assert_allclose(lag_deg, exactly_deg, atol=0.02)
        np.testing.assert_allclose(wrap_180(plots.azimuth_deg - looks.azimuth_deg), 0, atol=0.02)
        then_m, now_m = (
            -150 + speed_m_s * (ns - START_NS) / NS
            for ns in (looks.emitted_utc_ns, looks.time_utc_ns)
        )
        heard_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)[:, 0]
        true = plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m
        np.testing.assert_allclose(heard_m, then_m, atol=0.02)
        np.testing.assert_allclose(aer_to_enu(*true)[:, 0], now_m, atol=0.05)
        lasted_s = (looks.time_utc_ns - looks.emitted_utc_ns) / NS
        np.testing.assert_allclose(lasted_s, looks.range_m / sound_m_s, rtol=1e-3)


def test_a_drone_is_not_heard_before_its_first_sound_arrives() -> None:
    place = held("d", 10.0, ELEVATION_DEG, 900.0, sound_power_db=150.0)
    looks = fly(scene([microphones(scan=staring(0.1))], [place], seed=66), 5).looks("mic")
    first_s = (looks.time_utc_ns.min() - START_NS) / 1e9
    assert 900 / 343.2 <= first_s <= 900 / 343.2 + 0.11


def test_absorption_follows_from_the_air_unless_it_is_given() -> None:
    """4.98 dB/km at 1 kHz, 20 degrees, 70 % and one atmosphere (ISO 9613-1, table 1)."""
    without = microphones()
    del without["absorption_db_per_km"]
    parts = scene([without, microphones(id="b")], seed=1)
    computed, given = (sensor.model(parts.scene.site) for sensor in parts.sensor)
    assert computed.absorption_db_per_m == pytest.approx(4.98e-3, abs=5e-6)
    assert given.absorption_db_per_m == 0.005
    assert given.array_gain_db == pytest.approx(9.03, abs=0.001)


# Two microphone arrays through the whole road: places and covariances of what both hear.


def pair(**changes: Any) -> dict[str, Any]:
    apart = {"east_m": 150.0, "north_m": 0.0, "above_site_m": 0.0}
    own = {"id": "pair", "type": "acoustic_pair", "second_array": apart, "range_max_m": 800.0}
    return microphones(height_above_ground_m=None, azimuth_floor_deg=0.3) | own | changes


def test_places_scatter_by_the_stated_covariance() -> None:
    """The normalised square of errors is chi-square of two degrees of freedom, to first order."""
    drone = held("d", 30.0, 0.1, 140.0, sound_power_db=115.0)
    plots = simulate(scene([pair()], [drone], seed=81), 300, start_utc_ns=START_NS)["pair"].plots
    assert len(plots) > 250
    found = aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m)
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    ee, nn, en = (getattr(plots, f"covariance_{of}_m2") for of in ("east", "north", "east_north"))
    covariance = np.moveaxis(np.array([[ee, en], [en, nn]]), -1, 0)
    assert_law(nees((found - true)[:, :2], covariance), lambda x: 1 - np.exp(-x / 2))


def test_beams_in_elevation_give_a_height_and_category_015_has_ranges() -> None:
    drone = held("d", 30.0, 25.0, 200.0, sound_power_db=125.0)
    tall = pair(elevation_beamwidth_deg=20.0, elevation_floor_deg=0.3)
    road = fly(scene([tall], [drone], seed=84), 40)
    plots, records = road.plots("pair"), road.records("pair", 15)
    late = plots.rows(plots.time_utc_ns > START_NS + 2_000_000_000)
    assert len(late) > 30
    assert late.range_m.mean() == pytest.approx(200.0, abs=4)
    assert late.elevation_deg.mean() == pytest.approx(25.0, abs=1)
    error = (late.elevation_deg - late.true_elevation_deg) / late.sigma_elevation_deg
    assert np.std(error) < 1.6
    ranges_m = [float(record.get("I015/625/R")) for record in records]
    np.testing.assert_allclose(ranges_m, plots.range_m, atol=0.06)
    assert {record.get("I015/020/MOMU") for record in records} == {0}


# The RF sensor's messages against closed forms, worked out here from the scene's numbers.


PFA = 1e-6
CONTROL = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0, "kind": "control"}
VIDEO = {"frequency_hz": 2.46e9, "bandwidth_hz": 2e6, "eirp_dbm": 23.0, "kind": "video"}
REMOTE_ID = {"frequency_hz": 2.437e9, "bandwidth_hz": 1e6, "eirp_dbm": 15.0, "kind": "remote-id",
             "identity": "1596F3"}  # fmt: skip


def finder(**changes: Any) -> dict[str, Any]:
    """A direction finder of 1 MHz channels over a town."""
    town = {"kind": "log-distance", "exponent": 3.0, "reference_m": 100.0}
    keys = {
        "id": "rf", "frequency_max_hz": 2.48e9, "gain_rx_dbi": 3.0, "loss_db": 1.0, "pfa": PFA,
        "range_max_m": 20_000.0, "path_loss": town, "baseline_m": 0.06, "azimuth_floor_deg": 0.0,
    }  # fmt: skip
    return RF | keys | changes


def detector(**changes: Any) -> dict[str, Any]:
    """The same without directions."""
    keys = finder(id="omni", measures_azimuth=False)
    for of_directions in ("baseline_m", "azimuth_floor_deg"):
        del keys[of_directions]
    return keys | changes


def reported(road: Feed, sensor: str = "rf") -> list[pb.Plot]:
    batches = [pb.PlotBatch.FromString(p) for p in road.payloads(f"{sensor}/plots")]
    return [plot for batch in batches for plot in batch.plots]


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


def test_every_emitter_in_the_band_is_reported_on_its_channel_and_read_if_it_can_be() -> None:
    looks, plots = two_and_two().looks("rf"), reported(two_and_two())
    assert {*zip(looks.drone, looks.channel, strict=True)} == {("a", 0), ("a", 1), ("b", 0)}
    assert len(plots) == len(looks) == 150
    for plot in plots:
        near = abs(wrap_180(plot.azimuth_deg - 40.0)) < 30
        expected = {0: "control", 1: "remote-id"}[plot.channel] if near else "video"
        assert (plot.kind, plot.identity) == (expected, "")
    plots = reported(two_and_two(), "omni")
    assert len(plots) == 150
    for plot in plots:
        for absent in ("azimuth_deg", "sigma_azimuth_deg", "elevation_deg", "range_m"):
            assert not plot.HasField(absent)
    read = {(plot.kind, plot.identity, plot.channel) for plot in plots if plot.identity}
    assert read == {("remote-id", "1596F3", 1)}
    assert sum(bool(plot.identity) for plot in plots) == 50
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


def test_friis_is_the_default() -> None:
    plain = {key: value for key, value in finder(id="d").items() if key != "path_loss"}
    parts = scene([plain, finder(path_loss={"kind": "friis"})], seed=1)
    assert len({sensor.model(parts.scene.site) for sensor in parts.sensor}) == 1


# RF sensors among houses: who is in sight is drawn once for each pair, by its elevation.


EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
LAWS = {"suburban": (4.88, 0.43, 0.1, 21), "urban": (9.61, 0.16, 1, 20),
        "dense-urban": (12.08, 0.11, 1.6, 23), "high-rise": (27.23, 0.08, 2.3, 34)}  # fmt: skip


def in_town(*ids: str, n: int = 200, names: str = "d", **path_loss: Any) -> Simulation:
    loss = {"path_loss": path_loss} if path_loss else {}
    sensors = [FAR_SENSORS["rf"] | loss | {"id": name} for name in ids]
    drones = [
        held(f"{names}{i}", 1.2 * i, 4.0 + 0.3 * i, 2000.0, emitters=[EMITTER]) for i in range(n)
    ]
    return simulate(scene(sensors, drones, seed=12), 2, start_utc_ns=START_NS)


def lost_db(named: Simulation, free: Simulation, sensor: str = "rf") -> tuple[Any, Any]:
    """Beyond free space, (scans, drones), and elevations."""
    looks, before = named[sensor].looks, free["rf"].looks
    lost = -10 * np.log10(looks.snr / before.snr).reshape(2, -1)
    return lost, looks.elevation_deg.reshape(2, -1)


@pytest.mark.parametrize("environment", LAWS)
def test_as_many_are_in_sight_as_the_law_of_their_elevation_says(environment: str) -> None:
    a, b, in_sight_db, hidden_db = LAWS[environment]
    named = in_town("rf", kind="city", environment=environment)
    lost, elevation_deg = lost_db(named, in_town("rf"))
    assert np.ptp(lost, axis=0).max() < 1e-6  # once for all scans
    sight = np.abs(lost[0] - in_sight_db) < 1e-6
    np.testing.assert_allclose(lost[0][~sight], hidden_db, atol=1e-6)
    p = 1 / (1 + a * np.exp(-b * (elevation_deg[0] - a)))
    assert_sum(float(sight.sum()), float(p.sum()), float((p * (1 - p)).sum()))
    model = CITIES[environment]
    np.testing.assert_allclose(model.sight_probability(elevation_deg[0]), p, rtol=1e-12)


def test_shadowing_is_normal_and_each_pair_has_its_own() -> None:
    city = {"kind": "city", "environment": "suburban", "shadowing_db": 6.0}
    named, free = in_town("rf", "other", **city), in_town("rf")
    found = {}
    for sensor in ("rf", "other"):
        lost, elevation_deg = lost_db(named, free, sensor)
        high = elevation_deg[0] > 25  # all in sight
        found[sensor] = (lost[0][high] - 0.1) / 6.0
        assert len(found[sensor]) > 100
        assert_sum(float((found[sensor] ** 2).sum()), len(found[sensor]), 2 * len(found[sensor]))
    assert abs(np.corrcoef(found["rf"], found["other"])[0, 1]) < 0.4


def test_a_pair_keeps_its_draw_whoever_else_is_there() -> None:
    city = {"kind": "city", "environment": "high-rise", "shadowing_db": 4.0}
    many, few = in_town("rf", n=60, **city), in_town("rf", n=20, **city)
    snr = [found["rf"].looks.rows(found["rf"].looks.drone < 20).snr for found in (many, few)]
    np.testing.assert_array_equal(*snr)
    others = in_town("rf", n=20, names="e", **city)
    assert (others["rf"].looks.snr != few["rf"].looks.snr).any()
