"""What drones say of themselves: reports in 129 and as telemetry, faults, the ledger, commands."""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.significance import assert_standard_normal, assert_sum, assert_uncorrelated

from plotfeed.feeds.engine.scene_drones import launch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import RecordedTelemetry, Recorder, SessionRecorder
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport, decode
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_cooperative import UasReport, read_129
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, Feed, flown, fly, held, radar, scene, waypoint

UNDULATION_M = 51.0
DATUM = {"geoid_undulation_m": UNDULATION_M}
PATH = (waypoint(300.0, 5.0, 3000.0), waypoint(80.0, 5.0, 3000.0))
QUIET = radar(scan={"kind": "staring", "period_s": 30.0}, report=["plots"])
CONTROL = "plotfeed/control"
FAR = {"east_m": 9000.0, "north_m": -4000.0, "above_site_m": 300.0}


def claiming(
    *faults: dict[str, Any], cooperative: dict[str, Any] | None = None, **more: Any
) -> Scene:
    drone = flown("a", *PATH, claim=faults)
    said = {"report": ["json"]} | (cooperative or {})
    return scene([QUIET], [drone | more], seed=41, telemetry=DATUM, cooperative=said)


def claimed(road: Feed) -> dict[int, PositionReport]:
    """What drone a said, by when it was due, seconds from the start."""
    return {
        (m.due_utc_ns - START_NS) // NS: decode(m.payload, m.content_type)
        for m in road.messages
        if m.topic == "plotfeed/claimed/a"
    }


def truths(road: Feed) -> dict[int, pb.Claim]:
    """What the ledger says of the same."""
    return {
        entry.scan - START_NS // NS: claim
        for entry in road.ledgers
        if entry.sensor == "cooperative"
        for claim in entry.claims
    }


def error_m(claim: pb.Claim) -> list[float]:
    return [claim.error_east_m, claim.error_north_m, claim.error_up_m]


def enu_m(report: PositionReport | pb.Claim) -> Floats:
    height_m = report.altitude_m if isinstance(report, PositionReport) else report.height_m
    return SITE.from_ecef(geodetic_to_ecef(report.latitude_deg, report.longitude_deg, height_m))


@pytest.mark.parametrize("form", ["json", "protobuf"])
def test_what_is_claimed_is_telemetry_and_true_without_a_fault(form: str) -> None:
    road = fly(claiming(cooperative={"report": ["asterix-129", form]}), 6.0)
    said, true = claimed(road), truths(road)
    assert sorted(said) == sorted(true) == [1, 2, 3, 4, 5, 6]
    for second, report in said.items():
        assert report.t_utc_ns == START_NS + second * NS
        assert enu_m(report) == pytest.approx(enu_m(true[second]), abs=1e-6)
        assert error_m(true[second]) == pytest.approx([0.0] * 3, abs=1e-6)
    assert len(road.payloads("cooperative/asterix/129")) == 6
    steps = np.diff([enu_m(report) for report in said.values()], axis=0)
    assert said[3].velocity_enu_m_s == pytest.approx(steps[2], abs=0.05)


def test_sensors_see_the_drone_where_it_is_whatever_it_says() -> None:
    first, second = (
        fly(scene([radar(report=["plots"])], [flown("a", *PATH, claim=claim)], seed=42,
                  cooperative={}, telemetry=DATUM), 10.0).payloads("radar/plots")
        for claim in ([], [{"from_s": 0.0, "spoof": FAR}])
    )  # fmt: skip
    assert first == second


def test_a_bias_and_a_spoof_are_told_and_the_ledger_knows_how_much() -> None:
    faults = [
        {"from_s": 2.0, "to_s": 4.0, "bias_enu_m": [30.0, -20.0, 10.0]},
        {"from_s": 5.0, "to_s": 8.0, "spoof": FAR | {"drag_m_s": 15.0}},
        {"from_s": 9.0, "spoof": FAR},
    ]
    road = fly(claiming(*faults), 12.0)
    said, true = claimed(road), truths(road)
    for second in (2, 3):
        assert error_m(true[second]) == pytest.approx([30.0, -20.0, 10.0], abs=0.01)
    for second in (1, 4, 8):
        assert error_m(true[second]) == pytest.approx([0.0] * 3, abs=1e-6)
        assert not true[second].faults
    for second in (5, 6, 7):
        assert np.linalg.norm(error_m(true[second])) == pytest.approx(15.0 * (second - 5), abs=0.01)
        assert list(true[second].faults) == ["spoof"]
    assert enu_m(said[10])[:2] == pytest.approx([9000.0, -4000.0], abs=1.0)
    assert said[10].velocity_enu_m_s == pytest.approx((0.0, 0.0, 0.0))
    assert error_m(true[10])[0] == pytest.approx(9000.0 - enu_m(true[10])[0], abs=5.0)


def test_what_is_frozen_stays_and_what_is_late_tells_of_before() -> None:
    faults = [
        {"from_s": 2.0, "to_s": 5.0, "freeze": True},
        {"from_s": 7.0, "to_s": 12.0, "delay_s": 2.0},
    ]
    road = fly(claiming(*faults), 14.0)
    said, true = claimed(road), truths(road)
    places = [enu_m(said[second]) for second in (2, 3, 4)]
    assert np.ptp(places, axis=0).max() < 1e-6
    assert said[4].t_utc_ns == START_NS + 4 * NS
    assert np.linalg.norm(error_m(true[4])) == pytest.approx(20.0, abs=0.05)
    assert not {7, 8} & said.keys()  # what it would say is still on its way
    for second in (9, 10, 11):
        assert said[second].t_utc_ns == START_NS + (second - 2) * NS
        assert np.linalg.norm(error_m(true[second])) == pytest.approx(0.0, abs=1e-6)
    assert said[12].t_utc_ns == START_NS + 12 * NS


def test_reports_drop_out_as_often_as_asked_each_by_itself() -> None:
    made = claiming(
        {"from_s": 0.0, "drop_out": 0.3}, cooperative={"period_s": 0.1, "report": ["protobuf"]}
    )
    road = fly(made, 200.0)
    entries = [entry for entry in road.ledgers if entry.sensor == "cooperative"]
    is_said = np.array([claim.HasField("error_east_m") for e in entries for claim in e.claims])
    assert len(is_said) == 2000
    assert is_said.sum() == len(road.payloads("claimed/a"))
    assert_sum(is_said.sum(), 1400.0, 2000 * 0.3 * 0.7, "reports")
    assert_uncorrelated(is_said[1:].astype(float), is_said[:-1].astype(float), "neighbours")


def test_a_walk_spreads_as_the_square_root_of_time() -> None:
    """By the differences of many drones' errors."""
    swarm = {
        "id": "s", "number": 60, "formation": {"kind": "grid", "spacing_m": 10.0},
        "path": PATH, "speed_m_s": 10.0,
        "claim": [{"from_s": 0.5, "walk_m": 2.0}],
    }  # fmt: skip
    made = scene(
        [QUIET], seed=43, telemetry=DATUM, swarm=[swarm], cooperative={"report": ["protobuf"]}
    )
    road = fly(made, 16.0)
    entries = [e for e in road.ledgers if e.sensor == "cooperative"]
    errors_m = np.array([[error_m(c) for c in e.claims] for e in entries])  # (16, 60, 3)
    assert_standard_normal(errors_m[0].ravel() / (2.0 * 0.5**0.5), "the half second before")
    steps = np.diff(errors_m, axis=0)
    assert_standard_normal(steps[:, :, :2].ravel() / 2.0, "steps of 1 s")
    assert_standard_normal(errors_m[-1].ravel() / (2.0 * 15.5**0.5), "after 15.5 s")


class Commands(Observer):
    """Hands in commands as of times of a simulated clock, as whoever is connected might."""

    def __init__(self, *commands: tuple[float, dict[str, Any]]) -> None:
        self._commands = list(commands)

    def begun(self, session: RunningSession) -> None:
        self._session = session

    def next_input_ns(self) -> int | None:
        return START_NS + round(self._commands[0][0] * NS) if self._commands else None

    def before_due(self, due_utc_ns: int) -> None:
        while (at_ns := self.next_input_ns()) is not None and at_ns < due_utc_ns:
            _, command = self._commands.pop(0)
            self._session.intake.receive([(CONTROL, json.dumps(command).encode(), None)], at_ns)


COMMANDS = (
    (2.305, {"drone": "a", "claim": {"bias_enu_m": [50.0, 0.0, 0.0], "walk_m": 1.0}}),
    (4.111, {"drone": "a", "contingency": {"kind": "fly-away", "speed_m_s": 18.0}}),
    (7.005, {"drone": "a", "reset": True}),
    (8.005, {"drone": "nobody", "reset": True}),
    (9.005, {"drone": "a", "contingency": {"kind": "hold"}}),
    (9.505, {"drone": "a", "contingency": {"kind": "hold", "for_s": 5.0, "at_s": 3.0}}),
)


async def flown_with(made: Scene, *observers: Observer) -> Feed:
    messages: list[Message] = []
    await run(
        made,
        clock=InstantClock(START_NS),
        broker="none",
        duration_s=14.0,
        tap=lambda message, _t: messages.append(message),
        observers=observers,
    )
    return Feed(messages)


@pytest.mark.asyncio
async def test_commands_act_at_once_are_recorded_and_run_again_to_the_bit(tmp_path: Path) -> None:
    made = scene(
        [radar(report=["plots"])],
        [flown("a", *PATH)],
        seed=44,
        telemetry=DATUM,
        cooperative={"report": ["json"], "accuracy_m": 1.0},
    )
    path = tmp_path / "record.mcap"
    with Recorder(path, waits=True) as recorder:
        observers = [SessionRecorder(recorder, ledger_is_sent=True), Commands(*COMMANDS)]
        first = await flown_with(made, *observers)
    true = truths(first)
    assert [list(true[s].faults) for s in (2, 3, 7, 8)] == [
        [],
        ["bias", "walk"],
        ["bias", "walk"],
        [],
    ]
    assert [true[s].contingency for s in (4, 5, 9, 10)] == ["", "fly-away", "fly-away", "hold"]
    places = np.array([enu_m(true[s]) for s in (6, 8, 12, 13)])
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(36.0, abs=0.5)
    assert np.linalg.norm(places[3] - places[2]) < 6.0  # it brakes from 18 m/s in 4.5 s
    errors = [json.loads(payload)["detail"] for payload in first.payloads("errors")]
    assert "the scene flies no 'nobody'; expected one of a" in errors[0]
    assert "it happens at once" in errors[1]
    again = await flown_with(made, RecordedTelemetry(path))
    kept = [
        sorted((m.topic, m.payload) for m in road.messages if not m.topic.endswith("/session"))
        for road in (first, again)
    ]
    assert kept[0] == kept[1]
    assert len(first.payloads("radar/plots")) == 14


@pytest.mark.asyncio
async def test_a_command_to_one_that_says_nothing_is_refused() -> None:
    made = scene([QUIET], [flown("a", *PATH)], seed=45, telemetry=DATUM)
    road = await flown_with(made, Commands((1.0, {"drone": "a", "claim": {"freeze": True}})))
    (refusal,) = road.payloads("errors")
    assert "drone 'a' says nothing: it is not [cooperative]" in json.loads(refusal)["detail"]


# Drones that report themselves in 129, and a second session that takes what they say.


TOPIC = "plotfeed/cooperative/asterix/129"
MIDNIGHT_NS = (START_NS // (86_400 * NS) + 1) * 86_400 * NS


def drones() -> list[dict[str, Any]]:
    return [
        flown("a", *PATH),
        flown("b", waypoint(30.0, 5.0, 1000.0), waypoint(20.0, 15.0, 2000.0), speed_m_s=22.0),
        held("c", 100.0, 5.0, 2000.0, start_s=10.0),
    ]


def flight(cooperative: dict[str, Any] | None = None, **more: Any) -> Scene:
    given = {} if cooperative is None else {"cooperative": cooperative}
    return scene([radar(report=["plots"])], drones(), seed=221, telemetry=DATUM, **given, **more)


def reports(road: Feed) -> dict[str, list[UasReport]]:
    found: dict[str, list[UasReport]] = {}
    for payload in road.payloads("cooperative/asterix/129"):
        (report,) = read_129(payload)
        found.setdefault(report.identity, []).append(report)
    return found


def test_the_table_changes_nothing_else() -> None:
    """Of sectors: what cooperative drones say is told in messages of the same turns."""
    quiet, loud = (fly(each, 20.0) for each in (flight(), flight({"accuracy_m": 3.0})))

    def said(road: Feed) -> list[Message]:
        own = [m for m in road.messages if ("source", "plotfeed/cooperative") not in m.properties]
        return [m for m in own if not m.topic.endswith(("status", "truth", TOPIC))]

    told = [[e for e in road.ledgers if e.sensor == "radar"] for road in (quiet, loud)]
    assert said(loud) == said(quiet)
    assert len(told[0]) == 20
    assert told[0] == told[1]


def test_reports_come_at_whole_periods_from_those_that_are_there() -> None:
    road = fly(flight({"period_s": 0.5, "sac": 4, "sic": 5}), 15.0, START_NS + NS // 4)
    mine = [m for m in road.messages if m.topic == TOPIC]
    assert {m.content_type for m in mine} == {"application/x-asterix; cat=129"}
    due = np.array([m.due_utc_ns for m in mine])
    assert (due % (NS // 2) == 0).all()
    assert len({dict(m.properties)["id"] for m in mine}) == len(mine)
    said = reports(road)
    assert {name: len(of) for name, of in said.items()} == {"a": 30, "b": 30, "c": 10}
    for message in mine:
        (report,) = read_129(message.payload)
        assert report.t_of_day_s == message.due_utc_ns % (86_400 * NS) / NS
        assert dict(message.properties)["drone"] == report.identity
    for record in road.records("cooperative", 129):
        assert (record.get("I129/010/SAC"), record.get("I129/010/SIC")) == (4, 5)


def test_only_those_named_report() -> None:
    assert set(reports(fly(flight({"drones": ["b"]}), 5.0))) == {"b"}


@pytest.mark.parametrize("start_ns", [START_NS, MIDNIGHT_NS - 10 * NS])
def test_a_second_session_sees_the_same_path_to_the_steps_of_129(start_ns: int) -> None:
    """Also over midnight. Steps: 180/2^30 degrees, 0.1 m, 0.01 m/s."""
    road = fly(flight({"drones": ["a", "b"]}), 20.0, start_ns)
    taken = Trajectories(stale_after_s=3.0)
    other = scene([radar(report=["plots"])], seed=222, telemetry=DATUM)
    intake = TelemetryReceiver(other, taken)
    for message in (m for m in road.messages if m.topic == TOPIC):
        (report,) = read_129(message.payload)
        topic = f"plotfeed/telemetry/{report.identity}"
        refusal = intake.take(
            topic, message.payload, message.content_type, message.due_utc_ns + NS // 10
        )
        assert refusal is None
    assert taken.names == ["a", "b"]
    truth = Trajectories(stale_after_s=3.0)
    launch(flight(), truth, start_ns)
    for t_ns in (start_ns + k * NS // 4 for k in range(4, 80)):
        state, true = (each.state_at(t_ns, np.arange(2)) for each in (taken, truth))
        off_m = SITE.rotate_from_ecef(state.position_ecef_m - true.position_ecef_m)
        assert np.abs(off_m[:, :2]).max() < 0.015
        assert np.abs(off_m[:, 2]).max() < 0.055
        # Heights come in steps, from which velocities between reports follow.
        most_m_s = 0.5 if t_ns % NS else 0.01
        assert np.abs(state.velocity_ecef_m_s - true.velocity_ecef_m_s).max() < most_m_s


def test_errors_are_normal_and_new_each_time() -> None:
    """Within the steps of the category, 2 cm and 10 cm, beside 4 m."""
    fixed, said_by = [held("c", 100.0, 5.0, 2000.0)], {"accuracy_m": 4.0, "period_s": 0.25}
    made = scene([QUIET], fixed, seed=223, telemetry=DATUM, cooperative=said_by)
    said = reports(fly(made, 300.0))["c"]
    place = np.array([[r.latitude_deg, r.longitude_deg, r.altitude_m + UNDULATION_M] for r in said])
    errors_m = LocalFrame(**waypoint(100.0, 5.0, 2000.0)).from_ecef(geodetic_to_ecef(*place.T))
    for axis in range(3):
        assert_standard_normal(errors_m[:, axis] / 4.0, f"axis {axis}")
        assert_uncorrelated(errors_m[1:, axis], errors_m[:-1, axis])
    assert {r.accuracy_m for r in said} == {5.0}  # 1.1774 times 4 m, in steps of 1 m


def faulty(**fault: Any) -> dict[str, Any]:
    return {"drone": [held("a", 0.0, 5.0, 900.0, claim=[fault])]}


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"cooperative": {"drones": ["nobody"]}}, "flies no drone 'nobody'"),
        ({"cooperative": {"report": ["json", "protobuf", "json"]}}, "report: each format once"),
        ({"cooperative": {"country": "Spain"}}, "country"),
        ({"drone": [held("thirteen-char", 0.0, 5.0, 900.0)]}, "up to 12 characters"),
        ({"drone": [held("dróne", 0.0, 5.0, 900.0)]}, "ASCII"),
        ({"sensor": [radar(id="cooperative")]}, "is a topic of the session"),
        (faulty(from_s=1.0), r"claim\[0\] of 'a': drop_out, delay_s, bias"),
        (faulty(freeze=True), r"claim\[0\].from_s of 'a': missing"),
        (faulty(from_s=4.0, to_s=3.0, freeze=True), r"claim\[0\].to_s of 'a': must be above"),
        (faulty(from_s=4.0, freeze=True, spoof=FAR), "what is frozen cannot be spoofed"),
        (faulty(from_s=1.0, freeze=True) | {"cooperative": None}, r"drone\[0\].claim of 'a': the"),
    ],
)
def test_what_cannot_be_said_is_refused_before_anything_starts(
    more: dict[str, Any], words: str
) -> None:
    given = {"cooperative": {}, "telemetry": DATUM} | more
    flying, sensors = given.pop("drone", drones()), given.pop("sensor", [radar()])
    told = {name: keys for name, keys in given.items() if keys is not None}
    with pytest.raises(SceneError, match=words):
        scene(sensors, flying, seed=1, **told)


@pytest.mark.parametrize(
    ("sensors", "taken"), [([], True), (["cooperative"], True), (["radar"], False)]
)
def test_udp_takes_them_by_name(sensors: list[str], taken: bool) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.setblocking(False)
        destination = f"127.0.0.1:{listener.getsockname()[1]}"
        udp = [{"destination": destination, "sensors": sensors}]
        road = fly(flight({"drones": ["a", "b", "c"], "period_s": 1.0}, udp=udp), 5.0)
        got = []
        with suppress(BlockingIOError):
            while True:
                got.append(listener.recv(65_535))
    expected = road.payloads("cooperative/asterix/129")
    assert [p for p in got if p[0] == 129] == (expected if taken else [])
