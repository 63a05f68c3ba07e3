"""What a session is asked while it runs: sensors, time, mounts that look, tasks of SAPIENT."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from support.brokers import free_port, mosquitto, own_broker
from support.sapient_middleware import Peer, listening
from support.sapient_rules import ONE, THREE, TWO, checked, checked_together, task
from support.scene_files import radar as radar_text
from support.scene_files import scene_file, scene_text
from support.sessions import Asked, AtWork, at_work, simulated
from support.waiting import until

from plotfeed.feeds.formats.sapient.sapient_announcer import MAX_TASKS_PER_S
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.sapient.encode_sapient import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH
from plotfeed.proto.sapient.envelope import node_id
from plotfeed.testing import START_NS, MqttMessage, MqttReceiver, held, radar, scene, staring

CUE, CONTROL = "plotfeed/camera/cue", "plotfeed/control"
TASK, INBOX = (f"plotfeed/{sensor}/sapient/task" for sensor in ("camera", "radar"))
ACCEPTED, REJECTED, COMPLETED = (
    TaskAck.TASK_STATUS_ACCEPTED,
    TaskAck.TASK_STATUS_REJECTED,
    TaskAck.TASK_STATUS_COMPLETED,
)


EAST = {"azimuth_deg": 90.0, "elevation_deg": 6.0}
DRONES = [held("north", 0.0, 6.0, 900.0), held("east", 90.0, 6.0, 900.0)]


def camera(**changes: Any) -> dict[str, Any]:
    return {
        "id": "camera", "type": "camera", "scan": staring(0.1), "range_max_m": 5000.0,
        "horizontal_fov_deg": 20.0, "pixels_across": 8000, "pixels_down": 6000,
        "false_alarms_per_frame": 0.5, "mount": {"dwell_s": 3.0}, "report": ["plots", "sapient"],
        "tilt_deg": 6.0,
    } | changes  # fmt: skip


def flown(*asked: Asked, for_s: float = 12.0, made: Scene | None = None) -> AtWork:
    return simulated(made or scene([camera()], DRONES, seed=4), for_s, asked)


def drones_between(ran: AtWork, from_s: float, to_s: float) -> set[str]:
    """Drones that were looked at in that time after the beginning."""
    from_ns, to_ns = (START_NS + round(at_s * 1e9) for at_s in (from_s, to_s))
    looks = [look for entry in ran.entries for look in entry.looks]
    return {look.drone for look in looks if from_ns < look.time_utc_ns < to_ns}


class Node:
    """What the node of a session says that is asked something, each so many seconds on."""

    def __init__(self, ran: AtWork, sensor: str = "radar") -> None:
        self.ran, self.totals = ran, ran.totals
        self.said = [checked(payload) for payload in ran.on(f"{sensor}/sapient")]
        checked_together(self.said)

    @property
    def acks(self) -> list[tuple[str, int, str]]:
        found = [m.task_ack for m in self.said if m.HasField("task_ack")]
        return [(ack.task_id, ack.task_status, "; ".join(ack.reason)) for ack in found]

    def of(self, content: str) -> list[SapientMessage]:
        return [m for m in self.said if m.WhichOneof("content") == content]

    def said_at(self, after_s: float) -> list[str | None]:
        near = [m for m in self.said if abs(seconds(m) - after_s) < 0.005]
        return [m.WhichOneof("content") for m in near if not m.HasField("detection_report")]


def seconds(message: SapientMessage) -> float:
    return (message.timestamp.ToNanoseconds() - START_NS) / 1e9


def asked(
    *tasks: tuple[float, bytes], for_s: float = 4.0, made: Scene | None = None, **keys: Any
) -> Node:
    of = radar(report=["sapient"], scan=staring(0.1), pfa=1e-5, **keys)
    made = made or scene([of], [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)], seed=3)
    return Node(simulated(made, for_s, [(after_s, INBOX, said) for after_s, said in tasks]))


def test_a_cue_turns_it_for_its_dwell_and_then_it_goes_home() -> None:
    ran = flown((2.0, CUE, json.dumps(EAST).encode()))
    assert drones_between(ran, 0.0, 2.1) == {"north"}
    assert drones_between(ran, 2.5, 4.2) == set()  # it turns
    assert drones_between(ran, 4.6, 7.3) == {"east"}
    assert drones_between(ran, 9.9, 12.0) == {"north"}
    assert (ran.totals.controls, ran.totals.refused) == (1, 0)
    told = {each["mount"]["cued_by"]: each["mount"] for each in ran.told("camera/status")}
    assert set(told) == {"", "cue"}
    assert told["cue"]["pan_deg"] == pytest.approx(90.0)
    assert told["cue"]["tilt_deg"] == pytest.approx(6.0)
    assert told["cue"]["settled"]


def test_a_place_and_a_dwell_of_its_own() -> None:
    place = {"latitude_deg": 40.45, "longitude_deg": -3.7194, "height_m": 745.0, "dwell_s": 5.0}
    ran = flown((1.0, CUE, json.dumps(place).encode()), for_s=9.0)
    assert drones_between(ran, 3.6, 8.2) == {"east"}


WRONG = {
    (CUE, b"{"): "expected an object of JSON such as",
    (CUE, b"[1]"): "expected an object of JSON such as",
    (CUE, b"{}"): "expected azimuth_deg, or latitude_deg",
    (CUE, b'{"azimuth_deg": 1e9}'): "azimuth_deg: input should be less than or equal to 360",
    (CUE, b'{"azimut_deg": 1.0}'): "azimut_deg: no such key; did you mean azimuth_deg?",
    (CUE, b'{"latitude_deg": 4.0}'): "a place has latitude_deg, longitude_deg and height_m",
    (CUE, b"\xff" * 70_000): "70000 octets: at most",
    ("plotfeed/nobody/cue", b"{}"): "no sensor that a mount turns; expected one of camera",
    (CONTROL, b'{"clock": {"speed": 10}}'): "real time cannot be held or hurried",
    (CONTROL, b"[]"): "expected an object",
    (
        CONTROL,
        b'{"sensor": "nobody", "reset": true}',
    ): "there is no 'nobody'; expected one of camera",
    (CONTROL, b'{"sensor": "camera", "set": {"link": {"latency": 5}}}'): "latency",
    (CONTROL, b" " * (1 << 17)): "at most 65536",
}


def test_what_cannot_be_asked_is_refused_in_a_line_and_counted() -> None:
    asked = [(0.1 * (i + 1), topic, payload) for i, (topic, payload) in enumerate(WRONG)]
    ran = flown(*asked, for_s=2.0)
    errors = ran.told("errors")
    for number, (((topic, _), text), error) in enumerate(
        zip(WRONG.items(), errors, strict=True), 1
    ):
        assert text in error["detail"]
        assert error["detail"].isprintable()
        expected = {"topic": topic, "drone": "", "reason": "control", "count": str(number)}
        assert error.items() >= expected.items()
    assert ran.totals.refused == len(WRONG)
    assert drones_between(ran, 0.0, 2.0) == {"north"}


def cone(**angles: float) -> dict[str, Any]:
    return {"range_bearing": {"coordinate_system": DEG_M, "datum": TRUE_NORTH, **angles}}


LOOK_EAST = task(ONE, look_at=cone(azimuth=90.0, elevation=6.0))


def test_a_sapient_task_makes_it_look_until_another_takes_its_place_or_it_is_stopped() -> None:
    """By a direction, and by a place."""
    south = {"x": -3.73, "y": 40.4419, "z": 745.0, "coordinate_system": LAT_LNG, "datum": ELLIPSOID}
    look_south = task(TWO, look_at={"location_list": {"locations": [south]}})
    asks = (
        (1.0, TASK, LOOK_EAST),
        (6.0, TASK, look_south),
        (9.0, TASK, task(TWO, Task.CONTROL_STOP)),
    )
    made = scene([camera()], [*DRONES, held("south", 180.0, 6.0, 900.0)], seed=4)
    node = Node(flown(*asks, for_s=15.0, made=made), "camera")
    assert [(of, status) for of, status, _ in node.acks] == [
        (ONE, ACCEPTED), (TWO, ACCEPTED), (TWO, ACCEPTED), (TWO, COMPLETED)
    ]  # fmt: skip
    assert drones_between(node.ran, 3.6, 6.0) == {"east"}
    assert drones_between(node.ran, 8.6, 9.0) == {"south"}
    assert drones_between(node.ran, 13.0, 15.0) == {"north"}
    assert node.totals.sapient_tasks == 3


def test_what_cannot_be_looked_at_is_rejected_with_the_reason() -> None:
    plain = cone(azimuth=90.0)
    plain["range_bearing"]["datum"] = 2
    asks = [task(ONE, look_at=plain), task(TWO, look_at=cone(azimuth=1e9))]
    first, second = Node(flown(*((0.5, TASK, ask) for ask in asks), for_s=2.0), "camera").acks
    assert first[:2] == (ONE, REJECTED)
    assert "degrees from true north" in first[2]
    assert second[:2] == (TWO, REJECTED)
    assert "look_at.azimuth_deg" in second[2]


def test_a_session_that_was_asked_things_runs_again_from_its_record(tmp_path: Path) -> None:
    """By plots, cues and tasks, of which some are refused: every plot and answer is the same."""
    path = tmp_path / "record.mcap"
    keys = camera(mount={"dwell_s": 2.0, "cued_by": "radar", "zoom_s": 0.5, "fov_min_deg": 5.0})
    made = scene([keys, radar(pfa=1e-7, power_w=5e4)], DRONES, seed=9)
    asked = [
        (1.53, CUE, json.dumps(EAST | {"azimuth_deg": 45.0}).encode()),
        (3.9, TASK, task(THREE, mode_change="standby")),
        (4.0, TASK, task(THREE, Task.CONTROL_STOP)),
        (4.21, TASK, LOOK_EAST),
        (7.77, TASK, task(ONE, Task.CONTROL_STOP)),
        (8.0, CUE, b"{}"),
        (8.1, TASK, task(TWO, request="dance")),
    ]
    with Recorder(path, attachments=attachments_of(made, START_NS), waits=True) as recorder:
        first = simulated(made, 12.0, asked, SessionRecorder(recorder, ledger_is_sent=False))
    clock = InstantClock(SessionRecord.open(path).start_utc_ns)
    again = simulated(made, 12.0, (), RecordedTelemetry(path), clock=clock)
    assert again.on("camera/plots") == first.on("camera/plots")
    assert again.on("camera/sapient") == first.on("camera/sapient")
    assert (first.totals.sapient_tasks, first.totals.sapient_rejected) == (4, 1)
    batches = [pb.PlotBatch.FromString(payload) for payload in first.on("camera/plots")]
    assert sum(len(batch.plots) for batch in batches) > 40
    assert drones_between(first, 0.0, 12.0) == {"north", "east"}


# Tasks of SAPIENT.


def test_what_may_be_asked_stands_in_the_registration() -> None:
    (registered,) = asked(for_s=0.5).of("registration")
    modes = registered.registration.mode_definition
    assert [mode.mode_name for mode in modes] == ["default", "standby"]
    for mode in modes:
        assert [command.units for command in mode.task.command] == [
            "Registration, Status, Heartbeat, Start, Stop, Reset",
            "default, standby",
            "Low, Medium, High",
        ]


def test_a_change_of_mode_is_made_and_taken_back() -> None:
    """In standby a sensor reports nothing, and says so; stopped, the task leaves no trace."""
    node = asked((1.0, task(ONE, mode_change="standby")), (2.5, task(ONE, Task.CONTROL_STOP)))
    assert node.acks == [(ONE, status, "") for status in (ACCEPTED, ACCEPTED, COMPLETED)]
    times_s = [seconds(m) for m in node.of("detection_report")]
    assert any(t < 1 for t in times_s)
    assert any(t > 2.6 for t in times_s)
    assert not any(1.11 < t < 2.5 for t in times_s)
    statuses = [m.status_report for m in node.of("status_report")]
    standing_by = [s for s in statuses if s.mode == "standby"]
    assert standing_by[-1].active_task_id == ONE
    assert all(s.info == StatusReport.INFO_NEW for s in standing_by)
    kinds = {s.status[0].status_type for s in standing_by}
    assert kinds == {StatusReport.STATUS_TYPE_NOT_DETECTING}
    assert statuses[-1].mode == "default"
    assert not statuses[-1].active_task_id
    assert (node.totals.sapient_tasks, node.totals.sapient_rejected) == (2, 0)


def test_a_registration_is_had_for_the_asking_by_who_names_the_node_and_begins_in_the_past() -> (
    None
):
    past = {"task_start_time": {"seconds": 5}}
    node = asked(
        (1.0, task(request="Registration")),
        (2.0, task(TWO, request="status")),
        (3.0, task(to=node_id(3, "radar"), more=past, request="Heartbeat")),
    )
    first, again = node.of("registration")
    assert first.registration == again.registration
    assert node.said_at(1.0) == ["task_ack", "registration", "status_report", "task_ack"]
    assert node.said_at(2.0) == ["task_ack", "status_report", "task_ack"]
    assert [status for _, status, _ in node.acks] == [ACCEPTED, COMPLETED] * 3


def test_a_threshold_makes_more_or_less_of_the_scenes_false_alarms() -> None:
    """Each task of a command takes the place of the one before; stopped, the scene holds again."""
    node = asked(
        (1.0, task(ONE, detection_threshold="DISCRETE_THRESHOLD_LOW")),
        (2.0, task(TWO, detection_threshold="DISCRETE_THRESHOLD_HIGH")),
        (2.5, task(ONE, Task.CONTROL_STOP)),
        (3.0, task(TWO, Task.CONTROL_STOP)),
    )
    pfas = [round(sensor.false_alarm_probability or 0, 9) for sensor in node.ran.settled_as]
    assert pfas == [1e-4, 1e-6, 1e-5]
    statuses = [status for _, status, _ in node.acks]
    assert statuses == [ACCEPTED, ACCEPTED, REJECTED, ACCEPTED, COMPLETED]
    modes = [m.registration.mode_definition[0] for m in node.of("registration")]
    performances = [mode.detection_definition[0].detection_performance[0] for mode in modes]
    rates = [float(performance.unit_value) for performance in performances]
    assert rates[1] == pytest.approx(10 * rates[0], rel=1e-4)
    assert rates[2] == pytest.approx(rates[0] / 10, rel=1e-4)
    assert rates[3] == rates[0]


def test_start_stop_and_reset_are_those_of_control() -> None:
    node = asked(
        (1.0, task(request="Stop")),
        (1.5, task(request="Start")),
        (2.0, task(TWO, mode_change="standby")),
        (2.5, task(THREE, request="Reset")),
        (3.0, task(TWO, Task.CONTROL_STOP)),
    )
    assert [sensor.enabled for sensor in node.ran.settled_as] == [False, True, False, True]
    assert node.acks[-1] == (TWO, REJECTED, f"task {TWO} is not at work")


# What is not done, and how the reason begins.
REJECTIONS = [
    (task(look_at={"range_bearing": {"azimuth": 5.0}}), "look_at: no mount turns this sensor"),
    (task(follow={"follow_object_id": "x"}), "command follow: expected"),
    (task(detection_report_rate="DISCRETE_THRESHOLD_LOW"), "command detection_report_rate"),
    (task(), "command is missing"),
    (task(mode_change="full\nspeed"), "mode_change 'full\\nspeed': expected one of default"),
    (task(request="Take Snapshot"), "request 'Take Snapshot': expected one of Registration"),
    (task(detection_threshold=0), "detection_threshold 'UNSPECIFIED': expected one of Low"),
    (task(detection_threshold=77), "detection_threshold '': expected one of Low, Medium"),
    (task(control=Task.CONTROL_PAUSE, mode_change="standby"), "control pause: expected"),
    (task(control=0, mode_change="standby"), "control is not said: expected"),
    (task(control=Task.CONTROL_STOP), f"task {ONE} is not at work"),
    (task(to="0" * 36, request="Status"), "for node 000000000000000000"),
    (task(more={"region": [{}]}, request="Status"), "region: tasks are of the whole cover"),
    (task(more={"task_end_time": {"seconds": 1}}, request="Status"), "task_end_time: tasks"),
    (
        task(more={"task_start_time": {"seconds": START_NS // 10**9 + 60}}, request="Status"),
        "task_start_time: 20",
    ),
]
NO_TASKS = [b"", b"\xff\xff", task("no ulid"), task(""), SapientMessage().SerializeToString()]


def test_what_is_not_done_is_rejected_with_the_reason_and_what_is_no_task_is_an_error() -> None:
    payloads = [*(payload for payload, _ in REJECTIONS), *NO_TASKS]
    node = asked(*((0.15 * (i + 1), payload) for i, payload in enumerate(payloads)))
    for (task_id, status, found), (_, reason) in zip(node.acks, REJECTIONS, strict=True):
        assert (task_id, status) == (ONE, REJECTED)
        assert found.startswith(reason)
        assert found.isprintable()
    assert [m.error.packet for m in node.of("error")] == NO_TASKS
    assert (node.totals.sapient_tasks, node.totals.sapient_rejected) == (0, len(payloads))
    assert not node.ran.settled_as


def test_a_sensor_without_false_alarms_takes_no_threshold() -> None:
    place = {"type": "range_gate", "scan": staring(0.1), "range_max_m": 5e3, "sigma_m": 5.0}
    made = scene([{"id": "radar", "report": ["sapient"], **place}], seed=3)
    asks = (0.2, task(detection_threshold="DISCRETE_THRESHOLD_LOW"))
    node = asked(asks, for_s=0.5, made=made)
    (registered,) = node.of("registration")
    assert len(registered.registration.mode_definition[0].task.command) == 2
    assert node.acks == [(ONE, REJECTED, "pfa_factor: sensor 'radar' has no pfa")]


def test_more_than_some_in_a_second_are_rejected() -> None:
    floods = [(1.0, task(request="Status"))] * (3 * MAX_TASKS_PER_S)
    node = asked(*floods, (2.5, task(TWO, request="Status")))
    assert node.totals.sapient_tasks == MAX_TASKS_PER_S + 1
    assert node.totals.sapient_rejected == 2 * MAX_TASKS_PER_S
    assert node.acks[-1] == (TWO, COMPLETED, "")
    assert (ONE, REJECTED, f"more than {MAX_TASKS_PER_S} tasks in a second") in node.acks


def test_tasks_of_nobody_are_refused_and_recorders_are_told_of_all() -> None:
    topic = "plotfeed/nobody/sapient/task"
    made = scene([radar(report=["sapient"])], seed=3)
    ran = simulated(made, 2.0, [(0.2, topic, task(request="Status"))])
    assert ran.totals.refused == 1
    assert "there is no sensor that takes this" in ran.totals.last_refusal
    assert ran.received_on == [topic]


def test_what_a_script_changes_is_said_anew() -> None:
    """A node is at any time as it has said: by its Registration, its mode and its cover."""
    events = [
        {"from_s": 0.0, "to_s": 1.0, "set": {"enabled": False}},
        {"from_s": 2.0, "set": {"range_max_m": 900.0}},
        {"from_s": 3.0, "set": {"link": {"latency_ms": 5}}},
    ]
    node = asked(event=events)
    said = [(round(seconds(m)), m.status_report) for m in node.of("status_report")]
    told = [(t, s.mode, s.field_of_view.range_bearing.range) for t, s in said]
    first = told[0][2]
    assert told == [
        (0, "standby", first),
        (1, "default", first),
        (2, "default", 900.0),
        (4, "default", 900.0),
    ]
    ranges = [m.registration.capabilities[0].value for m in node.of("registration")]
    assert ranges == [f"{first:g}", "900"]


@pytest.mark.asyncio
async def test_over_tcp_tasks_are_answered_on_the_connection() -> None:
    def acks(peer: Peer) -> Sequence[int]:
        return [m.task_ack.task_status for m in peer.heard if m.HasField("task_ack")]

    async def asking(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        peer.send(task(ONE, mode_change="standby"))
        hearing = asyncio.create_task(peer.hear_all())
        await until(lambda: acks(peer) == [ACCEPTED])
        peer.send(task(TWO, request="Registration"))
        await until(lambda: acks(peer) == [ACCEPTED, ACCEPTED, COMPLETED])
        peer.send(task(THREE, request="nothing"))
        await until(lambda: acks(peer)[-1] == REJECTED)
        stop.set()
        await hearing

    stop = asyncio.Event()
    async with listening(asking) as middleware:
        flown = scene(
            [radar(report=["sapient"], scan=staring(0.1))],
            seed=3,
            sapient={"middleware": middleware.address, "status_interval_s": 0.2},
        )
        totals = await run(flown, broker="none", stop=stop)
        (peer,) = middleware.peers
        await until(peer.reader.at_eof)
    assert (totals.sapient_tasks, totals.sapient_rejected) == (2, 1)
    assert peer.kinds().count("registration") == 2
    checked_together(peer.heard)
    assert {m.status_report.mode for m in peer.heard[-1:]} == {"standby"}


# Over a real broker: who hears a node, from when on, and what it answers.

TOPIC = "plotfeed/radar/sapient"
SENSOR = radar_text(period_s=0.5, sectors=16, more='report = ["sapient", "plots"]')
MEDIA = "application/x-protobuf; messageType=sapient_msg.bsi_flex_335_v2_0.SapientMessage"


def content(heard: MqttMessage) -> str | None:
    return checked(heard.payload).WhichOneof("content")


def is_goodbye(message: MqttMessage) -> bool:
    report = checked(message.payload).status_report
    return report.System.Name(report.system) == "SYSTEM_GOODBYE" if report.report_id else False


def ack_of(message: MqttMessage) -> TaskAck:
    return checked(message.payload).task_ack


@pytest.mark.asyncio
async def test_both_versions_carry_a_node_that_answers_and_a_broker_that_comes_back_hears_it_anew(
    tmp_path: Path,
) -> None:
    """Its Registration is retained where all else is said, and the goodbye at last in its place."""
    port = free_port()
    what = load(scene_file(tmp_path, f"{scene_text(sensors=SENSOR)}[sapient]\n"))
    session = at_work(what, port)

    async def heard(ears: MqttReceiver, *contents: str) -> list[MqttMessage]:
        return [
            await asyncio.to_thread(ears.wait_for, lambda m, of=of: content(m) == of)  # type: ignore[misc]
            for of in contents
        ]

    with mosquitto(tmp_path, port), MqttReceiver(port, 4, TOPIC) as old:
        await session.__aenter__()
        with MqttReceiver(port, 5, TOPIC) as late:
            for ears in (old, late):
                first, *_ = await heard(ears, "registration", "status_report", "detection_report")
            assert late.heard[0] == first
            assert {content(m) for m in late.heard if m.retained} == {"registration"}
            late.publish(f"{TOPIC}/task", task(ONE, request="Registration"))
            await asyncio.to_thread(late.wait_for, lambda m: ack_of(m).task_status == COMPLETED)
            assert [content(m) for m in late.heard if not m.retained].count("registration") == 1
            late.publish(f"{TOPIC}/task", task(TWO, mode_change="dance"))
            told = await asyncio.to_thread(
                late.wait_for, lambda m: ack_of(m).task_status == REJECTED
            )
            assert "expected one of default, standby" in ack_of(told).reason[0]
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC) as ears:
        again, _ = await heard(ears, "registration", "detection_report")
        kinds = [content(m) for m in ears.heard]
        await session.__aexit__(None, None, None)
        await asyncio.to_thread(ears.wait_for, is_goodbye)
        with MqttReceiver(port, 5, TOPIC) as after:
            farewell = await asyncio.to_thread(after.wait_for, is_goodbye)
            assert (farewell.retained, len(after.heard)) == (True, 1)
    assert checked(again.payload).registration == checked(first.payload).registration
    assert checked(again.payload).node_id == checked(first.payload).node_id
    assert kinds[kinds.index("registration") + 1] == "status_report"
    detections = [m for m in late.heard if content(m) == "detection_report"]
    assert detections[0].content_type == MEDIA
    assert detections[0].user_properties["type"] == "plotfeed.sapient"
    ids = [m.user_properties["id"] for m in detections]
    assert len(set(ids)) == len(ids)
    stamps = [checked(m.payload).timestamp.ToNanoseconds() for m in detections]
    assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(stamps))


# Commands over a real broker.

MS = 1_000_000
SETTINGS, DESCRIPTION = "plotfeed/radar/settings", "plotfeed/radar/description"


@pytest.mark.asyncio
async def test_a_session_obeys_refuses_in_a_line_and_has_its_clock_held_over_the_wire(
    tmp_path: Path,
) -> None:
    sensors, start = radar_text(period_s=6.0, sectors=96), "2026-01-01T12:00:00Z"
    text = scene_text(sensors=sensors, mqtt="truth = false", port=1883, start_utc=start)
    what, port = load(scene_file(tmp_path, text)), free_port()
    clock = WallClock(what.scene.start_utc_ns, speed=5.0)

    def told(ears: MqttReceiver, topic: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(ears.on(topic)[-1])
        return found

    with own_broker(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as ears:
        async with at_work(what, port, clock=clock) as session:
            await until(lambda: len(ears.on(SETTINGS)) == len(ears.on(DESCRIPTION)) == 1)
            first = told(ears, DESCRIPTION)
            command = {"link": {"latency_ms": 150}, "azimuth_min_deg": -30.0}
            asked = {"sensor": "radar", "set": command | {"azimuth_max_deg": 30.0}}
            ears.publish(CONTROL, json.dumps(asked).encode())
            await until(lambda: len(ears.on(SETTINGS)) == len(ears.on(DESCRIPTION)) == 2)
            assert told(ears, SETTINGS)["in_force"]["link"] == {"latency_ms": 150}
            second = told(ears, DESCRIPTION)
            changed = {key for key in first if first[key] != second.get(key)}
            assert changed == {"time_utc", "azimuth_min_deg", "azimuth_max_deg"}
            for topic in (SETTINGS, DESCRIPTION):
                with MqttReceiver(port, 5, topic) as late:
                    kept = await asyncio.to_thread(late.wait_for, lambda m: m.retained)
                    assert json.loads(kept.payload) == told(ears, topic)
            ears.publish(CONTROL, b"[]")
            await until(lambda: ears.on("plotfeed/errors"))
            assert "expected an object" in told(ears, "plotfeed/errors")["detail"]
            ears.publish(CONTROL, b'{"clock": {"paused": true}}')
            await until(lambda: clock.is_paused)
            stood_ns = clock.now_ns()
            ears.publish(CONTROL, b'{"clock": {"step_s": 1.5}}')
            await until(lambda: clock.now_ns() > stood_ns and clock.is_paused)
            assert clock.now_ns() == stood_ns + 1500 * MS
            ears.publish(CONTROL, b'{"clock": {"paused": false, "speed": 20}}')
            await until(lambda: clock.speed == 20 and not clock.is_paused)
            await session.sectors_more(20)
    assert (session.totals.controls, session.totals.refused) == (4, 1)
    sector_ns, step_end_ns = 6_000 * MS // 96, stood_ns + 1500 * MS
    ends_ns = {batch.sector.end_ns for batch in session.sectors}
    stepped = range(stood_ns // sector_ns + 1, step_end_ns // sector_ns + 1)
    assert {number * sector_ns for number in stepped} <= ends_ns  # standing misses none
