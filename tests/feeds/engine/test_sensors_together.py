"""Sensors that are worked out together say what each says alone, however time is cut into ticks."""

from __future__ import annotations

import json
import random
from collections.abc import Collection, Iterable
from itertools import cycle
from typing import Any

import numpy as np
import pytest
from support.random_scenes import SENSOR_MAKERS, Dice

from plotfeed import Engine, Scene
from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import command_of
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.models.state import Plots
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import START_NS, radar, rotating, scene, staring, waypoint

END_NS = START_NS + 2 * NS
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
    {"from_s": 0.6, "to_s": 1.5, "set": {"pfa": 1e-4}},
    {"from_s": 0.7, "to_s": 1.05, "set": {"enabled": False}},
]


def formats_of(sensor: dict[str, Any], by_chance: random.Random) -> list[str]:
    """Some in which it may report."""
    rows = [REPORT_FORMATS[name] for name in SENSORS[sensor["type"]].formats]
    measures_azimuth = sensor.get("measures_azimuth", True)
    names = [
        row.name
        for row in rows
        if not row.tells_tracks and (measures_azimuth or not row.needs_azimuth)
    ]
    return by_chance.sample(names, by_chance.randint(1, len(names)))


def sensors(seed: int) -> list[dict[str, Any]]:
    """Two of each kind, elsewhere, in other formats; radars with effects, jitter, events."""
    by_chance = random.Random(seed)  # noqa: S311
    effects = cycle([*EFFECTS, {}, {}, {}, {}])
    found = []
    for kind, keys in KINDS.items():
        for i in range(2):
            place = [by_chance.uniform(-3e3, 3e3), by_chance.uniform(-3e3, 3e3), 0.0]
            one = keys | {"id": f"{kind}-{i}", "position_enu_m": place}
            one |= {"report": formats_of(one, by_chance), "sac": i, "sic": len(found)}
            if one["type"] == "active_radar":
                one |= {"power_w": by_chance.uniform(300.0, 900.0)}
                one |= next(effects) | ({"event": EVENTS} if i == 1 else {})
                # By factors of its own, in one pass with others.
                if "degradation" not in one and by_chance.random() < 0.3:
                    factors = {"pd_factor": by_chance.uniform(0.2, 0.9)}
                    one["degradation"] = factors | {"error_factor": by_chance.uniform(1.0, 3.0)}
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


def said(engine: Engine, *ends_ns: int) -> dict[str, list[Message]]:
    """By each sensor, in its order, in stretches that end then."""
    found: dict[str, list[Message]] = {}
    for end_ns in ends_ns:
        for batch in engine.until(end_ns):
            for i, some in zip(batch.sectors.sensor.tolist(), batch.messages, strict=True):
                found.setdefault(batch.sensors[i], []).extend(some)
    return found


def made_of(sensors: list[dict[str, Any]], seed: int, n: int = 12) -> Scene:
    """Every second of the sensors goes to a destination that takes short blocks alone, too."""
    udp = [
        {"destination": f"127.0.0.1:{5000 + i}", "sensors": [one["id"]], "max_octets": 128 + 64 * i}
        for one in sensors
        for i in [one["sic"]]
        if i % 2
    ]
    return scene(sensors, drones(seed, n), seed=seed, udp=udp)


def by_one_of(made: Scene, ends_ns: Iterable[int], which: Collection[str] | None = None) -> Any:
    return said(Engine(made, START_NS, sensors=which), *ends_ns)


def test_no_octet_depends_on_how_time_is_cut_into_ticks() -> None:
    made = made_of(sensors(1), 1)
    whole = by_one_of(made, [END_NS])
    by_chance = sorted(np.random.default_rng(1).integers(START_NS, END_NS, 30).tolist())
    assert by_one_of(made, [*range(START_NS, END_NS, NS // 25), END_NS]) == whole
    assert by_one_of(made, [*by_chance, END_NS]) == whole
    assert len(whole) == 2 * len(KINDS)
    assert sum(map(len, whole.values())) > 700


def test_no_octet_of_a_sensor_depends_on_who_else_is_there() -> None:
    every = sensors(4)
    made = made_of(every, 4, 40)
    together = by_one_of(made, [END_NS])
    names = np.random.default_rng(4).permutation([sensor.id for sensor in made.sensor]).tolist()
    for part in (names[:1], names[1:8], names[8:]):
        assert by_one_of(made, [END_NS], part) == {name: together[name] for name in part}
    assert by_one_of(made_of([*reversed(every)], 4, 40), [END_NS]) == together


def test_control_in_mid_run_changes_that_sensor_alone_from_the_next_sector_on() -> None:
    made = scene([radar(id=f"r{i}", scan=rotating(1.0, 32)) for i in range(4)], drones(7), seed=7)
    middle_ns = START_NS + NS
    plain, engine = by_one_of(made, [middle_ns, END_NS]), Engine(made, START_NS)
    found = said(engine, middle_ns)
    engine.obey(command_of({"sensor": "r2", "set": {"enabled": False}}), middle_ns)
    for sensor, messages in said(engine, END_NS).items():
        found[sensor] += messages
    assert {name for name in plain if found[name] != plain[name]} == {"r2"}
    assert max(message.due_utc_ns for message in found["r2"]) <= middle_ns


PATH = [{"east_m": e, "north_m": n, "above_site_m": 60.0} for e, n in ((-900, 300), (900, -300))]
# What moves beside drones, and by how much of their values it may change plots: a turbine stands in
# the way a little.
OTHERS: dict[str, tuple[dict[str, Any], float]] = {
    "birds": ({"id": "gulls", "count": 8, "rcs_m2": 0.3, "path": PATH}, 0.0),
    "road": ({"id": "a6", "cars_per_h": 600.0, "speed_m_s": 20.0, "path": PATH}, 0.0),
    "turbine": ({"id": "wt", "radius_m": 50.0, **PATH[0]}, 0.05),
}


# Several receivers join echoes of all that there is to places.
@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("multistatic")])
def test_drones_draw_the_same_whatever_else_moves(kind: str) -> None:
    """Else two scenes of which one has birds could not be compared by the same random numbers."""

    def plots(**world: Any) -> Plots:
        made = scene([KINDS[kind] | {"id": "it"}], drones(3), seed=3, **world)
        of_all = simulate(made, 6.0, start_utc_ns=START_NS)["it"].plots
        return of_all.rows((of_all.drone >= 0) & (of_all.drone < 12))

    alone = plots()
    assert len(alone) > 10
    for key, (other, within) in OTHERS.items():
        beside = vars(plots(**{key: [other]}))
        numbers = {name: of for name, of in vars(alone).items() if of.dtype.kind in "fi"}
        for name, column in numbers.items():
            np.testing.assert_allclose(beside[name], column, rtol=within, err_msg=f"{key}: {name}")


def test_a_drone_that_comes_after_birds_draws_the_same() -> None:
    """Its number is behind theirs, which are no drones."""

    def plots(**world: Any) -> Plots:
        engine = Engine(scene([KINDS["staring"]], drones(3, 1), seed=3, **world), START_NS)
        found = []
        for second in range(1, 7):
            at_ns = START_NS + second * NS
            told = waypoint(30.0, 5.0, 2000.0 + 10 * second) | {"time_utc": iso_utc(at_ns)}
            told |= {"altitude_m": told.pop("height_m"), "altitude_reference": "ELLIPSOID"}
            assert (
                engine.receive("plotfeed/telemetry/live", json.dumps(told).encode(), at_ns) is None
            )
            for batch in engine.until(at_ns):
                name = np.array([*batch.names, ""])[batch.plots.drone]
                found.append(batch.plots.rows((name == "live") | (name == "d0")))
        assert len(engine.trajectories) == 2
        return Plots.joined(found)

    alone, beside = (vars(plots(**world)) for world in ({}, {"birds": [OTHERS["birds"][0]]}))
    assert len(alone["drone"]) > 10
    for name in ("t_utc_ns", "range_m", "azimuth_deg", "snr"):
        np.testing.assert_array_equal(beside[name], alone[name])
