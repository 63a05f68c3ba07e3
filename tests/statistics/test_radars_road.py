"""Radars of broadcasts, of several receivers and of steered beams, on the road."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.every_kind import MIMO, PASSIVE
from support.significance import (
    Array,
    assert_counts,
    assert_law,
    assert_standard_normal,
    assert_sum,
)

from plotfeed.feeds.engine import simulation
from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.dwell_agenda import PointedBeams
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.models.sensors.electronic_radar import CONFIRMATION, REVISIT, SEARCH
from plotfeed.models.state import FALSE_ALARM
from plotfeed.models.track_metrics import nees
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, held, radar, scene, waypoint

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
    floors = {"bistatic_range_floor_m": 0.0, "azimuth_floor_deg": 0.0}
    sector = {"azimuth_min_deg": 15.0, "azimuth_max_deg": 75.0}
    return PASSIVE | {"id": "passive", "gain_rx_dbi": 2.0} | floors | sector | changes


def transmitter_enu_m(transmitter: dict[str, Any]) -> Array:
    azimuth_deg, baseline_m = PLACES_M[transmitter["id"]]
    return np.asarray(aer_to_enu(azimuth_deg, 0.2, baseline_m))


def channels(road: Feed) -> Array:
    """Of the plots, in their order."""
    batches = [pb.PlotBatch.FromString(p) for p in road.payloads("passive/plots")]
    return np.array([plot.channel for batch in batches for plot in batch.plots])


SCANS = 200


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
        there = aer_to_enu(mine.true_azimuth_deg, mine.true_elevation_deg, mine.true_range_m)
        at_enu_m = transmitter_enu_m(transmitter)
        baseline_m = np.linalg.norm(at_enu_m)
        true_m = np.linalg.norm(there - at_enu_m, axis=-1) + mine.true_range_m - baseline_m
        error_m = mine.bistatic_range_m - true_m
        assert_standard_normal(error_m / mine.sigma_bistatic_range_m, f"channel {c}")
        assert np.median(mine.range_m) == pytest.approx(3500, abs=60)


# Radars of several receivers through the whole road: places, covariances and ghosts.


MASTS = [(-8000.0, 15_000.0, 200.0), (17_000.0, 3000.0, 150.0), (2000.0, -17_500.0, 120.0)]


def place(east_m: float, north_m: float, above_site_m: float) -> dict[str, float]:
    return {"east_m": east_m, "north_m": north_m, "above_site_m": above_site_m}


def net(receivers: int = 1, **changes: Any) -> dict[str, Any]:
    masts = [
        {"id": f"m{i}", "preset": "dvb-t", "erp_w": 1e5, "place": place(*where)}
        for i, where in enumerate(MASTS)
    ]
    others = [{"id": f"r{i}"} | place(2500.0 * i, 800.0 * i * i, 5.0) for i in range(1, receivers)]
    own = {"id": "net", "type": "multistatic_passive", "report": ["plots"], "range_max_m": 9000.0}
    beams = {"azimuth_beamwidth_deg": 10.0, "bistatic_range_floor_m": 5.0}
    return PASSIVE | own | beams | {"transmitters": masts, "receivers": others} | changes


def mimo() -> dict[str, Any]:
    return MIMO | {
        "id": "net", "type": "multistatic_mimo", "range_resolution_m": 20.0, "range_max_m": 9000.0,
        "transmitters": [{"power_w": 2000.0} | place(900.0 * k, 0.0, 3.0) for k in range(2)],
        "receivers": [{"id": "r1"} | place(2500.0, 800.0, 5.0)], "report": ["plots"],
        "elevation_min_deg": -5.0,
    }  # fmt: skip


def watched(sensor: dict[str, Any], drones: list[dict[str, Any]], scans: int) -> SimulatedSensor:
    return simulate(scene([sensor], drones, seed=101), scans, start_utc_ns=START_NS)["net"]


@pytest.mark.parametrize("sensor", [net(), net(receivers=2), mimo()])
def test_places_scatter_by_the_stated_covariance(sensor: dict[str, Any]) -> None:
    """The mean square is 2, or a little less: a height here is as expected, not drawn."""
    plots = watched(sensor, [held("d", 35.0, 1.4, 3000.0, rcs_m2=1.0)], 100).plots
    assert len(plots) > 90
    assert (plots.drone == 0).mean() > 0.98
    found = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    ee, nn, en = (getattr(plots, f"covariance_{of}_m2") for of in ("east", "north", "east_north"))
    covariance = np.moveaxis(np.array([[ee, en], [en, nn]]), -1, 0)
    assert 1.2 < nees((found - true)[:, :2], covariance).mean() < 2.6


def test_each_pair_looks_and_detects_by_itself() -> None:
    weak = held("d", 35.0, 1.4, 3000.0, rcs_m2=0.0003)
    seen = watched(net(), [weak], 200)
    looks = seen.looks
    assert sorted(set(looks.channel.tolist())) == [0, 1, 2]
    assert 0.2 < looks.pd.mean() < 0.95
    spread = (looks.pd * (1 - looks.pd)).sum()
    assert_sum(float(looks.detected.sum()), float(looks.pd.sum()), float(spread))
    all_three = looks.detected.reshape(-1, 3).all(axis=1).sum()
    fitting = 1 - 0.0027
    assert_sum(float(len(seen.plots)), all_three * fitting, all_three * 0.003 + 1, "places")


def test_detections_of_several_drones_make_ghosts_where_beams_do_not_tell() -> None:
    """Four drones, three masts, one receiver that tells no directions: 60 wrong sets, of which one
    in ten fits by chance; with a beam of 10 degrees hardly any.
    """
    drones = [
        held(f"d{i}", azimuth_deg, 1.0, range_m, rcs_m2=1.0)
        for i, (azimuth_deg, range_m) in enumerate(
            ((20.0, 2500.0), (50.0, 3200.0), (75.0, 2700.0), (40.0, 4100.0))
        )
    ]
    deaf = net(azimuth_beamwidth_deg=360.0, azimuth_floor_deg=60.0, bistatic_range_floor_m=20.0)
    found = watched(deaf, drones, 25).plots
    ghosts = float((found.drone == FALSE_ALARM).sum()) / 25
    assert 0.5 < ghosts < 20
    sharp = watched(net(), drones, 25).plots
    assert float((sharp.drone == FALSE_ALARM).sum()) / 25 < ghosts / 4
    assert np.isnan(found.true_range_m[found.drone == FALSE_ALARM]).all()


def test_what_is_told_in_category_015_and_protobuf() -> None:
    sensor = net(report=["asterix-015", "plots", "sapient"])
    road = fly(scene([sensor], [held("d", 35.0, 1.4, 3000.0, rcs_m2=1.0)], seed=102), 6)
    plots, records = road.plots("net"), road.records("net", 15)
    assert len(plots) == len(records) > 3
    ranges_m = [float(record.get("I015/625/R")) for record in records]
    np.testing.assert_allclose(ranges_m, plots.range_m, atol=0.06)
    assert np.abs(plots.height_m - plots.height_m.mean()).max() < 300
    assert not road.payloads("net/asterix/016")


# The radar of a steered beam through the whole road: odds, errors, rates, and a full agenda.


SCAN = {"kind": "electronic", "period_s": 0.1, "dwell_s": 0.001, "revisit_s": 0.1}


def steered(scan: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    usual = {
        "azimuth_min_deg": -60.0, "azimuth_max_deg": 60.0, "elevation_min_deg": -40.0,
        "elevation_max_deg": 40.0, "integration_s": 0.001, "power_w": 400.0, "pfa": 1e-8,
        "report": ["asterix-015", "plots"], "range_max_m": 8000.0,
    }  # fmt: skip
    return radar(**usual | {"scan": SCAN | (scan or {})} | changes)


def made(drones: int, scan: dict[str, Any] | None = None, seed: int = 111, **changes: Any) -> Scene:
    """Drones from 1 to 4 km, far enough from each other."""
    flown = [
        held(f"d{i}", -55.0 + 110.0 * i / drones, 4.0 + 7.0 * (i % 5), 1000.0 + 70.0 * (i % 41))
        for i in range(drones)
    ]
    return scene([steered(scan, **changes)], flown, seed=seed)


@cache
def twenty() -> SimulatedSensor:
    return simulate(made(20), 25, start_utc_ns=START_NS)["radar"]


def test_beams_point_by_the_axes_by_which_azimuths_are_read() -> None:
    """What drifts by more than a beamwidth, slowly, misses nobody."""
    drift = {"time_constant_s": 600.0, "sigma_azimuth_deg": 4.0}
    right, drifting = (
        simulate(made(20, **more), 5, start_utc_ns=START_NS)["radar"].looks
        for more in ({}, {"drift": drift})
    )
    for channel in (CONFIRMATION, REVISIT):
        odds = [looks.pd[looks.channel == channel] for looks in (right, drifting)]
        assert min(map(len, odds)) > 20
        assert odds[1].mean() == pytest.approx(odds[0].mean(), abs=0.02)


def test_who_flies_past_close_by_is_met_where_he_is_when_a_beam_comes() -> None:
    """He crosses three beams in a period; no beam that meets him is off by more than its half."""
    past = [
        flown(f"d{i}", waypoint(-50, 5, 280 + i), waypoint(50, 5, 280 + i), speed_m_s=40.0 + i,
              swerling=0)
        for i in range(8)
    ]  # fmt: skip
    slow = {"period_s": 0.5, "dwell_s": 0.01, "max_tracks": 0}
    low = {"elevation_min_deg": 0.0, "elevation_max_deg": 10.0, "azimuth_beamwidth_deg": 3.0}
    of = scene([steered(slow, integration_s=0.01, **low)], past, seed=3)
    looks = simulate(of, 8, start_utc_ns=START_NS)["radar"].looks
    searched = looks.rows(looks.channel == SEARCH)
    strength = searched.snr * searched.range_m**4
    assert len(searched) > 40
    assert strength.min() > strength.max() / 20


def test_twenty_tracks_are_looked_at_ten_times_a_second_while_search_goes_on() -> None:
    """A fifth of the dwells is theirs; 840 beams take 1.05 s of the rest, and confirmations."""
    looks = twenty().looks
    after = looks.rows(looks.t_utc_ns > START_NS + 5 * NS)
    a_second = [
        np.bincount(after.drone[after.channel == of], minlength=20) / 20 for of in (REVISIT, SEARCH)
    ]
    assert (a_second[0] > 9).all()
    assert a_second[1].mean() == pytest.approx(1 / 1.075, rel=0.06)


def test_a_full_agenda_leaves_search_its_share() -> None:
    """Sixty drones, looked at every 0.1 s for 5 ms each, would take three times all the time."""
    scan = {"dwell_s": 0.005, "max_tracks": 100, "search_share": 0.4}
    seen = simulate(made(60, scan), 60, start_utc_ns=START_NS)["radar"]
    after = seen.looks.rows(seen.looks.t_utc_ns > START_NS + 40_000_000_000)
    dwells = np.unique(after.t_utc_ns[after.channel == REVISIT])
    assert 8 <= len(dwells) / 200 <= 12.01  # of 20 in a period, 12 at most
    assert (after.channel == SEARCH).sum() > 50
    tracked = np.unique(after.drone[after.channel == REVISIT])
    assert 10 <= len(tracked) < 40


def test_drones_are_looked_at_as_their_manoeuvres_ask() -> None:
    """The nearer, the more often: by the error across the line of sight to the power of 0.4."""
    drones = [
        held("near", -20.0, 5.0, 800.0, rcs_m2=10.0),
        held("far", 20.0, 5.0, 3200.0, rcs_m2=10.0),
    ]
    scan = {"manoeuvre_m_s2": 0.1, "manoeuvre_s": 5.0, "error_ratio": 0.6}
    keys = steered(scan, azimuth_floor_deg=0.1, elevation_floor_deg=0.1)
    del keys["scan"]["revisit_s"]
    looks = simulate(scene([keys], drones, seed=113), 40, start_utc_ns=START_NS)["radar"].looks
    near, far = np.bincount(looks.drone[looks.channel == REVISIT], minlength=2)
    assert near > 30
    assert near / far == pytest.approx(4**0.4, rel=0.35)


def test_plots_do_not_depend_on_how_time_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = twenty().plots
    monkeypatch.setattr(simulation, "STRETCH_NS", 130_000_000)
    again = simulate(made(20), 3, start_utc_ns=START_NS)["radar"].plots
    early = whole.rows(whole.t_utc_ns <= again.t_utc_ns[-1])
    np.testing.assert_array_equal(early.range_m, again.range_m)
    np.testing.assert_array_equal(early.t_utc_ns, again.t_utc_ns)


def test_looks_lie_where_the_beams_of_their_period_are_said_to_have_pointed() -> None:
    there_is = made(12)
    trajectories = trajectories_of(there_is)
    launch(there_is, trajectories, START_NS)
    sensors = EmulatedSensors(there_is, trajectories)
    sensors.start(START_NS)
    width_deg = there_is.sensor[0].azimuth_beamwidth_deg
    looks = searched = revisited = 0
    for period in range(1, 40):
        for seen in sensors.seen(START_NS + period * NS // 10 + 1):
            pointed = sensors.pointed(0)
            assert isinstance(pointed, PointedBeams)
            every_deg = np.concatenate([pointed.search_deg, pointed.tracks_deg])
            off_deg = wrap_180(seen.looks.azimuth_deg[:, None] - every_deg)
            assert (np.abs(off_deg).min(axis=1) < 1.2 * width_deg).all()
            assert pointed.width_deg == width_deg
            looks += len(seen.looks)
            searched += len(pointed.search_deg)
            revisited += len(pointed.tracks_deg)
    assert min(looks, searched, revisited) > 50
