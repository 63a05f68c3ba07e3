"""An engine by itself says what a session says, whatever its pace, its company or its caller."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.fleets import drones as flying
from support.random_scenes import SENSOR_MAKERS, Dice
from support.scene_files import radar, scene_text

from plotfeed import Engine, Observer, PlotfeedError, Scene, load, run
from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import HELD_NS, Message
from plotfeed.feeds.scene.changes import command_of
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import example, parsed
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import AltitudeReference, Plots
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, rotating, staring, waypoint
from plotfeed.testing import radar as radar_of
from plotfeed.testing import scene as built

ROOT = Path(__file__).parents[3]
DURATION_S = 8
OLD = PositionReport(START_NS - 3600 * NS, 40.45, -3.73, 90.0, AltitudeReference.ABOVE_TAKEOFF)
END_NS = START_NS + DURATION_S * NS
OWN = sorted((ROOT / "examples" / "scenes").glob("*.toml"))
# By topic: payloads, when they are due, and user properties.
Said = dict[str, list[tuple[bytes, int, tuple[tuple[str, str], ...]]]]


def put(said: Said, message: Message) -> None:
    properties = tuple(message.properties)
    said.setdefault(message.topic, []).append((message.payload, message.due_utc_ns, properties))


Left = list[tuple[int, str, bytes]]  # When what left its link, by topic


class BothSides(Observer):
    """What sensors hand to their links in a session, and what leaves these."""

    def __init__(self) -> None:
        self.said: Said = {}
        self.left: Left = []

    def before_link(self, message: Message) -> None:
        put(self.said, message)

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        if message.topic in self.said and not message.retain:
            self.left.append((sent_utc_ns, message.topic, message.payload))


def what_left(batches: list[Batch]) -> tuple[Said, Left]:
    """When all is done, as links may let go late what they held."""
    said: Said = {}
    left: Left = []
    for one in [one for batch in batches for outgoing in batch.messages for one in outgoing]:
        if not one.copy:
            put(said, one.handed)
        if not one.fate:
            left.append((one.leaves_utc_ns, one.topic, one.payload))
    return said, sorted(left)


def by_engine(engine: Engine, times_ns: Iterator[int]) -> tuple[Said, Left]:
    return what_left([batch for t_ns in times_ns for batch in engine.until(t_ns)])


Messages = dict[str, list[Message]]


def by_sensor(engine: Engine, ends_ns: Iterable[int]) -> Messages:
    """What each sensor says, in its order, in stretches that end then."""
    found: Messages = {}
    for batch in (batch for end_ns in ends_ns for batch in engine.until(end_ns)):
        for i, some in zip(batch.sectors.sensor.tolist(), batch.messages, strict=True):
            found.setdefault(batch.sensors[i], []).extend(some)
    return found


def in_steps(step_ns: int) -> Iterator[int]:
    return iter([*range(START_NS, END_NS, step_ns), END_NS])


@pytest.mark.parametrize("name", [*summaries(), *(path.name for path in OWN)])
@pytest.mark.asyncio
async def test_an_engine_makes_the_octets_of_a_session(name: str) -> None:
    path = ROOT / "examples" / "scenes" / name
    scene = example(name) if name in summaries() else load(path)
    told = BothSides()
    await run(
        scene, clock=InstantClock(START_NS), broker="none", duration_s=DURATION_S, observers=[told]
    )
    said, left = by_engine(Engine(scene, START_NS), in_steps(NS))
    assert said == told.said
    assert left == sorted(told.left)
    assert said


def test_echoes_merge_alike_whatever_else_is_worked_out_with_them(tmp_path: Path) -> None:
    """A chain of drones over nine sectors, each nearer than a beam's width to the next."""
    drones = ""
    for i, at in enumerate(math.radians(20 + each) for each in range(50)):
        place = f"east_m = {1500 * math.sin(at):.1f}, north_m = {1500 * math.cos(at):.1f}"
        drones += f'[[drone]]\nid = "d{i}"\nhome = {{ {place}, above_site_m = 90.0 }}\n'
        drones += 'leg = [{ kind = "hover", for_s = 60.0 }]\n'
    text = scene_text(sensors=radar(sectors=64, more="merging = {}"), drones=drones)
    scene = parsed(text.encode(), tmp_path / "chain.toml")
    paces = [by_engine(Engine(scene, START_NS), in_steps(step)) for step in (NS // 50, NS, END_NS)]
    assert paces[0] == paces[1] == paces[2]


def test_radars_that_begin_their_scans_together_draw_in_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first sectors of a scan are as quickly worked out as all others."""
    drawn, rng = [], Chance.rng

    def counted(self: Chance, purpose: Purpose, scan: int, sector: int = 0) -> np.random.Generator:
        drawn.append((self.key, purpose, scan, sector))
        return rng(self, purpose, scan, sector)

    monkeypatch.setattr(Chance, "rng", counted)
    sensors = "".join(radar(id=f"r{i}", period_s=1.0, sectors=8) for i in range(16))
    scene = parsed(scene_text(sensors=sensors).encode(), tmp_path / "step.toml")
    engine = Engine(scene, START_NS)
    many = []
    for sector in range(1, 33):
        list(engine.until(START_NS + sector * NS // 8))
        many.append(len(drawn))
    of_scan, *_ = by_scan = np.diff(many, prepend=0).reshape(4, 8)[1:]
    assert (by_scan.max(axis=1) < of_scan.sum() / 4).all()  # all looks are in the second sector
    assert (by_scan.sum(axis=1) == of_scan.sum()).all()
    assert {Purpose.DETECTION, Purpose.FALSE_ALARMS} == {purpose for _, purpose, *_ in drawn}
    assert len(set(drawn)) == len(drawn)


@pytest.mark.parametrize(
    ("topic", "payload", "reason"),
    [
        ("plotfeed/telemetry/mine", b"{", "undecodable"),
        ("plotfeed/telemetry/mine", OLD.to_json(), "stale"),
        ("plotfeed/control", b'{"sensor": "nobody", "set": {}}', "control"),
        ("plotfeed/control", b'{"clock": {"speed": 2}}', "control"),
        ("plotfeed/control", b"\xff", "control"),
    ],
)
def test_what_is_refused_is_told_and_changes_nothing(
    topic: str, payload: bytes, reason: str
) -> None:
    engine = Engine("section-4", START_NS)
    refused = engine.receive(topic, payload, START_NS)
    assert refused is not None
    assert refused.reason == reason
    assert refused.detail
    untouched = by_engine(Engine("section-4", START_NS), in_steps(NS))
    assert by_engine(engine, in_steps(NS)) == untouched


def test_plots_and_looks_come_without_messages_too() -> None:
    engine, other = Engine("section-4", START_NS), Engine("section-4", START_NS)
    bare = list(engine.until(END_NS, messages=False))
    full = list(other.until(END_NS))
    assert [len(batch.plots) for batch in bare] == [len(batch.plots) for batch in full]
    assert not any(batch.messages for batch in bare)


def test_a_scene_that_is_not_there_is_a_plotfeed_error() -> None:
    with pytest.raises(PlotfeedError, match="no shipped scene 'nowhere'"):
        Engine("nowhere", START_NS)
    assert isinstance(load(OWN[0]), Scene)


def test_what_a_link_holds_is_let_go_when_its_script_says_whenever_the_next_sector_is() -> None:
    """A scan takes 5 s; the link is down from a second before the first one ends to one after."""
    down = {"from_s": 4.0, "to_s": 6.0, "set": {"link": {"down": True}}}
    sensor = radar_of(scan=staring(5.0), link={"on_loss": "stall"}, event=[down])
    engine = Engine(built([sensor], seed=1), START_NS)
    (held,) = [one for batch in engine.until(START_NS + 5 * NS) for one in batch.messages[0]][:1]
    assert held.leaves_utc_ns == HELD_NS
    assert engine.take_let_go() == []
    assert list(engine.until(START_NS + 7 * NS)) == []
    let_go = engine.take_let_go()
    assert {(i, at_ns) for i, at_ns, _ in let_go} == {(0, START_NS + 6 * NS)}
    assert held in [one for _, _, one in let_go]
    assert held.leaves_utc_ns == START_NS + 6 * NS


# Sensors of all kinds together.

TOGETHER_NS = START_NS + 2 * NS
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
KINDS: dict[str, dict[str, Any]] = {
    "staring": radar_of(pfa=1e-6, scan=staring(0.5)),
    "turning": radar_of(pfa=1e-6, scan=rotating(1.0, 32)),
    "fast": radar_of(pfa=1e-6, scan=rotating(0.25, 64)),
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
    some = flying(n, seed, 20.0, (200, 4000))
    keys = {"sound_power_db": 110.0, "emitters": [EMITTER]}
    return [one | keys | {"id": f"d{i}"} for i, one in enumerate(some)]


def made_of(sensors: list[dict[str, Any]], seed: int, n: int = 12) -> Scene:
    """Every second of the sensors goes to a destination that takes short blocks alone, too."""
    udp = [
        {"destination": f"127.0.0.1:{5000 + i}", "sensors": [one["id"]], "max_octets": 128 + 64 * i}
        for one in sensors
        for i in [one["sic"]]
        if i % 2
    ]
    return built(sensors, drones(seed, n), seed=seed, udp=udp)


def by_one_of(made: Scene, ends_ns: Iterable[int], which: Sequence[str] | None = None) -> Messages:
    return by_sensor(Engine(made, START_NS, sensors=which), ends_ns)


def test_no_octet_depends_on_how_time_is_cut_into_ticks() -> None:
    made = made_of(sensors(1), 1)
    whole = by_one_of(made, [TOGETHER_NS])
    by_chance = sorted(np.random.default_rng(1).integers(START_NS, TOGETHER_NS, 30).tolist())
    assert by_one_of(made, [*range(START_NS, TOGETHER_NS, NS // 25), TOGETHER_NS]) == whole
    assert by_one_of(made, [*by_chance, TOGETHER_NS]) == whole
    assert len(whole) == 2 * len(KINDS)
    assert sum(map(len, whole.values())) > 700


def test_no_octet_of_a_sensor_depends_on_who_else_is_there() -> None:
    every = sensors(4)
    made = made_of(every, 4, 40)
    together = by_one_of(made, [TOGETHER_NS])
    names = np.random.default_rng(4).permutation([sensor.id for sensor in made.sensor]).tolist()
    for part in (names[:1], names[1:8], names[8:]):
        assert by_one_of(made, [TOGETHER_NS], part) == {name: together[name] for name in part}
    assert by_one_of(made_of([*reversed(every)], 4, 40), [TOGETHER_NS]) == together


def test_control_in_mid_run_changes_that_sensor_alone_from_the_next_sector_on() -> None:
    made = built(
        [radar_of(id=f"r{i}", scan=rotating(1.0, 32)) for i in range(4)], drones(7), seed=7
    )
    middle_ns = START_NS + NS
    plain, engine = by_one_of(made, [middle_ns, TOGETHER_NS]), Engine(made, START_NS)
    found = by_sensor(engine, [middle_ns])
    engine.obey(command_of({"sensor": "r2", "set": {"enabled": False}}), middle_ns)
    for sensor, messages in by_sensor(engine, [TOGETHER_NS]).items():
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
        made = built([KINDS[kind] | {"id": "it"}], drones(1), seed=3, **world)
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
        engine = Engine(built([KINDS["staring"]], drones(3, 1), seed=3, **world), START_NS)
        found = []
        for second in range(1, 7):
            at_ns = START_NS + second * NS
            place = waypoint(30.0, 5.0, 2000.0 + 10 * second).values()
            told = PositionReport(at_ns, *place, AltitudeReference.ELLIPSOID).to_json()
            assert engine.receive("plotfeed/telemetry/live", told, at_ns) is None
            for batch in engine.until(at_ns):
                name = np.array([*batch.names, ""])[batch.plots.drone]
                found.append(batch.plots.rows((name == "live") | (name == "d0")))
        assert len(engine.trajectories) == 2
        return Plots.joined(found)

    alone, beside = (vars(plots(**world)) for world in ({}, {"birds": [OTHERS["birds"][0]]}))
    assert len(alone["drone"]) > 10
    for name in ("t_utc_ns", "range_m", "azimuth_deg", "snr"):
        np.testing.assert_array_equal(beside[name], alone[name])
