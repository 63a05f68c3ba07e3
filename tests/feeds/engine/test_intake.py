"""Telemetry taken in together: the same truth, fair shares, and a word for what is not taken."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.intake import Intake
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.telemetry.fair_queue import MAX_OF_TOPIC
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY, PositionReport
from plotfeed.feeds.telemetry.receiver import MAX_REFUSALS_PER_S, TelemetryReceiver, look_back_s
from plotfeed.models.state import AltitudeReference
from plotfeed.models.truth import Trajectories

S, MS = 1_000_000_000, 1_000_000
NOW = 1_767_268_800 * S
TICK_NS = 10 * MS
MOVES = (1.0, 0.0, 0.0)
MICROPHONE = """
[[sensor]]
id = "ear"
type = "acoustic"
range_max_m = 680.0
azimuth_beamwidth_deg = 10.0
noise_db = 30.0
sensitivity_db = 3.0
slope_per_db = 1.0
[sensor.scan]
kind = "staring"
period_s = 0.5
"""


def scene_of(folder: Path, sensors: str) -> Scene:
    return load(scene_file(folder, scene_text(port=1883, sensors=sensors, drones="")))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return scene_of(tmp_path_factory.mktemp("scene"), radar(period_s=1.0, sectors=32))


def report(
    t_utc_ns: int, velocity: tuple[float, float, float] = UNKNOWN_VELOCITY, step: int = 0
) -> bytes:
    place = 40.0 + 1e-5 * (step * step % 17), -3.0 + 1e-5 * (step % 5), 700.0
    return PositionReport(t_utc_ns, *place, AltitudeReference.ELLIPSOID, velocity).to_protobuf()


class Told:
    """An intake without a session, and what it tells."""

    def __init__(self, scene: Scene) -> None:
        self.told: list[tuple[str, bytes, int]] = []
        self.errors: list[Message] = []
        self.totals = SessionCounters()
        engine = Engine(scene, NOW)
        self.trajectories = engine.trajectories
        tell = self.errors.append
        self.inputs = Intake(
            engine,
            self.totals,
            tell,
            received=[lambda topic, payload, _, t_ns: self.told.append((topic, payload, t_ns))],
        )

    def come(self, drone: str, payload: bytes) -> None:
        self.inputs.queue(f"plotfeed/telemetry/{drone}", payload, None)

    def tick(self, now_ns: int, budget: int = 1 << 30) -> None:
        """`budget` is how often there is time for more."""
        left = iter(range(budget))
        self.inputs.take_in(now_ns, lambda: next(left, None) is None)

    def beside(self, flood: Callable[[int], object], ticks: int) -> tuple[float, int]:
        """How old what is known of a drone at 10 Hz gets, in s, and how many messages wait at most.

        The machine takes in as much as the least that a tick takes, whatever comes.
        """
        oldest_s, most = 0.0, 0
        for tick in range(ticks):
            now_ns = NOW + tick * TICK_NS
            if tick % 10 == 0:
                self.come("quiet", report(now_ns, MOVES))
            flood(now_ns)
            self.tick(now_ns, budget=0)
            known_ns = self.trajectories.spans_ns[self.trajectories.names.index("quiet"), 1]
            oldest_s, most = max(oldest_s, (now_ns - known_ns) / S), max(most, len(self.inputs))
        return oldest_s, most

    @property
    def reasons(self) -> set[str]:
        return {json.loads(error.payload)["reason"] for error in self.errors}


def test_a_drone_at_10_hz_is_never_stale_beside_50_000_messages_a_second(scene: Scene) -> None:
    intake, sent = Told(scene), 150 * 502

    def flood(now_ns: int) -> None:
        for i in range(500):
            intake.come("flood", report(now_ns - 9 * MS + i * 10_000, MOVES))
        intake.come("garbage", b"\xff\xff")
        intake.come("oversized", b"{" * 5_000)

    oldest_s, most = intake.beside(flood, 150)
    assert oldest_s <= 0.1 + 2 * TICK_NS / S
    assert most <= 2 * MAX_OF_TOPIC
    totals = intake.totals
    assert totals.flooded > 0.8 * sent
    assert totals.telemetry + totals.conflated + totals.refused + len(intake.inputs) == sent + 15
    errors = [json.loads(error.payload) for error in intake.errors]
    assert {error["drone"] for error in errors if error["reason"] == "flood"} == {"flood"}
    assert len(errors) <= 2 * MAX_REFUSALS_PER_S  # 1.5 s


def test_ten_thousand_names_in_a_flood_neither_blind_nor_fill_the_session(scene: Scene) -> None:
    intake, names = Told(scene), cycle(f"name{i}" for i in range(10_000))
    oldest_s, most = intake.beside(
        lambda _: [intake.come(next(names), b"\xff") for _ in range(500)], 100
    )
    assert oldest_s < 0.5
    assert most <= 1_001
    assert intake.trajectories.names == ["quiet"]


def test_a_flood_of_commands_takes_no_more_than_a_tick_has_and_starves_no_telemetry(
    scene: Scene,
) -> None:
    """Each may have a sensor worked out anew; the rest waits, one topic's beside another's."""
    intake = Told(scene)
    for i in range(500):
        intake.inputs.queue("plotfeed/control", b"{}", None)
        intake.come("quiet", report(NOW + i * MS))
    intake.tick(NOW, budget=3)
    topics = [topic for topic, _, _ in intake.told]
    assert topics[:4] == ["plotfeed/control"] * 4  # these come first
    assert "control" in intake.reasons
    assert set(topics[4:]) == {"plotfeed/telemetry/quiet"}
    intake.tick(NOW)
    assert [topic for topic, _, _ in intake.told].count("plotfeed/control") == 500


def test_whatever_sensors_are_asked_there_is_room_for_a_command(tmp_path: Path) -> None:
    intake = Told(scene_of(tmp_path, radar(more='report = ["sapient"]')))
    for _ in range(5_000):
        intake.inputs.queue("plotfeed/nobody/sapient/task", b"", None)
    intake.inputs.queue("plotfeed/control", b"{}", None)
    intake.tick(NOW, budget=1)
    assert "plotfeed/control" in {topic for topic, _, _ in intake.told}
    assert intake.totals.flooded == 4_000


def test_a_report_that_waited_until_nobody_can_see_it_is_refused(scene: Scene) -> None:
    intake = Told(scene)
    intake.come("a", report(NOW))
    late_ns = NOW + round((scene.telemetry.stale_after_s + look_back_s(scene)) * S)
    intake.tick(late_ns + 1)
    assert (intake.totals.telemetry, intake.totals.late, intake.totals.refused) == (0, 1, 1)
    assert intake.reasons == {"late"}
    assert "no sensor can still see" in intake.totals.last_refusal
    intake.come("a", report(NOW))
    intake.tick(late_ns)
    assert intake.totals.telemetry == 1


def test_how_far_back_anybody_looks_is_a_sector_and_the_way_of_sound(tmp_path: Path) -> None:
    turning = scene_of(tmp_path, radar(period_s=8.0, sectors=32))
    assert look_back_s(turning) == pytest.approx(1.0 + 0.25)
    listening = scene_of(tmp_path, MICROPHONE)
    assert 1.0 + 0.5 + 2.0 < look_back_s(listening) < 1.0 + 0.5 + 4.0


def test_reports_that_nobody_asks_for_give_way_to_later_ones(scene: Scene) -> None:
    intake = Told(scene)
    for age_ms in range(4_000, 0, -100):
        intake.come("steady", report(NOW - age_ms * MS, MOVES))
        intake.come("fitted", report(NOW - age_ms * MS))
    intake.tick(NOW)
    look_back_ms = round(look_back_s(scene) * 1000)
    needed = sum(age_ms <= look_back_ms for age_ms in range(100, 4_001, 100)) + 1
    assert intake.totals.telemetry == needed + (needed + 19)
    assert intake.totals.conflated == 80 - intake.totals.telemetry
    assert intake.totals.refused == 0


DRONES = ("a", "b", "c")
STEPS_MS = st.integers(1, 300) | st.sampled_from([2_999, 3_001])


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.sampled_from(DRONES), STEPS_MS), min_size=1, max_size=80),
    st.sets(st.sampled_from(DRONES)),
    st.data(),
)
def test_a_batch_makes_the_truth_that_its_reports_make_one_by_one(
    scene: Scene, steps: list[tuple[str, int]], fitted: set[str], data: st.DataObject
) -> None:
    """For whatever can still be asked after each batch, to the last bit."""
    batched, single = (Trajectories(stale_after_s=3.0) for _ in range(2))
    together, one_by_one = TelemetryReceiver(scene, batched), TelemetryReceiver(scene, single)
    look_back_ns = round(look_back_s(scene) * S)
    t_ns, first = dict.fromkeys(DRONES, NOW), 0
    now_ns = NOW
    while first < len(steps):
        end = first + data.draw(st.integers(1, len(steps)))
        waited: dict[str, list[tuple[bytes, str | None]]] = {}
        for step, (drone, step_ms) in enumerate(steps[first:end], first):
            t_ns[drone] = max(t_ns[drone], now_ns - 2 * S) + step_ms * MS
            velocity = UNKNOWN_VELOCITY if drone in fitted else (step * 1.0, -1.0, 0.5)
            topic = f"plotfeed/telemetry/{drone}"
            waited.setdefault(topic, []).append((report(t_ns[drone], velocity, step), None))
        first = end
        now_ns = max(now_ns, max(t_ns.values()) - data.draw(st.integers(0, 1_000)) * MS)
        together.take_together(list(waited.items()), now_ns)
        for topic, messages in waited.items():
            for message in messages:
                one_by_one.take_together([(topic, [message])], now_ns)
        assert together.taken + together.conflated == one_by_one.taken
        assert together.refusals == one_by_one.refusals
        assert batched.names == single.names
        for back_ms in (0, 1, 17, 100, 500, 900):
            asked_ns = now_ns + 300 * MS - back_ms * MS
            assert asked_ns >= now_ns - look_back_ns
            expected, found = single.state_at(asked_ns), batched.state_at(asked_ns)
            for name, column in vars(expected).items():
                np.testing.assert_array_equal(column, getattr(found, name))


def test_what_was_taken_in_is_told_in_order_and_makes_the_same_again(scene: Scene) -> None:
    first, again = Told(scene), Told(scene)
    rng = np.random.default_rng(3)
    for tick in range(100):
        now_ns = NOW + tick * TICK_NS
        for drone in rng.integers(0, 200, 60):
            first.come(f"d{drone}", report(now_ns - int(rng.integers(0, 6_000)) * MS))
        first.tick(now_ns, budget=int(rng.integers(0, 2)))
    times = sorted({t for _, _, t in first.told})
    assert [t for _, _, t in first.told] == sorted(t for _, _, t in first.told)
    for t_ns in times:
        again.inputs.receive([(a, b, None) for a, b, t in first.told if t == t_ns], t_ns)
    assert again.told == first.told
    for name in ("telemetry", "conflated", "refused", "late", "drones"):
        assert getattr(again.totals, name) == getattr(first.totals, name), name
    assert first.totals.late > 0
    assert [e.payload for e in again.errors] == [e.payload for e in first.errors]
    np.testing.assert_array_equal(
        first.trajectories.state_at(NOW + 2 * S).position_ecef_m,
        again.trajectories.state_at(NOW + 2 * S).position_ecef_m,
    )
