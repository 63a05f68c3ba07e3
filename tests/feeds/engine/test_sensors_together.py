"""Sensors that are worked out together say what each says alone, however time is cut into ticks."""

from __future__ import annotations

import random
from itertools import cycle
from typing import Any

import numpy as np
from support.dice import Dice
from support.random_sensors import SENSOR_MAKERS

from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import launch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.truth import Trajectories
from plotfeed.testing import START_NS, radar, rotating, scene, staring, waypoint

S = 1_000_000_000
DURATION_NS = 3 * S
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
KINDS: dict[str, dict[str, Any]] = {
    "staring": radar(pfa=1e-6, scan=staring(0.5)),
    "turning": radar(pfa=1e-6, scan=rotating(1.0, 32)),
    "fast": radar(pfa=1e-6, scan=rotating(0.25, 64)),
    **{kind: {"type": kind} | maker(Dice(1)) for kind, maker in SENSOR_MAKERS.items()},
}
EFFECTS: list[dict[str, Any]] = [
    {"multipath": {"antenna_height_m": 5.0}},
    {"doppler": {"notch_m_s": 1.0}},
    {"merging": {}},
    {"bias": {"range_offset_m": 5.0, "azimuth_offset_deg": 1.0, "time_offset_s": 0.1}},
    {"drift": {"sigma_range_m": 3.0, "time_constant_s": 60.0}},
    {"antenna": {"receive": {"elevation": {"kind": "gaussian", "beamwidth_deg": 20.0}}}},
    {"pulses": {"prf_hz": [5e3, 6e3], "needed": 2, "canceller": "single"}},
    {"degradation": {"pd_factor": 0.7, "false_alarm_factor": 3.0, "error_factor": 2.0}},
]
EVENTS = [
    {"from_s": 0.9, "to_s": 2.3, "set": {"pfa": 1e-4}},
    {"from_s": 1.1, "to_s": 1.55, "set": {"enabled": False}},
]


def sensors(seed: int) -> list[dict[str, Any]]:
    """Three of each kind, elsewhere and of other power; radars with effects, jitter, events."""
    by_chance = random.Random(seed)  # noqa: S311
    effects = cycle([*EFFECTS, {}, {}, {}, {}])
    found = []
    for kind, keys in KINDS.items():
        for i in range(3):
            one = keys | {
                "id": f"{kind}-{i}",
                "position_enu_m": [by_chance.uniform(-3e3, 3e3), by_chance.uniform(-3e3, 3e3), 0.0],
            }
            if one["type"] == "active_radar":
                one |= {"power_w": by_chance.uniform(300.0, 900.0)}
                one |= next(effects) | ({"event": EVENTS} if i == 2 else {})
                if (
                    "degradation" not in one and by_chance.random() < 0.3
                ):  # by factors of its own, in one pass with others
                    one["degradation"] = {"pd_factor": by_chance.uniform(0.2, 0.9)}
                    one["degradation"] |= {"error_factor": by_chance.uniform(1.0, 3.0)}
                if "sectors" in one["scan"] and i == 0:
                    one["scan"] = one["scan"] | {"jitter_ms": 2.0}
            found.append(one)
    return found


def drones(seed: int, n: int = 12) -> list[dict[str, Any]]:
    by_chance = random.Random(seed)  # noqa: S311

    def place() -> dict[str, float]:
        return waypoint(
            by_chance.uniform(0, 360), by_chance.uniform(1, 20), by_chance.uniform(200, 6000)
        )

    return [
        {
            "id": f"d{i}", "speed_m_s": by_chance.uniform(5, 60), "repeat": True,
            "rcs_m2": by_chance.uniform(0.05, 1.0), "sound_power_db": by_chance.uniform(90, 110),
            "emitters": [EMITTER], "path": [place() for _ in range(3)],
        }
        for i in range(n)
    ]  # fmt: skip


def at_work(made: Scene, which: list[int] | None = None) -> EmulatedSensors:
    trajectories = Trajectories(stale_after_s=3.0)
    launch(made, trajectories, START_NS)
    chosen = made.sensor if which is None else [made.sensor[i] for i in which]
    found = EmulatedSensors(made, trajectories, chosen)
    found.start(START_NS)
    return found


def in_stretches(sensors: EmulatedSensors, ends_ns: list[int]) -> dict[str, list[Message]]:
    """Messages of each sensor, in its order."""
    found: dict[str, list[Message]] = {}
    for end_ns in ends_ns:
        for batch in sensors.seen(end_ns):
            of = batch.sectors.sensor.tolist()
            for i, messages in zip(of, sensors.messages(batch), strict=True):
                found.setdefault(batch.sensors[i], []).extend(messages)
    return found


END_NS = START_NS + DURATION_NS


def test_no_octet_depends_on_how_time_is_cut_into_ticks() -> None:
    seed = 1
    made = scene(sensors(seed), drones(seed), seed=seed)
    whole = in_stretches(at_work(made), [END_NS])
    by_ticks = in_stretches(at_work(made), [*range(START_NS, END_NS, S // 100), END_NS])
    by_chance = sorted(np.random.default_rng(seed).integers(START_NS, END_NS, 60).tolist())
    assert by_ticks == whole
    assert in_stretches(at_work(made), [*by_chance, END_NS]) == whole
    assert len(whole) == 3 * len(KINDS)
    assert sum(map(len, whole.values())) > 1500


def test_no_octet_of_a_sensor_depends_on_who_else_is_there() -> None:
    seed = 4
    made = scene(sensors(seed), drones(seed, 40), seed=seed)
    together = in_stretches(at_work(made), [END_NS])
    numbers = np.random.default_rng(seed).permutation(len(made.sensor)).tolist()
    for part in (numbers[:1], numbers[1:8], numbers[8:]):
        some = in_stretches(at_work(made, part), [END_NS])
        assert some == {made.sensor[i].id: together[made.sensor[i].id] for i in part}


def test_control_in_mid_run_changes_that_sensor_alone_from_the_next_sector_on() -> None:
    made = scene([radar(id=f"r{i}", scan=rotating(1.0, 32)) for i in range(4)], drones(7), seed=7)
    middle_ns = START_NS + S
    plain = in_stretches(at_work(made), [middle_ns, END_NS])
    changed = at_work(made)
    found = in_stretches(changed, [middle_ns])
    changed.control(2, {"enabled": False}, middle_ns)
    for sensor, messages in in_stretches(changed, [END_NS]).items():
        found[sensor] += messages
    assert {name for name in plain if found[name] != plain[name]} == {"r2"}
    of_r2 = [message.due_utc_ns for message in found["r2"]]
    assert min(of_r2) < middle_ns
    assert max(of_r2) < middle_ns


def test_echoes_merge_with_those_of_their_own_turn_however_many_are_worked_out_at_once() -> None:
    """Two that fly side by side, in so many turns that those of others would be the nearest."""
    side_by_side = [
        {
            "id": f"d{i}", "speed_m_s": 8.0, "repeat": True, "rcs_m2": 1.0,
            "path": [waypoint(60.0 + 0.3 * i, 5.0, 1600.0 + 15.0 * i), waypoint(80.0, 5.0, 1900.0)],
        }
        for i in range(2)
    ]  # fmt: skip
    sensor = radar(scan=rotating(0.5, 16), merging={"range_m": 60.0, "azimuth_deg": 4.0})
    made = scene([sensor], side_by_side, seed=8)
    end_ns = START_NS + 20 * S
    by_ticks = in_stretches(at_work(made), [*range(START_NS, end_ns, S // 100), end_ns])
    assert in_stretches(at_work(made), [end_ns]) == by_ticks
