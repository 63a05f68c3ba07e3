"""Cameras and radars that others' plots steer, through the whole road."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.every_kind import EMITTER, RF
from support.significance import assert_law, assert_standard_normal, assert_sum

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.simulation import SimulatedSensor, Simulation, simulate
from plotfeed.feeds.scene.changes import ChangeError, changed
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import wrap_180
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, held, radar, rotating, scene, staring

MOUNT = {"cued_by": "radar", "fov_min_deg": 4.0, "fov_max_deg": 40.0, "zoom_s": 1.0}
QUIET = {"pfa": 1e-15, "power_w": 5e4}


def camera(**changes: Any) -> dict[str, Any]:
    return {
        "id": "camera", "type": "camera", "scan": staring(0.1), "range_max_m": 5000.0,
        "horizontal_fov_deg": 40.0, "pixels_across": 8000, "pixels_down": 6000,
        "false_alarms_per_frame": 0.0, "position_enu_m": [300.0, -200.0, 5.0],
        "mount": MOUNT,
    } | changes  # fmt: skip


def seen(sensors: list[dict[str, Any]], drones: list[dict[str, Any]], for_s: float) -> Simulation:
    return simulate(scene(sensors, drones, seed=5), for_s, start_utc_ns=START_NS)


def seconds(of: SimulatedSensor) -> Any:
    return (of.looks.t_utc_ns - START_NS) / NS


ONE = [held("one", 130.0, 8.0, 1200.0)]


def test_a_camera_turns_to_what_the_radar_sees_though_it_stands_elsewhere() -> None:
    found = seen([camera(), radar(**QUIET)], ONE, 20.0)["camera"]
    assert seconds(found).min() > 1.1 + 1.0  # the radar's scan, the latency, and the way there
    after = seconds(found) > 6.0
    assert after.sum() == 140  # every picture from then on
    assert found.looks.detected[after].mean() > 0.99


def test_it_sees_nothing_before_it_knows_has_turned_and_settled() -> None:
    at_once = MOUNT | {"pan_rate_deg_s": 3600.0, "tilt_rate_deg_s": 3600.0, "settle_s": 0.0,
                       "pan_acceleration_deg_s2": 1e5, "tilt_acceleration_deg_s2": 1e5,
                       "zoom_s": 0.0, "latency_ms": 600.0}  # fmt: skip
    for settle_s in (0.0, 1.5):
        keys = camera(mount=at_once | {"settle_s": settle_s})
        first = seconds(seen([keys, radar(**QUIET)], ONE, 8.0)["camera"]).min()
        assert first == pytest.approx(1.6 + settle_s + 0.1, abs=0.11)


def test_errors_and_odds_of_a_steered_camera_are_those_of_its_own_direction() -> None:
    """Wherever it points and however it is zoomed."""
    drones = [held("low", 40.0, 5.0, 900.0), held("high", 200.0, 60.0, 700.0)]
    found = seen([camera(pointing_error_deg=0.02), radar(**QUIET)], drones, 120.0)["camera"]
    plots = found.plots
    assert set(plots.drone) == {0, 1}
    error = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg) / plots.sigma_azimuth_deg
    assert_standard_normal(error, "azimuth")
    upwards = (plots.elevation_deg - plots.true_elevation_deg) / plots.sigma_elevation_deg
    assert_standard_normal(upwards, "elevation")
    assert_sum(len(plots), found.looks.pd.sum(), (found.looks.pd * (1 - found.looks.pd)).sum() + 1)


def test_false_alarms_are_in_the_picture_wherever_that_is() -> None:
    keys = camera(false_alarms_per_frame=4.0, mount=MOUNT | {"dwell_s": 3000.0})
    found = seen([keys, radar(**QUIET)], ONE, 79.0)["camera"]
    settled = found.plots.t_utc_ns > START_NS + 8 * NS
    alarms = found.plots.rows(settled & (found.plots.drone < 0))
    n = 710
    assert_sum(len(alarms), 4.0 * n, 4.0 * n)
    pan, tilt = np.radians(found.looks.azimuth_deg[-1]), np.radians(found.looks.elevation_deg[-1])
    azimuth, elevation = np.radians(alarms.azimuth_deg) - pan, np.radians(alarms.elevation_deg)
    along = np.cos(elevation) * np.cos(azimuth) * np.cos(tilt) + np.sin(elevation) * np.sin(tilt)
    across = np.cos(elevation) * np.sin(azimuth) / along
    half = np.tan(np.radians(4.0) / 2)
    assert np.abs(across).max() < half * 1.3  # it follows noisy plots about the drone
    assert_law(across, stats.uniform(across.min(), np.ptp(across)).cdf, "across")


def test_all_that_are_there_get_their_turn() -> None:
    drones = [held(str(i), 70.0 * i, 10.0, 900.0) for i in range(5)]
    found = seen([camera(), radar(**QUIET)], drones, 60.0)["camera"]
    assert set(found.looks.drone[found.looks.detected]) == set(range(5))


@pytest.mark.parametrize(
    "cuer",
    [
        radar(scan=rotating(1.0, 16), **QUIET),
        radar(measures_elevation=False, **QUIET),
        RF | {"position_enu_m": [300.0, -200.0, 5.0]},
    ],
    ids=["turning", "without elevations", "bearings"],
)  # fmt: skip
def test_sensors_of_other_kinds_cue_as_well(cuer: dict[str, Any]) -> None:
    drone = held("one", 130.0, 8.0, 1200.0, emitters=[EMITTER])
    found = seen([camera(tilt_deg=8.0), cuer], [drone], 12.0)["camera"]
    assert found.looks.detected.sum() > 30


def test_a_narrow_radar_is_steered_too() -> None:
    beam = radar(id="beam", scan=staring(0.2), azimuth_min_deg=-3.0, azimuth_max_deg=3.0,
                 elevation_min_deg=-3.0, elevation_max_deg=3.0, mount={"cued_by": ["radar"]},
                 **QUIET)  # fmt: skip
    found = seen([beam, radar(**QUIET)], ONE, 20.0)["beam"]
    late = seconds(found) > 8.0
    assert late.sum() == 60
    plots = found.plots.rows(found.plots.drone == 0)
    error = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg) / plots.sigma_azimuth_deg
    assert np.abs(error).max() < 5.5


def test_what_is_seen_does_not_depend_on_how_much_is_worked_out_at_once() -> None:
    drones = [held("a", 20.0, 5.0, 900.0), held("b", 210.0, 9.0, 1100.0)]
    second = camera(id="second", mount=MOUNT | {"cued_by": ("camera", "radar")})
    made = scene([second, camera(), radar(pfa=1e-7, scan=rotating(1.0, 8))], drones, seed=7)

    def plots(stretch_ns: int) -> list[tuple[int, int, float]]:
        engine, found = Engine(made, START_NS), []
        for end_ns in range(START_NS + stretch_ns, START_NS + 12 * NS + 1, stretch_ns):
            for one in engine.until(end_ns, messages=False):
                sensor = np.repeat(one.sectors.sensor, np.diff(one.plots_by)).tolist()
                times, azimuths = one.plots.t_utc_ns.tolist(), one.plots.azimuth_deg.tolist()
                found += list(zip(sensor, times, azimuths, strict=True))
        return sorted(found)

    at_once = plots(6 * NS)
    assert at_once == plots(NS // 50) == plots(NS)
    assert len({sensor for sensor, _, _ in at_once}) == 3


def test_without_cues_it_looks_home_and_an_event_makes_it_look_elsewhere() -> None:
    drones = [held("home", 20.0, 5.0, 900.0), held("there", 250.0, 10.0, 900.0)]
    look = {"azimuth_deg": 250.0, "elevation_deg": 10.0}
    keys = camera(
        pan_deg=20.0, tilt_deg=5.0, position_enu_m=[0.0, 0.0, 0.0],
        mount={"fov_min_deg": 10.0, "fov_max_deg": 40.0},
        event=[{"from_s": 5.0, "to_s": 12.0, "set": {"mount": {"look_at": look}}}],
    )  # fmt: skip
    found = seen([keys], drones, 20.0)["camera"]
    at, drone = seconds(found), found.looks.drone
    assert set(drone[at < 4.9]) == {0}
    assert set(drone[(at > 9.5) & (at < 11.9)]) == {1}
    assert set(drone[at > 16.5]) == {0}


LOOPS = [
    ([camera(mount={"cued_by": "nobody"})],
     "mount.cued_by of 'camera': no sensor has the id 'nobody'"),
    ([camera(mount={"cued_by": "camera"})], "would cue each other"),
    ([camera(mount={"cued_by": "b"}), camera(id="b", mount={"cued_by": "camera"})],
     "would cue each other"),
    ([radar(scan=rotating(), mount={})], "only of a sensor that stares"),
    ([camera(horizontal_fov_deg=360.0)], "only of a camera with flat pictures"),
    ([camera(mount={"look_at": {"latitude_deg": 1.0}})], "a place has latitude_deg"),
]  # fmt: skip


@pytest.mark.parametrize(("sensors", "text"), LOOPS, ids=[text[-20:] for _, text in LOOPS])
def test_cues_that_cannot_be_are_refused(sensors: list[dict[str, Any]], text: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene(sensors, [], seed=1)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_who_cues_cannot_change_at_work() -> None:
    made = scene([camera(), radar()], [], seed=1).sensor[0]
    assert changed(made, {"mount": {"dwell_s": 9.0}}).mount.dwell_s == 9.0
    with pytest.raises(ChangeError, match=r"mount\.cued_by: cannot change"):
        changed(made, {"mount": {"cued_by": "other"}})
