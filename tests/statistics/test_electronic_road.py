"""The radar of a steered beam through the whole road: odds, errors, rates, and a full agenda.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.significance import assert_sum

from plotfeed.feeds.engine import simulation
from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.models.dwell_agenda import PointedBeams
from plotfeed.models.frames import wrap_180
from plotfeed.models.sensors.electronic_radar import CONFIRMATION, REVISIT, SEARCH, ElectronicRadar
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, flown, fly, held, radar, scene, waypoint

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


@pytest.mark.parametrize("channel", [SEARCH, CONFIRMATION, REVISIT])
def test_looks_detect_as_often_as_their_odds_say(channel: int) -> None:
    looks = twenty().looks
    mine = looks.rows(looks.channel == channel)
    assert len(mine) > 200
    spread = (mine.pd * (1 - mine.pd)).sum()
    assert_sum(float(mine.detected.sum()), float(mine.pd.sum()), float(spread) + 0.1)


def test_twenty_tracks_are_looked_at_ten_times_a_second_while_search_goes_on() -> None:
    """A fifth of the dwells is theirs; 840 beams take 1.05 s of the rest, and confirmations."""
    looks = twenty().looks
    after = looks.rows(looks.t_utc_ns > START_NS + 5_000_000_000)
    of_tracks = after.rows(after.channel == REVISIT)
    a_second = np.bincount(of_tracks.drone, minlength=20) / 20
    assert (a_second > 9).all()
    searched = np.bincount(after.drone[after.channel == SEARCH], minlength=20) / 20
    assert searched.mean() == pytest.approx(1 / 1.075, rel=0.06)


def test_what_is_confirmed_met_the_same_echo_twice() -> None:
    """10 dB, Pfa 1e-4: 0.34 of all, and not 0.19, as two echoes would be; some by pointing less."""
    site = made(1).scene.site
    keys = steered({"dwell_s": 1e-4}, pfa=1e-4, n_reference=100_000, integration_s=1e-4)
    model = scene([keys], seed=1).sensor[0].model(site)
    assert isinstance(model, ElectronicRadar)
    place_m = np.array([0.0, 2000.0, 0.0])
    beam_deg = model.grid.middle_of(np.arange(model.beams))
    azimuth, elevation = np.radians(beam_deg[0]), np.radians(beam_deg[1])
    range_m = float(np.linalg.norm(place_m))
    directions = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        axis=-1,
    )
    n = model.beams
    unit = float(model.radar.mean_snr(np.array([range_m]), np.ones(1))[0])
    targets = Targets(
        drone=np.arange(n),
        t_utc_ns=np.full(n, 100_000_000),
        position_enu_m=directions * range_m,
        true_position_enu_m=directions * range_m,
        velocity_enu_m_s=np.zeros((n, 3)),
        signatures=Signatures(
            rcs_m2=np.full(n, 10.0 / unit), sound_power_db=np.full(n, np.nan), emitters=[()] * n
        ),
    )
    quiet = replace(model, steering=replace(model.steering, max_tracks=0, dwell_s=1e-5))
    looks, _ = quiet.observe(targets, np.random.default_rng(3))
    first = looks.rows(looks.channel == SEARCH)
    second = looks.rows(looks.channel == CONFIRMATION)
    assert len(first) == n
    np.testing.assert_allclose(first.snr, 10.0, rtol=1e-6)
    assert first.detected.mean() == pytest.approx(0.433, abs=0.06)
    assert 0.26 < second.detected.sum() / n < 0.40
    assert second.detected.mean() > 0.65  # of two echoes it would be 0.43


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
    seen = simulate(scene([keys], drones, seed=113), 40, start_utc_ns=START_NS)["radar"]
    looks = seen.looks.rows(seen.looks.channel == REVISIT)
    near, far = (float((looks.drone == i).sum()) for i in range(2))
    assert near > 30
    assert near / far == pytest.approx(4**0.4, rel=0.35)


def test_plots_do_not_depend_on_how_time_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = twenty().plots
    monkeypatch.setattr(simulation, "STRETCH_NS", 130_000_000)
    again = simulate(made(20), 3, start_utc_ns=START_NS)["radar"].plots
    early = whole.rows(whole.t_utc_ns <= again.t_utc_ns[-1])
    np.testing.assert_array_equal(early.range_m, again.range_m)
    np.testing.assert_array_equal(early.t_utc_ns, again.t_utc_ns)


def test_false_alarms_take_dwells_and_make_no_plots() -> None:
    noisy = simulate(made(1, pfa=1e-3), 20, start_utc_ns=START_NS)["radar"]
    assert (noisy.plots.drone == 0).all()
    quiet = simulate(made(1), 20, start_utc_ns=START_NS)["radar"]
    of_search = [float((s.looks.channel == SEARCH).sum()) for s in (noisy, quiet)]
    assert of_search[0] < of_search[1]


def test_plots_tell_the_times_of_their_dwells() -> None:
    road = fly(made(3), 5)
    plots, records = road.plots(), road.records("radar", 15)
    assert len(plots) == len(records) > 100
    in_period = (plots.time_utc_ns - START_NS) % 100_000_000
    assert len(np.unique(in_period)) > 10


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"integration_s": 0.01}, "integration_s of 'radar': must not exceed scan.dwell_s"),
        ({"doppler": {}}, "doppler of 'radar': not modelled of a beam that is steered"),
        ({"merging": {}}, "merging of 'radar': not modelled of a beam that is steered"),
        ({"report": ["asterix-062"]}, "asterix-062 is not for a beam that is steered"),
        ({"scan": SCAN | {"dwell_s": 0.05}}, "dwell_s of 'radar': a period has at least 4 dwells"),
    ],
)
def test_what_cannot_be_steered_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene([steered() | keys], seed=1)
    assert message in str(caught.value)


def test_check_warns_of_more_tracks_than_there_is_time_for() -> None:
    crowded = made(1, {"max_tracks": 200})
    told = " ".join(crowded.sensor[0].warnings(crowded.scene.site))
    assert "they would take 2 of all dwells" in told


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
