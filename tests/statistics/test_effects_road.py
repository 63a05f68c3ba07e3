"""Effects on the road: antennas, pulses, weather, ground, side lobes, and how targets are."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.every_kind import FAR_SENSORS, RADAR, SENSORS, drones
from support.hills import write_ridge
from support.radar_equations import LIGHT_M_S, joint_hit_gauss_markov, mean_snr, pd
from support.significance import Array, assert_law, assert_standard_normal, assert_sum

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.formats.sapient.sapient_node import detection_confidence_of, node_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene, staring

SHAPED = {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0, "beamwidth_deg": 3.0}


def test_a_shaped_beam_of_no_stated_gain_spreads_what_it_has() -> None:
    sensor = {key: value for key, value in radar().items() if key != "gain_rx_dbi"}
    gains = []
    for antenna in ({}, {"receive": {"elevation": SHAPED}}):
        made = scene([sensor | {"antenna": antenna}], seed=37)
        model: Any = made.sensor[0].model(made.scene.site)
        gains.append(model.gain_rx_dbi)
    e1, e2 = np.radians(4.0), np.radians(30.0)
    assert gains[0] - gains[1] == pytest.approx(10 * np.log10(2 - e1 / np.tan(e2)), rel=1e-12)


# A sensor that does worse than it says: in one respect, and in no other.


def test_an_event_degrades_for_as_long_as_it_lasts() -> None:
    event = {"from_s": 20.0, "to_s": 40.0, "set": {"degradation": {"pd_factor": 0.0}}}
    flight = fly(scene([RADAR | {"event": [event]}], drones("active"), seed=74), 60)
    looks = flight.looks()
    at_s = (looks.time_utc_ns - START_NS) / 1e9
    assert (looks.pd[(at_s > 21) & (at_s < 40)] == 0).all()
    assert (looks.pd[(at_s < 20) | (at_s > 41)] > 0).all()


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}])
def test_of_echoes_that_merge_so_much_of_pd_is_left_too(scan: dict[str, Any]) -> None:
    """Two drones in one place, weak enough to be missed; and rates are as much worse."""
    weak = {"rcs_m2": 0.001}
    pairs = [held(f"{i}-{j}", 30.0 * i, 5.0, 9000.0, **weak) for i in range(12) for j in range(2)]
    named = {"merging": {}, "doppler": {}} | scan
    looks = [
        fly(scene([radar(**named, **more)], pairs, seed=75), 30).looks()
        for more in ({}, {"degradation": {"pd_factor": 0.5}})
    ]
    assert 0.1 < looks[0].pd.min() < 0.9
    np.testing.assert_allclose(looks[1].pd, 0.5 * looks[0].pd, rtol=1e-12)


WORSE = {"pd_factor": 0.6, "false_alarm_factor": 4.0, "error_factor": 2.0}


@pytest.mark.parametrize("kind", ["active", "microphones"])
def test_the_sensor_says_of_itself_what_it_takes_itself_to_be(kind: str) -> None:
    sensor = SENSORS[kind] | {"report": ["sapient"]}
    plain, worse = (scene([sensor | more], seed=78) for more in ({}, {"degradation": WORSE}))
    assert node_of(worse, worse.sensor[0]) == node_of(plain, plain.sensor[0])
    believes, believed = (detection_confidence_of(s, s.sensor[0]) for s in (worse, plain))
    assert believes is not None
    assert believed is not None
    np.testing.assert_array_equal(believes.log_odds, believed.log_odds)


# What pulses make ambiguous or blind, as it leaves: ranges, detections, alarms and reports.


PRF_HZ = 25_000.0
FOLD_M = LIGHT_M_S / (2 * PRF_HZ)


def spread(n: int = 40, **more: Any) -> list[dict[str, Any]]:
    return [held(f"d{i}", 9.0 * i + 1, 4.0, 1000.0 + 331.0 * i, **more) for i in range(n)]


def test_drones_beyond_are_told_nearer_by_whole_folds() -> None:
    """Not where two frequencies tell the folds apart."""
    one = scene(
        [radar(pulses={"prf_hz": [PRF_HZ]}, range_floor_m=3.0)], spread(rcs_m2=1.0), seed=21
    )
    two = scene([radar(pulses={"prf_hz": [PRF_HZ, 27_000.0]})], spread(rcs_m2=1.0), seed=21)
    plots, apart = (
        found.rows(found.drone != "") for found in (fly(one, 20).plots(), fly(two, 5).plots())
    )
    folds = (plots.true_range_m - plots.range_m) / FOLD_M
    whole = np.rint(folds)
    assert set(whole) == {0.0, 1.0, 2.0}
    assert plots.range_m.max() < FOLD_M
    assert_standard_normal((whole - folds) * FOLD_M / plots.sigma_range_m)
    assert np.abs(apart.range_m - apart.true_range_m).max() < 20.0


def test_false_alarms_are_told_within_a_fold_alone() -> None:
    made, plain = (
        scene([radar(pfa=2e-5, **more)], seed=22) for more in ({"pulses": {"prf_hz": [PRF_HZ]}}, {})
    )
    few, many = (m.sensor[0].model(m.scene.site).false_alarms_per_scan for m in (made, plain))
    assert few == pytest.approx(many * FOLD_M / 20_000.0, rel=1e-9)
    plots = fly(made, 10).plots()
    assert plots.range_m.max() < FOLD_M
    assert_sum(len(plots), 10 * few, 10 * few)


# How echoes fluctuate, and from which side they are strong, as detections and the ledger say.


STARING = {"scan": staring(0.1), "n_reference": 4096, "report": ["plots"]}


def by_scan(flight: Feed, column: str, n: int) -> Array:
    """A column of the looks, a row a drone."""
    looks = flight.looks()
    order = np.lexsort((looks.time_utc_ns, looks.drone))
    return np.asarray(getattr(looks, column)[order]).reshape(n, -1)


@pytest.mark.parametrize("tau_s", [0.15, 1.0])
def test_soon_after_a_hit_comes_another(tau_s: float) -> None:
    """Ten looks a second at 60 drones: hits in pairs, by the law of two correlated powers."""
    n, rcs_m2 = 60, 0.0005
    drones = [held(f"d{i:02}", 6.0 * i, 5.0, 8000.0, rcs_m2=rcs_m2) for i in range(n)]
    sensor = radar(decorrelation_s=tau_s, **STARING)
    flight = fly(scene([sensor], drones, seed=58), 30)
    hits, pd = by_scan(flight, "detected", n), by_scan(flight, "pd", n)
    assert_sum(hits.sum(), pd.sum(), (pd * (1 - pd)).sum(), "given the strengths")
    snr = float(mean_snr(sensor, 8000.0, rcs_m2))
    once = 1e-6 ** (1 / (1 + snr))
    both = float(joint_hit_gauss_markov(snr, 1e-6, np.exp(-0.1 / tau_s)))
    for seen, expected in (
        (hits.mean(axis=1), once),
        ((hits[:, 1:] & hits[:, :-1]).mean(axis=1), both),
    ):
        error = (seen.mean() - expected) / (seen.std(ddof=1) / np.sqrt(n))
        assert abs(error) < 4.5, (tau_s, error)
    assert both > 1.03 * once**2
    strength = 10 ** (by_scan(flight, "snr_db", n) / 10) / snr
    spread = strength.mean(axis=1).std(ddof=1) / np.sqrt(n)
    assert abs(strength.mean() - 1) < 4.5 * spread


def test_lasting_strengths_of_two_amplitudes_vary_less() -> None:
    drones = [held(f"{c}-{i:02}", 6.0 * i, 5.0, 8000.0, rcs_m2=0.01, swerling=c)
              for c in (1, 3) for i in range(30)]  # fmt: skip
    flight = fly(scene([radar(decorrelation_s=0.5, **STARING)], drones, seed=59), 20)
    strength = 10 ** (by_scan(flight, "snr_db", 60) / 10)
    varies = [each.var() / each.mean() ** 2 for each in np.split(strength, 2)]
    assert varies == pytest.approx([1.0, 0.5], rel=0.15)


def test_strengths_are_the_same_whenever_a_drone_is_looked_for() -> None:
    """By the seed, the sensor and the scan alone: also in the company of others."""
    drones = [held(f"d{i:02}", 6.0 * i, 5.0, 8000.0) for i in range(60)]
    made = [scene([radar(decorrelation_s=1.0, **STARING)], some, seed=60)
            for some in (drones, drones[:3])]  # fmt: skip
    all_of, few = (fly(each, 3) for each in made)
    late = fly(made[0], 1, start_ns=1_700_000_000 * NS + 2 * NS)
    np.testing.assert_array_equal(by_scan(all_of, "snr_db", 60)[:3], by_scan(few, "snr_db", 3))
    looks = all_of.looks()
    for time_ns in np.unique(late.looks().time_utc_ns):
        then = late.looks().rows(late.looks().time_utc_ns == time_ns)
        before = looks.rows(looks.time_utc_ns == time_ns)
        np.testing.assert_allclose(then.snr_db, before.snr_db, atol=1e-3)


# A ridge and a block of houses in the way, by looks and plots, in every kind of sensor.


EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
WAYS = {"radar": 2, "mimo": 2, "passive": 1, "rf": 1, "array": 1}


def drone(name: str, azimuth_deg: float, elevation_deg: float, range_m: float) -> dict[str, Any]:
    return held(name, azimuth_deg, elevation_deg, range_m, emitters=[EMITTER], sound_power_db=130.0,
                rcs_m2=0.03)  # fmt: skip


def flown(sensor: dict[str, Any], drones: Any, folder: Path, **terrain: Any) -> SimulatedSensor:
    named = {"terrain": terrain} if terrain else {}
    made = scene([sensor], drones, seed=77, folder=folder, **named)
    return simulate(made, 30, start_utc_ns=START_NS)[sensor["id"]]


@pytest.mark.parametrize("kind", FAR_SENSORS)
def test_behind_a_ridge_nothing_is_seen_and_above_it_all_is_as_it_was(
    kind: str, tmp_path: Path
) -> None:
    """Looks at whom nothing hides are the same to the bit."""
    ridge = write_ridge(tmp_path, height_m=800)
    seen = [drone("above", 5, 10.0, 4000.0), drone("south", 175, 2.0, 2000.0)]
    drones = [drone("behind", 5, 1.0, 4000.0), *seen]
    free = flown(FAR_SENSORS[kind], drones, tmp_path)
    hidden = flown(FAR_SENSORS[kind], drones, tmp_path, elevation=[ridge])
    assert (free.looks.pd[free.looks.drone == 0] > 0.9).all()
    assert (hidden.looks.pd[hidden.looks.drone == 0] < 1e-5).all()
    looked_at = set(hidden.looks.drone.tolist())
    assert looked_at == ({0, 1, 2} if kind in WAYS else {1, 2})
    assert not (hidden.plots.drone == 0).any()
    before, after = (each.looks.rows(each.looks.drone > 0) for each in (free, hidden))
    assert len(after) > 20
    for column in ("range_m", "azimuth_deg", "snr", "pd"):
        np.testing.assert_array_equal(getattr(before, column), getattr(after, column))


def apart(east_m: float, north_m: float, up_m: float) -> dict[str, float]:
    return {"east_m": east_m, "north_m": north_m, "above_site_m": up_m}


def test_a_beam_that_is_steered_sees_nothing_behind_a_ridge(tmp_path: Path) -> None:
    ridge = {"elevation": [write_ridge(tmp_path, height_m=800)]}
    scan = {"kind": "electronic", "period_s": 1.0, "dwell_s": 0.001, "revisit_s": 1.0}
    sensor = radar(
        scan=scan, integration_s=0.001, power_w=5e5, azimuth_min_deg=-60.0, azimuth_max_deg=60.0,
        elevation_min_deg=-5.0, elevation_max_deg=40.0,
    )  # fmt: skip
    drones = [drone("behind", 5, 1.0, 4000.0), drone("above", 5, 10.0, 4000.0)]
    free, hidden = (flown(sensor, drones, tmp_path, **named).plots for named in ({}, ridge))
    assert set(free.drone.tolist()) >= {0, 1}
    assert set(hidden.drone.tolist()) - {-1} == {1}


# Rain, gases, wind and jammers by time, as looks and detections have them.


HIGH = radar(power_w=5e4, frequency_hz=24.15e9)


def ranged(n: int = 12) -> list[dict[str, Any]]:
    return [
        held(f"d{i}", 30.0 * i, 3.0, 1500.0 + 400.0 * i, rcs_m2=0.03, sound_power_db=130.0,
             emitters=[EMITTER]) for i in range(n)
    ]  # fmt: skip


def of_one(made: Scene, duration_s: float = 20) -> SimulatedSensor:
    return simulate(made, duration_s, start_utc_ns=START_NS)[made.sensor[0].id]


def jammer(azimuth_deg: float, **more: Any) -> dict[str, Any]:
    east_m, north_m, up_m = aer_to_enu(azimuth_deg, 3.0, 4000.0)
    place = {"east_m": float(east_m), "north_m": float(north_m), "above_site_m": float(up_m) + 1.3}
    return {"id": "noisy", "eirp_w": 10.0, "frequency_hz": 24.15e9, "bandwidth_hz": 40e6,
            **place, **more}  # fmt: skip


def test_a_jammer_behind_a_ridge_drowns_nothing(tmp_path: Path) -> None:
    ridge = {"elevation": [write_ridge(tmp_path, height_m=1000)]}
    jammed, free = (
        scene([HIGH], ranged(), seed=8, folder=tmp_path, terrain=ridge, **more)
        for more in ({"jammer": [jammer(0.0, sidelobe_db=0.0)]}, {})
    )
    np.testing.assert_allclose(of_one(jammed).looks.snr, of_one(free).looks.snr, rtol=1e-12)


def test_an_event_of_one_sensor_brings_rain_and_a_jammer_to_it_alone() -> None:
    keys = {k: v for k, v in jammer(90.0, sidelobe_db=0.0).items() if k != "id"}
    event = {"from_s": 5.0, "set": {"weather": {"rain_mm_h": 5.0}, "jamming": {"near": keys}}}
    other = HIGH | {"id": "other"}
    made = scene([HIGH | {"event": [event]}, other], ranged(), seed=9)
    found = simulate(made, 12, start_utc_ns=START_NS)
    for name, jammed in (("radar", True), ("other", False)):
        looks = found[name].looks
        later = looks.t_utc_ns > START_NS + 7e9
        left = looks.snr / mean_snr(HIGH, looks.range_m, 0.03)
        assert np.abs(left[~later][:12] - 1).max() < 1e-9
        assert (left[later].max() < 0.1) == jammed


# Plots by side lobes: at a drone's range, in the direction in which the beam looks.


SCANS, BEAM_DEG, AZIMUTH_DEG, RANGE_M = 150, 2.0, 77.0, 1500.0
OUT_DB, BACK_DB = 25.0, 25.0
ANTENNA = {
    "receive": {"sidelobe_db": BACK_DB}, "transmit": {"sidelobe_db": OUT_DB},
    "sidelobe_plots": True,
}  # fmt: skip
DRONE = held("near", AZIMUTH_DEG, 5.0, RANGE_M, rcs_m2=0.03)
FAR = held("far", 200.0, 5.0, 9000.0, rcs_m2=0.03)


@cache
def seen(kind: str, **changes: Any) -> tuple[SimulatedSensor, Array]:
    """What a radar reports, and which of its plots are by side lobes."""
    scan = rotating(1.0, 8) if kind == "rotating" else staring()
    antenna = ANTENNA if kind != "plain" else {**ANTENNA, "sidelobe_plots": False}
    made = scene([radar(scan=scan, antenna=antenna, pfa=1e-9, **changes)], [DRONE, FAR], seed=121)
    found = simulate(made, SCANS, start_utc_ns=START_NS)
    names = np.array(found.drones)[found["radar"].plots.drone]
    return found["radar"], (names == "sidelobe/radar") & (found["radar"].plots.drone >= 0)


def expected(kind: str) -> float:
    """Mean number in a scan: beams but those about the drone, each with its Pd."""
    lost_db = BACK_DB + OUT_DB * (kind == "rotating")
    sensor = radar(pfa=1e-9)
    beams = 360.0 / BEAM_DEG * (1 - 2 * BEAM_DEG / 360.0)
    rcs_m2 = 0.03 * 10 ** (-lost_db / 10)
    return float(beams * pd(sensor, np.array([RANGE_M]), np.array([rcs_m2]))[0])


@pytest.mark.parametrize("kind", ["rotating", "staring"])
def test_they_are_as_many_as_beams_detect(kind: str) -> None:
    found, by_sidelobes = seen(kind)
    mean = expected(kind)
    assert mean * SCANS > 100
    scans = len(np.unique(found.looks.scan))
    spread = mean * (1 - mean * BEAM_DEG / 360.0)
    assert_sum(float(by_sidelobes.sum()), scans * mean, scans * spread, kind)


def test_they_stand_where_the_beam_looks_at_the_range_of_the_drone() -> None:
    found, by_sidelobes = seen("rotating")
    plots = found.plots.rows(by_sidelobes)
    errors = (plots.range_m - RANGE_M) / plots.sigma_range_m
    assert_standard_normal(errors, "ranges")
    off_deg = wrap_180(plots.azimuth_deg - AZIMUTH_DEG)
    assert np.abs(off_deg).min() > BEAM_DEG / 4  # a beam's width, and its errors
    within = np.abs(off_deg) > 2 * BEAM_DEG
    span = 180.0 - 2 * BEAM_DEG
    shares = (np.abs(off_deg[within]) - 2 * BEAM_DEG) / span
    assert_law(shares, "uniform", "directions")
    into_s = (plots.t_utc_ns - START_NS) / 1e9 % 1.0
    beam_deg = 360.0 * into_s
    assert np.abs(wrap_180(plots.azimuth_deg - beam_deg)).max() < 3 * BEAM_DEG


def test_looks_and_other_plots_are_as_they_were() -> None:
    plain, none = seen("plain")
    found, by_sidelobes = seen("staring")
    assert not none.any()
    for name in ("drone", "pd", "snr", "detected", "t_utc_ns"):
        np.testing.assert_array_equal(getattr(plain.looks, name), getattr(found.looks, name))
    np.testing.assert_array_equal(plain.plots.range_m, found.plots.range_m[~by_sidelobes])


def test_the_ledger_says_what_they_are_and_the_report_takes_them_for_no_drones() -> None:
    sensor = radar(antenna=ANTENNA, pfa=1e-9)
    road = fly(scene([sensor], [DRONE], seed=122), 6)
    told = [plot for entry in road.ledgers for plot in entry.plots]
    others = [plot for plot in told if plot.other]
    assert {plot.other for plot in others} == {"sidelobe/radar"}
    assert not any(plot.drone or plot.HasField("range_m") for plot in others)
    assert {plot.drone for plot in told if not plot.other} <= {"near", ""}


def test_who_is_plotted_through_a_side_lobe_alone_gets_no_track_and_stops_none() -> None:
    strong = held("near", AZIMUTH_DEG, 5.0, RANGE_M, rcs_m2=30.0)
    sensor = radar(scan=rotating(1.0, 8), antenna=ANTENNA, report=["asterix-062"], pfa=1e-9)
    found = fly(scene([sensor], [strong], seed=122), 20.0)
    assert {record.get("I062/040") for record in found.records("radar", 62)} == {1}
