"""An engine by itself says what a session says, whatever its pace, its company or its caller."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.scene_files import radar, scene_text

from plotfeed import Engine, Observer, PlotfeedError, Scene, load, run
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import HELD_NS, Message
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import example, parsed
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.chance import Chance, Purpose
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import START_NS, staring
from plotfeed.testing import radar as radar_of
from plotfeed.testing import scene as built

ROOT = Path(__file__).parents[3]
DURATION_S = 8
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


def report(t_ns: int, step: int) -> bytes:
    said = {
        "time_utc": iso_utc(t_ns),
        "latitude_deg": 40.4545 + 1e-4 * step,
        "longitude_deg": -3.7285,
        "altitude_m": 90.0,
        "altitude_reference": "ABOVE_TAKEOFF",
    }
    return json.dumps(said).encode()


def test_engines_that_share_a_scene_say_together_what_one_says() -> None:
    whole, _ = by_engine(Engine("field-day", START_NS), in_steps(NS // 4))
    names = [sensor.id for sensor in example("field-day").sensor]
    parts: Said = {}
    for i in range(3):
        engine = Engine("field-day", START_NS, sensors=names[i::3], claims=i == 0)
        parts |= by_engine(engine, in_steps(NS // 4))[0]
    assert parts == whole


@pytest.mark.parametrize(
    ("topic", "payload", "reason"),
    [
        ("plotfeed/telemetry/mine", b"{", "undecodable"),
        ("plotfeed/telemetry/mine", report(START_NS - 3600 * NS, 0), "stale"),
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
