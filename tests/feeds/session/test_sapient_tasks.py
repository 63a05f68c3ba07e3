"""Tasks of SAPIENT: what a node does when it is asked to, and what it answers."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from support.sapient_middleware import Peer, listening
from support.sapient_rules import checked, checked_together
from support.sapient_tasks import ONE, THREE, TWO, task
from support.sessions import Asks
from support.waiting import until

from plotfeed.feeds.engine.intake import Input
from plotfeed.feeds.formats.sapient.sapient_announcer import MAX_TASKS_PER_S
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.sapient.envelope import node_id
from plotfeed.testing import START_NS, held, radar, scene, staring

INBOX = "plotfeed/radar/sapient/task"
ACCEPTED, REJECTED, COMPLETED = (
    TaskAck.TASK_STATUS_ACCEPTED,
    TaskAck.TASK_STATUS_REJECTED,
    TaskAck.TASK_STATUS_COMPLETED,
)


class Keeps(Asks):
    """Hands a session tasks, each so many seconds after the beginning, and keeps all."""

    def __init__(self, asked: Sequence[tuple[float, bytes]], topic: str = INBOX) -> None:
        super().__init__([(after_s, topic, payload) for after_s, payload in asked])
        self.said: list[SapientMessage] = []
        self.messages: list[Message] = []
        self.sensors: list[Sensor] = []
        self.taken: list[Input] = []

    def received(
        self, topic: str, payload: bytes, content_type: str | None, _t_utc_ns: int
    ) -> None:
        self.taken.append((topic, payload, content_type))

    def settings(self, sensor: Sensor) -> None:
        self.sensors.append(sensor)

    def after_link(self, message: Message, _sent_utc_ns: int) -> None:
        self.messages.append(message)
        if message.topic == "plotfeed/radar/sapient":
            self.said.append(checked(message.payload))

    def acks(self) -> list[tuple[str, int, list[str]]]:
        found = [m.task_ack for m in self.said if m.HasField("task_ack")]
        return [(ack.task_id, ack.task_status, list(ack.reason)) for ack in found]

    def of(self, content: str) -> list[SapientMessage]:
        return [m for m in self.said if m.WhichOneof("content") == content]


def seconds(message: SapientMessage) -> float:
    return (message.timestamp.ToNanoseconds() - START_NS) / 1e9


def said_at(asks: Keeps, after_s: float) -> list[str | None]:
    near = [m for m in asks.said if abs(seconds(m) - after_s) < 0.005]
    return [m.WhichOneof("content") for m in near if not m.HasField("detection_report")]


def flown_with(
    *asked: tuple[float, bytes], duration_s: float = 4.0, **keys: Any
) -> tuple[Keeps, SessionCounters]:
    asks = Keeps(asked)
    of = radar(report=["sapient"], scan=staring(0.1), pfa=1e-5, **keys)
    flown = scene([of], [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)], seed=3)
    totals = asyncio.run(
        run(
            flown,
            clock=InstantClock(START_NS),
            broker="none",
            duration_s=duration_s,
            observers=[asks],
        )
    )
    checked_together(asks.said)
    return asks, totals


def test_what_may_be_asked_stands_in_the_registration() -> None:
    asks, _ = flown_with(duration_s=0.5)
    (registered,) = asks.of("registration")
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
    asks, totals = flown_with(
        (1.0, task(ONE, mode_change="standby")), (2.5, task(ONE, Task.CONTROL_STOP))
    )
    assert asks.acks() == [
        (ONE, ACCEPTED, []),
        (ONE, COMPLETED, []) if False else (ONE, ACCEPTED, []),
        (ONE, COMPLETED, []),
    ]
    times_s = [seconds(m) for m in asks.of("detection_report")]
    assert any(t < 1 for t in times_s)
    assert any(t > 2.6 for t in times_s)
    assert not any(1.11 < t < 2.5 for t in times_s)
    statuses = [m.status_report for m in asks.of("status_report")]
    standing_by = [s for s in statuses if s.mode == "standby"]
    assert standing_by[-1].active_task_id == ONE
    assert all(s.info == StatusReport.INFO_NEW for s in standing_by)
    kinds = {s.status[0].status_type for s in standing_by}
    assert kinds == {StatusReport.STATUS_TYPE_NOT_DETECTING}
    assert statuses[-1].mode == "default"
    assert not statuses[-1].active_task_id
    assert (totals.sapient_tasks, totals.sapient_rejected) == (2, 0)


def test_a_registration_is_had_for_the_asking() -> None:
    asks, _ = flown_with((1.0, task(request="Registration")), (2.0, task(TWO, request="status")))
    first, again = asks.of("registration")
    assert first.registration == again.registration
    assert said_at(asks, 1.0) == ["task_ack", "registration", "status_report", "task_ack"]
    assert said_at(asks, 2.0) == ["task_ack", "status_report", "task_ack"]
    assert [status for _, status, _ in asks.acks()] == [ACCEPTED, COMPLETED] * 2


def test_a_threshold_makes_more_or_less_of_the_scenes_false_alarms() -> None:
    """Each task of a command takes the place of the one before; stopped, the scene holds again."""
    asks, _ = flown_with(
        (1.0, task(ONE, detection_threshold="DISCRETE_THRESHOLD_LOW")),
        (2.0, task(TWO, detection_threshold="DISCRETE_THRESHOLD_HIGH")),
        (2.5, task(ONE, Task.CONTROL_STOP)),
        (3.0, task(TWO, Task.CONTROL_STOP)),
    )
    assert [round(sensor.false_alarm_probability or 0, 9) for sensor in asks.sensors] == [
        1e-4,
        1e-6,
        1e-5,
    ]
    assert [status for _, status, _ in asks.acks()] == [
        ACCEPTED,
        ACCEPTED,
        REJECTED,
        ACCEPTED,
        COMPLETED,
    ]
    rates = [
        float(
            m.registration.mode_definition[0]
            .detection_definition[0]
            .detection_performance[0]
            .unit_value
        )
        for m in asks.of("registration")
    ]
    assert rates[1] == pytest.approx(10 * rates[0], rel=1e-4)
    assert rates[2] == pytest.approx(rates[0] / 10, rel=1e-4)
    assert rates[3] == rates[0]


def test_start_stop_and_reset_are_those_of_control() -> None:
    asks, _ = flown_with(
        (1.0, task(request="Stop")),
        (1.5, task(request="Start")),
        (2.0, task(TWO, mode_change="standby")),
        (2.5, task(THREE, request="Reset")),
        (3.0, task(TWO, Task.CONTROL_STOP)),
    )
    assert [sensor.enabled for sensor in asks.sensors] == [False, True, False, True]
    assert asks.acks()[-1] == (TWO, REJECTED, [f"task {TWO} is not at work"])


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
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
    ],
)
def test_what_is_not_done_is_rejected_with_the_reason(asked: bytes, reason: str) -> None:
    asks, totals = flown_with((0.3, asked), duration_s=0.5)
    ((task_id, status, (found,)),) = asks.acks()
    assert (task_id, status) == (ONE, REJECTED)
    assert found.startswith(reason)
    assert found.isprintable()
    assert (totals.sapient_tasks, totals.sapient_rejected) == (0, 1)
    assert not asks.sensors


def test_a_sensor_without_false_alarms_takes_no_threshold() -> None:
    place = {"type": "range_gate", "scan": staring(0.1), "range_max_m": 5e3, "sigma_m": 5.0}
    asks = Keeps([(0.2, task(detection_threshold="DISCRETE_THRESHOLD_LOW"))])
    flown = scene([{"id": "radar", "report": ["sapient"], **place}], seed=3)
    clock = InstantClock(START_NS)
    asyncio.run(run(flown, clock=clock, broker="none", duration_s=0.5, observers=[asks]))
    (registered,) = asks.of("registration")
    commands = registered.registration.mode_definition[0].task.command
    assert len(commands) == 2
    assert asks.acks() == [(ONE, REJECTED, ["pfa_factor: sensor 'radar' has no pfa"])]


def test_who_is_named_and_who_begins_in_the_past_is_heard() -> None:
    past = {"task_start_time": {"seconds": 5}}
    asks, _ = flown_with(
        (0.2, task(to=node_id(3, "radar"), more=past, request="Heartbeat")), duration_s=0.5
    )
    assert [status for _, status, _ in asks.acks()] == [ACCEPTED, COMPLETED]


@pytest.mark.parametrize(
    "asked", [b"", b"\xff\xff", task("no ulid"), task(""), SapientMessage().SerializeToString()]
)
def test_what_is_no_task_is_answered_by_an_error(asked: bytes) -> None:
    asks, totals = flown_with((0.3, asked), duration_s=0.5)
    (wrong,) = asks.of("error")
    assert wrong.error.packet == asked
    assert totals.sapient_rejected == 1


def test_more_than_some_in_a_second_are_rejected() -> None:
    floods = [(1.0, task(request="Status"))] * (3 * MAX_TASKS_PER_S)
    asks, totals = flown_with(*floods, (2.5, task(TWO, request="Status")))
    assert totals.sapient_tasks == MAX_TASKS_PER_S + 1
    assert totals.sapient_rejected == 2 * MAX_TASKS_PER_S
    assert asks.acks()[-1] == (TWO, COMPLETED, [])
    assert (ONE, REJECTED, [f"more than {MAX_TASKS_PER_S} tasks in a second"]) in asks.acks()


def test_tasks_of_nobody_are_refused_and_recorders_are_told_of_all() -> None:
    asks = Keeps([(0.2, task(request="Status"))], topic="plotfeed/nobody/sapient/task")
    flown = scene([radar(report=["sapient"])], seed=3)
    clock = InstantClock(START_NS)
    totals = asyncio.run(run(flown, clock=clock, broker="none", duration_s=2.0, observers=[asks]))
    assert totals.refused == 1
    assert "there is no sensor that takes this" in totals.last_refusal
    assert asks.taken == [("plotfeed/nobody/sapient/task", task(request="Status"), None)]


def test_what_a_script_changes_is_said_anew() -> None:
    """A node is at any time as it has said: by its Registration, its mode and its cover."""
    events = [
        {"from_s": 0.0, "to_s": 1.0, "set": {"enabled": False}},
        {"from_s": 2.0, "set": {"range_max_m": 900.0}},
        {"from_s": 3.0, "set": {"link": {"latency_ms": 5}}},
    ]
    asks, _ = flown_with(event=events)
    said = [(round(seconds(m)), m.status_report) for m in asks.of("status_report")]
    told = [(t, s.mode, s.field_of_view.range_bearing.range) for t, s in said]
    first = told[0][2]
    assert told == [
        (0, "standby", first),
        (1, "default", first),
        (2, "default", 900.0),
        (4, "default", 900.0),
    ]
    ranges = [m.registration.capabilities[0].value for m in asks.of("registration")]
    assert ranges == [f"{first:g}", "900"]


@pytest.mark.asyncio
async def test_over_tcp_tasks_are_answered_on_the_connection() -> None:
    def acks(peer: Peer) -> list[int]:
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


# A session that was asked things over SAPIENT is run again as it was, answers and all.


SENSORS = [radar(report=["sapient"], scan=staring(0.1), pfa=1e-6)]

KINDS = {"plotfeed.sapient", "plotfeed.sapient.answer"}


def octets(messages: list[Message]) -> list[bytes]:
    """Of detections and answers; statuses between them have stamps of their own."""
    return [m.payload for m in messages if dict(m.properties).get("type") in KINDS]


@pytest.mark.asyncio
async def test_tasks_are_recorded_and_done_again(tmp_path: Path) -> None:
    path, stop, first = tmp_path / "record.mcap", asyncio.Event(), list[Message]()

    async def asking(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        hearing = asyncio.create_task(peer.hear_all())
        for asked in (
            task(ONE, detection_threshold="DISCRETE_THRESHOLD_LOW"),
            task(TWO, mode_change="standby"),
            task(TWO, Task.CONTROL_STOP),
            task(THREE, request="dance"),
        ):
            answers = peer.kinds().count("task_ack")
            await asyncio.sleep(0.25)
            peer.send(asked)
            await until(lambda answers=answers: peer.kinds().count("task_ack") > answers)
        await asyncio.sleep(0.25)
        stop.set()
        await hearing

    async with listening(asking) as middleware:
        flown = scene(SENSORS, seed=3, sapient={"middleware": middleware.address})
        recorder = Recorder(path, attachments=attachments_of(flown, 0), waits=True)
        observers = [
            Tap(lambda message, _t_utc_ns: first.append(message)),
            SessionRecorder(recorder, ledger_is_sent=False),
        ]
        totals = await run(flown, broker="none", stop=stop, observers=observers)
        recorder.close()
    assert (totals.sapient_tasks, totals.sapient_rejected) == (3, 1)

    record, again = SessionRecord.open(path), list[Message]()
    last_ns = max(m.due_utc_ns for m in first if octets([m]))
    await run(
        scene(SENSORS, seed=3),
        clock=InstantClock(record.start_utc_ns),
        broker="none",
        duration_s=(last_ns - record.start_utc_ns) / 1e9 + 1e-6,
        observers=[Tap(lambda message, _t_utc_ns: again.append(message)), RecordedTelemetry(path)],
    )
    missed = set(octets(again)) - set(octets(first))  # scans, if the machine was late
    assert len(octets(first)) > 20
    # What is asked just before a tick is answered before what is due at it, or after.
    assert sorted(one for one in octets(again) if one not in missed) == sorted(octets(first))
