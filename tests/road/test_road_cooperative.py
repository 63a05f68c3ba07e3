"""Drones that report themselves in 129, and a second session that takes what they say."""

from __future__ import annotations

import socket
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.significance import assert_standard_normal, assert_uncorrelated

from plotfeed.feeds.engine.scene_drones import launch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_cooperative import UasReport, read_129
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, Feed, flown, fly, held, radar, scene, waypoint

UNDULATION_M = 51.0
DATUM = {"geoid_undulation_m": UNDULATION_M}
TOPIC = "plotfeed/cooperative/asterix/129"
MIDNIGHT_NS = (START_NS // (86_400 * NS) + 1) * 86_400 * NS


def drones() -> list[dict[str, Any]]:
    return [
        flown("a", waypoint(300.0, 5.0, 3000.0), waypoint(80.0, 5.0, 3000.0)),
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


def test_without_the_table_nobody_reports() -> None:
    assert not [m for m in fly(flight(), 5.0).messages if "cooperative" in m.topic]


def test_the_table_changes_nothing_else() -> None:
    quiet, loud = (fly(each, 20.0) for each in (flight(), flight({"accuracy_m": 3.0})))

    def said(road: Feed) -> list[Message]:
        own = [m for m in road.messages if ("source", "plotfeed/cooperative") not in m.properties]
        return [m for m in own if not m.topic.endswith(("status", "truth", TOPIC))]

    def told(road: Feed) -> list[pb.Ledger]:
        """Of sectors: what cooperative drones say is told in messages of the same turns."""
        payloads = [m.payload for m in road.messages if m.topic.endswith("truth")]
        entries = [entry for payload in payloads for entry in entries_in(payload)]
        return [entry for entry in entries if entry.sensor == "radar"]

    assert said(loud) == said(quiet)
    assert len(told(quiet)) == 20
    assert told(loud) == told(quiet)


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


def true_path(t_utc_ns: list[int]) -> tuple[Floats, Floats]:
    """Where a and b are at those times, ECEF, and how fast."""
    trajectories = Trajectories(stale_after_s=3.0)
    launch(flight(), trajectories, t_utc_ns[0])
    states = [trajectories.state_at(t, np.arange(2)) for t in t_utc_ns]
    return (
        np.array([s.position_ecef_m for s in states]),
        np.array([s.velocity_ecef_m_s for s in states]),
    )


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
    times_ns = [start_ns + k * NS // 4 for k in range(4, 80)]
    position_m, velocity_m_s = true_path([start_ns, *times_ns])
    for k, t_ns in enumerate(times_ns, 1):
        state = taken.state_at(t_ns, np.arange(2))
        off_m = SITE.rotate_from_ecef(state.position_ecef_m - position_m[k])
        assert np.abs(off_m[:, :2]).max() < 0.015
        assert np.abs(off_m[:, 2]).max() < 0.055
        assert np.abs(state.velocity_ecef_m_s - velocity_m_s[k]).max() < 0.5  # heights in steps
        if t_ns % NS == 0:
            assert np.abs(state.velocity_ecef_m_s - velocity_m_s[k]).max() < 0.01


@cache
def noisy() -> Feed:
    fixed = [held("c", 100.0, 5.0, 2000.0)]
    return fly(
        scene(
            [radar(report=["plots"], scan={"kind": "staring", "period_s": 60.0})],
            fixed,
            seed=223,
            telemetry=DATUM,
            cooperative={"accuracy_m": 4.0, "period_s": 0.25},
        ),
        500.0,
    )


def test_errors_are_normal_and_new_each_time() -> None:
    """Within the steps of the category, 2 cm and 10 cm, beside 4 m."""
    said = reports(noisy())["c"]
    place = waypoint(100.0, 5.0, 2000.0)
    frame = LocalFrame(**place)
    errors_m = frame.from_ecef(
        geodetic_to_ecef(
            [r.latitude_deg for r in said],
            [r.longitude_deg for r in said],
            [r.altitude_m + UNDULATION_M for r in said],
        )
    )
    for axis in range(3):
        assert_standard_normal(errors_m[:, axis] / 4.0, f"axis {axis}")
        assert_uncorrelated(errors_m[1:, axis], errors_m[:-1, axis])
    assert {r.accuracy_m for r in said} == {5.0}  # 1.1774 times 4 m, in steps of 1 m


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"cooperative": {"drones": ["nobody"]}}, "flies no drone 'nobody'"),
        ({"drone": [held("thirteen-char", 0.0, 5.0, 900.0)]}, "up to 12 characters"),
        ({"drone": [held("dróne", 0.0, 5.0, 900.0)]}, "ASCII"),
        ({"sensor": [radar(id="cooperative")]}, "is a topic of the session"),
        ({"cooperative": {"country": "Spain"}}, "country"),
    ],
)
def test_what_cannot_be_said_is_refused_before_anything_starts(
    more: dict[str, Any], words: str
) -> None:
    given = {"cooperative": {}, "telemetry": DATUM} | more
    flying, sensors = given.pop("drone", drones()), given.pop("sensor", [radar()])
    with pytest.raises(SceneError, match=words):
        scene(sensors, flying, seed=1, **given)


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
