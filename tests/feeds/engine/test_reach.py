"""Drones out of a sensor's reach cost next to nothing; leaving them out changes not one octet."""

from __future__ import annotations

from typing import Any
from unittest.mock import create_autospec

import numpy as np
import pytest

from plotfeed import simulate
from plotfeed.feeds.engine.emulated_sensors import SensorGroup
from plotfeed.models import beam
from plotfeed.models.frames import Axes, LocalFrame, aer_to_enu
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.testing import (
    START_NS,
    Feed,
    flown,
    fly,
    held,
    radar,
    rotating,
    scene,
    staring,
    waypoint,
)

SENSORS = [
    radar(id="staring", range_max_m=3000.0),
    radar(id="rotating", range_max_m=3000.0, scan=rotating(0.5, 8)),
    radar(id="merging", range_max_m=3000.0, scan=rotating(0.5, 8), merging={}),
    {
        "id": "microphones", "type": "acoustic", "scan": staring(), "noise_db": 0.0,
        "sensitivity_db": 10.0, "range_max_m": 3000.0, "azimuth_beamwidth_deg": 20.0,
    },
]  # fmt: skip


def drones() -> list[dict[str, Any]]:
    """Most of them far away; some that come into reach and leave it again, fast."""
    ways = [
        (waypoint(of, 5.0, 3400.0), waypoint(of + 100.0, 5.0, 3400.0)) for of in range(0, 360, 30)
    ]
    crossing = [flown(f"c{i}", *way, speed_m_s=300.0) for i, way in enumerate(ways)]
    far = [held(f"f{i}", 5.0 * i, 8.0, 4000.0 + 500.0 * i) for i in range(60)]
    return [*crossing, *far, held("edge", 77.0, 8.0, 2999.99), held("near", 99.0, 8.0, 2000.0)]


def leaving(count: int) -> list[dict[str, Any]]:
    """One after the other goes out of reach: within a turn some are still there, and some not."""
    return [
        flown(
            f"c{i}", waypoint(9.0 * i, 5.0, 2990.0 - 120.0 * i / count),
            waypoint(9.0 * i, 5.0, 3400.0), speed_m_s=15.0,
        )
        for i in range(count)
    ]  # fmt: skip


def left(road: Feed) -> list[tuple[str, bytes]]:
    return [(m.topic, m.payload) for m in road.messages if not m.topic.endswith("/status")]


@pytest.mark.parametrize("fleet", [drones(), leaving(40), leaving(10)], ids=["far", "many", "few"])
def test_what_leaves_is_the_same_with_and_without_those_out_of_reach(
    fleet: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = scene(SENSORS, fleet, seed=101)
    with_culling = fly(made, 12)
    monkeypatch.setattr(beam, "CULLED_FROM", 1 << 40)
    monkeypatch.setattr(SensorGroup, "_reach", lambda _, sensor: np.full(sensor.shape, np.inf))
    assert left(fly(made, 12)) == left(with_culling)
    looking = {e.sensor for e in with_culling.ledgers for look in e.looks if look.drone[0] == "c"}
    assert looking == {sensor["id"] for sensor in SENSORS}


def test_physics_is_asked_of_those_within_reach_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    observed = create_autospec(ActiveRadar.observe, side_effect=ActiveRadar.observe)
    monkeypatch.setattr(ActiveRadar, "observe", observed)
    everybody = [held(f"f{i}", 5.0 * i, 8.0, 4000.0 + 500.0 * i) for i in range(70)]
    everybody += [held(f"n{i}", 40.0 * i, 8.0, 2000.0) for i in range(5)]
    for sensor in SENSORS[:2]:
        observed.reset_mock()
        simulate(scene([sensor], everybody, seed=102), 5.0, start_utc_ns=START_NS)
        asked = [targets.drone for (_, targets, _), _ in observed.call_args_list]
        assert {*np.concatenate(asked).tolist()} == set(range(70, 75))


@pytest.mark.parametrize(
    ("report", "told"),
    [("asterix-015", False), ("asterix-048", True), ("plots", True), ("asterix-062", False)],
)
def test_heights_are_computed_for_formats_that_have_them(
    report: str, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = create_autospec(Axes.heights_m, side_effect=Axes.heights_m)
    monkeypatch.setattr(Axes, "heights_m", computed)
    sensor = radar(report=[report])
    fly(scene([sensor], [held("near", 99.0, 8.0, 2000.0, rcs_m2=1.0)], seed=103), 5)
    assert computed.called is told


def test_heights_alone_are_those_of_the_whole_transformation() -> None:
    rng = np.random.default_rng(1)
    for latitude_deg in (-90.0, -33.0, 0.0, 40.0, 89.9, 90.0):
        frame = LocalFrame(latitude_deg, 77.0, 600.0)
        for range_m, within_m in ((1e4, 2.5e-8), (1e6, 2e-4)):
            places = (
                rng.uniform(0, 360, 2000),
                rng.uniform(-90, 90, 2000),
                rng.uniform(0, range_m, 2000),
            )
            whole_m = frame.to_geodetic(aer_to_enu(*places))[2]
            assert np.abs(frame.heights_m(*places) - whole_m).max() < within_m


def test_who_sees_nobody_has_the_columns_of_its_kind() -> None:
    """Of sound, when it was made."""
    made = scene(SENSORS[3:], [held("far", 5.0, 8.0, 9000.0)], seed=104)
    looks = simulate(made, 3.0, start_utc_ns=START_NS)["microphones"].looks
    assert len(looks) == 0
    assert looks.emitted_utc_ns is not None
