"""Which reports are taken: of which drones, how many, how late, how far off; and what is told."""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.scene_drones import trajectories_of
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.drones import EchoesByClass, TargetKeys
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.telemetry_keys import Telemetry
from plotfeed.feeds.telemetry.admission import CONFIRM_NS, GRACE_M, Admission, reach_m
from plotfeed.feeds.telemetry.fair_queue import FairQueue
from plotfeed.feeds.telemetry.position_report import (
    UNKNOWN_VELOCITY,
    AltitudeDatum,
    PositionReport,
    Reason,
    Refused,
    Velocity,
)
from plotfeed.feeds.telemetry.receiver import MAX_REFUSALS_PER_S, TelemetryReceiver, look_back_s
from plotfeed.models.frames import LocalFrame, geoid_undulation_m
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat129 import TargetEncoder129

S, TICK_NS = 1_000_000_000, 10_000_000
NOW = 1_767_268_800 * S


def hovering(t_utc_ns: int) -> PositionReport:
    place = (40.46, -3.72, 900.0, AltitudeReference.ELLIPSOID)
    return PositionReport(t_utc_ns, *place, velocity_enu_m_s=(0.0, 0.0, 0.0))


def admission(look_back_s: float = 1000.0, **keys: Any) -> Admission:
    return Admission(Telemetry(stale_after_s=2.0, **keys), look_back_s)


def taken(door: Admission, drone: str, t_utc_ns: int) -> Reason | None:
    """Why a report is refused, if it is."""
    try:
        assert not door.admit(drone, hovering(t_utc_ns), NOW)
    except Refused as refused:
        return refused.reason
    return None


NO_NAMES = ("", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800")


def test_each_drone_has_its_own_time_which_a_refused_report_does_not_move() -> None:
    door = admission(max_ahead_s=2.0)
    for drone, ahead_ns, reason in (
        ("phantom-4", 3 * S, Reason.FUTURE),
        ("phantom-4", 2 * S, None),
        ("Σ 1", -S, None),
        ("phantom-4", 2 * S, Reason.DUPLICATE),
        ("phantom-4", 2 * S - 1, Reason.BACKWARDS),
        ("Σ 1", 0, None),
        ("x" * 64, 0, None),
        *((name, 0, Reason.NAME) for name in NO_NAMES),
    ):
        assert taken(door, drone, NOW + ahead_ns) is reason


def test_age_is_limited_by_the_scene_and_by_what_can_still_be_seen() -> None:
    for seen_s, age_s, reason in (
        (1000.0, 6, Reason.STALE),
        (1000.0, 5, None),
        (1.0, 4, Reason.LATE),
        (1.0, 6, Reason.STALE),
        (1.0, 3, None),
    ):
        assert taken(admission(seen_s, max_age_s=5.0), "a", NOW - age_s * S) is reason


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(NOW - 9, NOW)), max_size=40))
def test_what_is_admitted_runs_forward(arrivals: list[tuple[str, int]]) -> None:
    door, last = admission(), dict[str, int]()
    for drone, t_utc_ns in arrivals:
        refused = taken(door, drone, t_utc_ns)
        assert (refused is None) == (t_utc_ns > last.get(drone, 0))
        last[drone] = max(t_utc_ns, last.get(drone, 0))


REFERENCES = [*AltitudeReference, *AltitudeReference]
LATITUDES, LONGITUDES = [40.45, 5.0, -8.0] * 2, [-3.73, 79.0, 147.0, 147.0, -3.73, 79.0]


@pytest.mark.parametrize("sea_level_m", [None, 51.0])
def test_each_reference_gives_a_height_above_the_ellipsoid_there(sea_level_m: float | None) -> None:
    """Sea level is that of each place unless it is stated; without a take-off height its key is."""
    sea_m = geoid_undulation_m(LATITUDES, LONGITUDES) if sea_level_m is None else np.full(6, 51.0)
    assert sea_level_m or np.ptp(sea_m) > 150.0
    datum = AltitudeDatum(650.0, SeaLevel(sea_level_m))
    above_m = {AltitudeReference.ABOVE_TAKEOFF: 650.0, AltitudeReference.ELLIPSOID: 0.0}
    expected = [100.0 + above_m.get(r, m) for r, m in zip(REFERENCES, sea_m, strict=True)]
    assert list(datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 6, REFERENCES)) == expected
    for reference in REFERENCES:
        datum.check(reference)
    AltitudeDatum().check(AltitudeReference.MEAN_SEA_LEVEL)
    with pytest.raises(Refused, match=r"telemetry\.takeoff_height_m") as caught:
        AltitudeDatum().check(AltitudeReference.ABOVE_TAKEOFF)
    assert caught.value.reason is Reason.ALTITUDE


class Door:
    """What takes telemetry in, with a queue before it, tick by tick."""

    def __init__(self, scene: Scene) -> None:
        self.trajectories, self.queue = trajectories_of(scene), FairQueue()
        self.receiver = TelemetryReceiver(scene, self.trajectories)
        self.receiver.welcome, self.receiver.part_with = self.queue.know, self.queue.forget
        self.now_ns, self.told = NOW, list[dict[str, str]]()

    def tick(self, *drones: str) -> None:
        """A report of each comes, and is taken in."""
        self.now_ns += TICK_NS
        payload = hovering(self.now_ns - 1).to_protobuf()
        for drone in drones:
            self.queue.put(f"plotfeed/telemetry/{drone}", payload, None)
        while self.queue:
            refusals = self.receiver.take_together(self.queue.take(128), self.now_ns)
            self.told += [json.loads(refusal.payload) for refusal in refusals]

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * S)
        self.receiver.forget_gone(self.now_ns)

    @property
    def known(self) -> set[str]:
        return {name for name in self.trajectories.names if name}


def scene_of(folder: Path, telemetry: str = "") -> Scene:
    sensors = radar(period_s=1.0, sectors=32)
    text = scene_text(telemetry=telemetry, port=1883, drones="", sensors=sensors)
    return load(scene_file(folder, text))


def test_a_drone_without_news_is_forgotten_after_the_time_that_the_scene_says(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "forget_after_s = 20"))
    door.tick("a", "once")
    door.tick("a")
    # One that reported once goes when no sensor can see it.
    for seconds, known in ((8.0, {"a"}), (11.0, {"a"}), (2.0, set())):
        door.wait(seconds)
        assert door.known == known
    assert door.receiver.forgotten == 2
    door.tick("a")
    assert door.known == {"a"}, "and may come again"
    scene = scene_of(tmp_path, "forget_after_s = 1\nstale_after_s = 10")
    door = Door(scene)  # whose sensors see it for longer
    door.tick("a")
    door.tick("a")
    door.wait(10.0 + look_back_s(scene) - 0.1)
    assert door.known == {"a"}


@pytest.mark.parametrize("names_per_tick", [15, 60])
def test_a_flood_of_names_that_report_once_locks_nobody_out(
    tmp_path: Path, names_per_tick: int
) -> None:
    """Drones at 10 Hz that were there stay, those that come get in, with room for a hundred."""
    door, came_in_s = Door(scene_of(tmp_path, "max_drones = 100")), list[float]()
    door.tick("before")
    for tick in range(200):
        flood = [f"flood{tick} {i}" for i in range(names_per_tick)]
        if tick % 10 == 0:
            half = names_per_tick // 2
            flood[half:half] = ["before", "late"] if tick >= 80 else ["before"]
        door.tick(*flood)
        assert len(door.known) <= 100
        assert "before" in door.known
        if "late" in door.known:
            came_in_s.append((tick - 80) / 100)
    assert came_in_s[0] <= 1.0
    assert "late" in door.known
    assert door.receiver.refusals[Reason.TOO_MANY_NEW_DRONES] > 100


def test_after_as_many_names_in_a_second_as_there_is_room_a_new_drone_gets_in_at_once(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "max_new_drones_per_s = 1000000\nmax_drones = 1000"))
    for first in range(0, 1000, 50):
        door.tick(*(f"d{i}" for i in range(first, first + 50)))
    assert len(door.known) == 1000
    door.tick("new")
    assert "new" in door.known
    assert "d0" not in door.known, "the first of those that reported once gives way"
    door.wait(30.0)
    assert door.known == set()
    assert len(door.trajectories.names) == 0


def test_where_all_are_established_and_there_a_new_drone_waits_until_one_is_gone(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "max_drones = 3"))
    for _ in range(2):
        door.tick("a", "b", "c")
    door.tick("d")
    assert door.known == {"a", "b", "c"}
    assert door.told[-1]["reason"] == "too_many_drones"
    for _ in range(60):
        door.now_ns += S // 10
        door.tick("a", "b")
    door.tick("d")
    assert door.known == {"a", "b", "d"}, "c was gone, if not forgotten yet"


def test_names_beyond_the_rate_get_in_as_they_come_again(tmp_path: Path) -> None:
    door = Door(scene_of(tmp_path, "max_new_drones_per_s = 20"))
    swarm = [f"d{i}" for i in range(120)]
    for _ in range(45):
        door.now_ns += S // 10 - TICK_NS
        door.tick(*swarm)
    assert door.known == set(swarm)
    assert 20 * 5 - 20 < door.receiver.refusals[Reason.TOO_MANY_NEW_DRONES] < 120 * 45


SITE = LocalFrame(40.45, -3.73, 650.0)
MAX_SPEED_M_S, G_M_S2 = 150.0, 9.80665
TOPIC = "plotfeed/telemetry/d"


def report(
    t_s: float, enu_m: Floats, velocity_m_s: Velocity = UNKNOWN_VELOCITY, sigma_m: float = math.nan
) -> PositionReport:
    latitude_deg, longitude_deg, height_m = (float(x) for x in SITE.to_geodetic(enu_m))
    return PositionReport(
        t_utc_ns=NOW + round(t_s * S),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=height_m,
        altitude_reference=AltitudeReference.ELLIPSOID,
        velocity_enu_m_s=velocity_m_s,
        horizontal_accuracy_m=sigma_m,
    )


class Sent(Door):
    """A receiver to which one drone's reports come, each when it is made."""

    def say(
        self,
        t_s: float,
        enu_m: Floats,
        *,
        velocity_m_s: Velocity = UNKNOWN_VELOCITY,
        sigma_m: float = math.nan,
        late_s: float = 0.0,
    ) -> bool:
        """Whether it was taken."""
        before, said = self.receiver.taken, report(t_s, enu_m, velocity_m_s, sigma_m)
        now_ns = said.t_utc_ns + round(late_s * S)
        refusal = self.receiver.take(TOPIC, said.to_protobuf(), None, now_ns)
        if refusal is not None:
            self.told.append(json.loads(refusal.payload))
        return self.receiver.taken > before

    def where_m(self, *times_s: float) -> Floats:
        """East, north, up, a row a time; NaN if it is not there."""
        t_utc_ns = np.array([NOW + round(t_s * S) for t_s in times_s])
        who = np.zeros(len(times_s), np.int64)
        return SITE.from_ecef(self.trajectories.position_at(t_utc_ns, who))

    @property
    def reasons(self) -> set[Reason]:
        return set(self.receiver.refusals)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("scene")
    return load(scene_file(folder, scene_text(port=1883, drones="")))


def east(metres: float) -> Floats:
    return np.array([metres, 0.0, 0.0])


def hover(_: float) -> Floats:
    return np.array([100.0, 200.0, 50.0])


def dash(t_s: float) -> Floats:
    return np.array([60.0 * t_s, -300.0, 80.0])


def dive(t_s: float) -> Floats:
    return np.array([85.0 * t_s, 85.0 * t_s, 5000.0 - 85.0 * t_s])


def turn(t_s: float) -> Floats:
    """At 60 m/s with 5 g."""
    radius_m = 60.0**2 / (5 * G_M_S2)
    angle = 60.0 / radius_m * t_s
    return np.array([radius_m * np.sin(angle), radius_m * np.cos(angle), 100.0])


@settings(max_examples=20)
@given(
    st.sampled_from([hover, dash, dive, turn]),
    st.sampled_from([1.0, 2.0, 5.0, 10.0, 50.0]),
    st.sampled_from([math.nan, 0.5, 5.0, 20.0]),
    st.integers(0, 1 << 32),
)
def test_what_drones_can_fly_is_never_implausible(
    scene: Scene, path: object, rate_hz: float, sigma_m: float, seed: int
) -> None:
    """With errors as stated, lost, late, and in the wrong order; a third of them are lost."""
    assert callable(path)
    rng, sent = np.random.default_rng(seed), Sent(scene)
    times_s = np.arange(60) / rate_hz
    order = np.argsort(times_s + rng.choice([0.0, 1.5 / rate_hz], len(times_s)))
    for t_s in times_s[order][rng.random(len(times_s)) > 0.3]:
        error_m = np.nan_to_num(sigma_m, nan=0.5) * rng.standard_normal(3)
        sent.say(t_s, path(t_s) + error_m, sigma_m=sigma_m, late_s=rng.choice([0.0, 0.8]))
    assert sent.reasons <= {Reason.BACKWARDS}


@settings(max_examples=20)
@given(
    st.sampled_from([hover, dash, turn]),
    st.sampled_from([1.0, 5.0, 20.0]),
    st.booleans(),
    st.integers(0, 1 << 32),
)
def test_glitches_never_move_a_drone_further_than_the_gate_lets_them(
    scene: Scene, path: object, rate_hz: float, states_velocity: bool, seed: int
) -> None:
    """Of any size, one report in ten; past a report a drone errs by no more than speeds differ."""
    assert callable(path)
    rng, sent = np.random.default_rng(seed), Sent(scene)
    interval_s = 1.0 / rate_hz
    last_s, last_off_m = 0.0, 0.0
    for k in range(80):
        t_s, glitch_m = k * interval_s, np.zeros(3)
        if k and rng.random() < 0.1:
            direction = rng.standard_normal(3) * [1.0, 1.0, 0.2]
            glitch_m = direction / np.linalg.norm(direction) * 10 ** rng.uniform(0, 4.5)
        velocity = (path(t_s + 1e-3) - path(t_s - 1e-3)) / 2e-3
        said = tuple(float(v) for v in velocity) if states_velocity else UNKNOWN_VELOCITY
        if sent.say(t_s, path(t_s) + glitch_m, velocity_m_s=said):  # type: ignore[arg-type]
            off_m, flown_m = float(np.linalg.norm(glitch_m)), 60.0 * (t_s - last_s)
            assert off_m <= last_off_m + reach_m(t_s - last_s, MAX_SPEED_M_S) + flown_m
            last_s, last_off_m = t_s, off_m
        asked_s = t_s + np.linspace(0.0, 0.99 * interval_s, 4)
        offs_m = np.linalg.norm(sent.where_m(*asked_s) - [path(t) for t in asked_s], axis=1)
        too_fast_m_s = 60.0 + (60.0 if states_velocity else MAX_SPEED_M_S)
        most_m = last_off_m + too_fast_m_s * (asked_s - last_s) + 1e-3
        assert (np.isnan(offs_m) | (offs_m <= most_m)).all()


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 50.0])
def test_a_jump_that_persists_is_a_new_start_and_no_velocity(scene: Scene, rate_hz: float) -> None:
    sent, there_m = Sent(scene), east(2000.0)
    for k in range(20):
        assert sent.say(k / rate_hz, hover(0))
        if k == 10:  # a single one moves nobody
            assert not sent.say((k + 0.5) / rate_hz, hover(0) + there_m)
    assert sent.reasons == {Reason.IMPLAUSIBLE_MOTION}
    assert "telemetry.max_speed_m_s" in sent.told[0]["detail"]
    first, taken_s = 20 / rate_hz, None
    for k in range(20, 20 + round(3 * rate_hz) + 3):
        t_s = k / rate_hz
        if sent.say(t_s, hover(0) + there_m) and taken_s is None:
            taken_s = t_s
    assert taken_s is not None
    assert taken_s - first == pytest.approx(max(CONFIRM_NS / S, 2 / rate_hz), abs=1.01 / rate_hz)
    at_m = sent.where_m(*np.linspace(0.0, t_s + 2.0, 400))
    moved_m = [np.linalg.norm(at_m - place_m, axis=1) for place_m in (hover(0), hover(0) + there_m)]
    assert (np.isnan(at_m).any(axis=1) | (np.minimum(*moved_m) < 1e-3)).all(), "in neither place"


def test_of_two_sources_under_one_name_the_one_that_was_first_goes_on_and_it_is_told_once(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    sent = Sent(scene)
    with caplog.at_level(logging.WARNING):
        for k in range(60):
            assert sent.say(k / 10, hover(0))
            assert not sent.say(k / 10 + 0.03, hover(0) + east(400.0))
    told = [one for one in sent.told if one["reason"] == "second_source"]
    assert len(told) == len(caplog.records) == 1
    assert "400 m apart" in told[0]["detail"]
    assert "latitude" in caplog.text
    assert sent.receiver.refusals[Reason.SECOND_SOURCE] > 50


def test_a_source_that_reports_more_than_twice_as_often_takes_over_and_keeps_the_name(
    scene: Scene,
) -> None:
    sent, other_m, taken = Sent(scene), east(400.0), list[tuple[float, bool]]()
    for k in range(100):
        if k % 10 == 0:
            taken.append((k / 10, sent.say(k / 10, hover(0))))
        other = sent.say(k / 10 + 0.03, hover(0) + other_m)
        assert other == (k / 10 + 0.03 >= 1.03)
    assert [was for t_s, was in taken if t_s > 1.03] == [False] * 8


def test_a_speed_that_no_drone_has_is_refused_and_the_scene_says_how_fast_they_are(
    scene: Scene, tmp_path: Path
) -> None:
    sent = Sent(scene)
    assert not sent.say(0.0, hover(0), velocity_m_s=(200.0, 0.0, 0.0))
    assert sent.say(0.1, hover(0), velocity_m_s=(149.0, 0.0, 0.0))
    assert not sent.say(0.2, hover(0), velocity_m_s=(math.nan, 151.0, math.nan))
    assert sent.reasons == {Reason.IMPLAUSIBLE_MOTION}
    slow = Sent(scene_of(tmp_path, "max_speed_m_s = 20"))
    assert slow.say(0.0, hover(0))
    assert slow.say(1.0, hover(0) + east(GRACE_M + 19.0))
    assert not slow.say(2.0, hover(0) + east(2 * GRACE_M + 50.0))
    assert np.linalg.norm(slow.where_m(1.9) - slow.where_m(1.0)) < 0.9 * 20.01, "nor fitted faster"


@settings(max_examples=15)
@given(st.integers(0, 1 << 32))
def test_it_is_the_same_whether_reports_come_together_or_one_by_one(
    scene: Scene, seed: int
) -> None:
    rng, one_by_one, together = np.random.default_rng(seed), Sent(scene), Sent(scene)
    payloads = []
    for k in range(60):
        t_s = k / 10 + 0.2 * rng.random()
        jump_m = east(500.0 if k % 40 > 20 else 0.0)
        at_m = dash(t_s) + jump_m + (rng.random() < 0.1) * 1000.0 * rng.standard_normal(3)
        payloads.append(report(t_s, at_m).to_protobuf())
    now_ns = NOW + 7 * S
    for payload in payloads:
        one_by_one.receiver.take(TOPIC, payload, None, now_ns)
    for first in range(0, len(payloads), 7):
        batch = [(payload, None) for payload in payloads[first : first + 7]]
        together.receiver.take_together([(TOPIC, batch)], now_ns)
    assert together.receiver.refusals == one_by_one.receiver.refusals
    asked_s = np.linspace(5.0, 8.0, 50)
    one, other = one_by_one.where_m(*asked_s), together.where_m(*asked_s)
    assert np.array_equal(one, other, equal_nan=True)


# What comes in as octets, and what is published of what is not taken.


@pytest.fixture(scope="module")
def of_two(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A scene that knows two drones at most beside its own."""
    text = scene_text(telemetry="max_drones = 2", port=1883)
    return load(scene_file(tmp_path_factory.mktemp("two"), text))


def bytes_of(seconds: float = 0.0, **changes: Any) -> bytes:
    message = pb.Telemetry(
        latitude_deg=40.0, longitude_deg=-3.0, altitude_m=700.0, altitude_reference=pb.ELLIPSOID
    )
    message.time_utc.FromNanoseconds(NOW + round(seconds * S))
    for name, value in changes.items():
        if value is None:
            message.ClearField(name)
        else:
            setattr(message, name, value)
    return message.SerializeToString()


Case = tuple[str, bytes, str | None]
PROTOBUF = "application/x-protobuf"
REFUSED: dict[Reason, Case] = {
    Reason.OVERSIZED: ("a", b"{" + b" " * 5000, None),
    Reason.UNDECODABLE: ("a", b"\xff\xff\xff", PROTOBUF),
    Reason.CONTENT_TYPE: ("a", bytes_of(), "image/png"),
    Reason.MISSING: ("a", bytes_of(latitude_deg=None), PROTOBUF),
    Reason.NOT_FINITE: ("a", bytes_of(altitude_m=float("nan")), PROTOBUF),
    Reason.OUT_OF_RANGE: ("a", bytes_of(latitude_deg=91.0), PROTOBUF),
    Reason.ALTITUDE: ("a", bytes_of(altitude_reference=pb.ABOVE_TAKEOFF), PROTOBUF),
    Reason.BACKWARDS: ("known", bytes_of(-2.0), PROTOBUF),
    Reason.DUPLICATE: ("known", bytes_of(-1.0), PROTOBUF),
    Reason.FUTURE: ("a", bytes_of(2.1), PROTOBUF),
    Reason.STALE: ("a", bytes_of(-60.1), PROTOBUF),
    Reason.LATE: ("a", bytes_of(-59.9), PROTOBUF),
    Reason.IMPLAUSIBLE_MOTION: ("known", bytes_of(latitude_deg=40.1), PROTOBUF),
    Reason.TOO_MANY_DRONES: ("third", bytes_of(), PROTOBUF),
    Reason.NAME: ("visitor", bytes_of(), PROTOBUF),
}


NOT_OF_ONE_REPORT = {
    *(Reason.FLOOD, Reason.CONTROL, Reason.SECOND_SOURCE, Reason.TOO_MANY_NEW_DRONES),
    Reason.NO_POSITION,  # which live sources find
}


@pytest.mark.parametrize("reason", REFUSED, ids=str)
def test_a_refusal_is_published_with_its_reason(reason: Reason, of_two: Scene) -> None:
    assert {*REFUSED} == {*Reason} - NOT_OF_ONE_REPORT
    door = Door(of_two)
    receiver, trajectories = door.receiver, door.trajectories
    receiver.take("plotfeed/telemetry/known", bytes_of(-1.0), PROTOBUF, NOW)
    if reason is Reason.TOO_MANY_DRONES:
        receiver.take("plotfeed/telemetry/second", bytes_of(-1.0), PROTOBUF, NOW)
    names, version = list(trajectories.names), trajectories.version
    drone, payload, content_type = REFUSED[reason]
    topic = f"plotfeed/telemetry/{drone}"
    refusal = receiver.take(topic, payload, content_type, NOW)
    assert refusal is not None
    assert refusal.topic == "plotfeed/errors"
    assert refusal.content_type == "application/json"
    told = json.loads(refusal.payload)
    assert told["reason"] == reason.value
    assert told["topic"] == topic
    assert told["drone"] == drone
    assert told["detail"].isprintable()
    assert (reason is Reason.NAME) == ("flown by the scene itself" in told["detail"])
    assert told["count"] == "1"
    assert told["time_utc"] == "2026-01-01T12:00:00Z"
    assert receiver.refused == 1
    assert (trajectories.names, trajectories.version) == (names, version)


def test_the_datum_of_the_scene_is_added(tmp_path: Path) -> None:
    text = scene_text(telemetry="takeoff_height_m = 650.0\ngeoid_undulation_m = 51.0", port=1883)
    door = Door(load(scene_file(tmp_path, text)))
    receiver, trajectories = door.receiver, door.trajectories
    for drone, reference, altitude_m in (
        ("a", pb.ELLIPSOID, 751.0),
        ("b", pb.MEAN_SEA_LEVEL, 700.0),
        ("c", pb.ABOVE_TAKEOFF, 101.0),
    ):
        payload = bytes_of(altitude_m=altitude_m, altitude_reference=reference)
        assert receiver.take(f"plotfeed/telemetry/{drone}", payload, None, NOW) is None
    positions = trajectories.state_at(NOW).position_ecef_m
    assert abs(positions - positions[0]).max() < 1e-8
    (block,) = TargetEncoder129(country="ES").blocks(["d"], [NOW], [40], [-3], altitude_m=[700])
    for drone in ("d", "e"):  # by its content type, and by its looks
        content_type = "application/x-asterix; cat=129" if drone == "d" else None
        assert receiver.take(f"plotfeed/telemetry/{drone}", block, content_type, NOW) is None
    positions = trajectories.state_at(NOW).position_ecef_m
    assert abs(positions - positions[0]).max() < 0.05
    assert (receiver.taken, trajectories.names) == (5, [*"abcde"])


def test_refusals_are_published_up_to_a_rate_and_all_are_counted(of_two: Scene) -> None:
    receiver = Door(of_two).receiver

    def take(t_ns: int) -> Message | None:
        return receiver.take("plotfeed/telemetry/a", b"\xff", PROTOBUF, t_ns)

    published = [take(NOW + i) for i in range(500)]
    assert sum(m is not None for m in published) == MAX_REFUSALS_PER_S
    assert receiver.refused == 500
    later = take(NOW + S)
    assert later is not None
    assert json.loads(later.payload)["count"] == "501"


def test_a_class_that_is_reported_is_that_of_the_drone_and_of_its_echoes(of_two: Scene) -> None:
    door = Door(of_two)
    receiver, trajectories = door.receiver, door.trajectories
    said = bytes_of(-0.1, target_class="aircraft", size_m=35.8, rcs_m2=20.0)
    assert receiver.take("t/telemetry/airliner", said, PROTOBUF, NOW) is None
    assert receiver.take("t/telemetry/own", bytes_of(-0.1), PROTOBUF, NOW) is None
    signatures = trajectories.signatures
    rows = np.array([list(trajectories.names).index(name) for name in ("airliner", "own")])
    assert signatures.target_class[rows].tolist() == ["aircraft", "drone"]
    assert signatures.size_m[rows].tolist() == [35.8, of_two.telemetry.size_m]
    assert signatures.rcs_m2[rows].tolist() == [20.0, of_two.telemetry.rcs_m2]
    targets = (TargetKeys(target_class="aircraft", swerling=3), TargetKeys(swerling=1))
    echoes = EchoesByClass(targets).of(["aircraft", "drone", "bird"])
    assert [None if n < 0 else echoes.kinds[n].swerling for n in echoes.kind] == [3, 1, None]
