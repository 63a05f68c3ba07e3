"""Mounts that are told where to look while a session runs: on their topic, and by SAPIENT."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from support.sapient_tasks import ONE, TWO, task
from support.sessions import Asked, Asks

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, Tap
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of
from plotfeed.proto.sapient.encode_sapient import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH
from plotfeed.testing import START_NS, held, radar, scene, staring

CUE, TASK = "plotfeed/camera/cue", "plotfeed/camera/sapient/task"
EAST = {"azimuth_deg": 90.0, "elevation_deg": 6.0}


def camera(**changes: Any) -> dict[str, Any]:
    return {
        "id": "camera", "type": "camera", "scan": staring(0.1), "range_max_m": 5000.0,
        "horizontal_fov_deg": 20.0, "pixels_across": 8000, "pixels_down": 6000,
        "false_alarms_per_frame": 0.5, "mount": {"dwell_s": 3.0}, "report": ["plots", "sapient"],
        "tilt_deg": 6.0,
    } | changes  # fmt: skip


DRONES = [held("north", 0.0, 6.0, 900.0), held("east", 90.0, 6.0, 900.0)]


def flown(
    asked: Sequence[Asked], for_s: float = 12.0, made: Scene | None = None, *more: Observer
) -> tuple[list[Message], Any]:
    said: list[Message] = []
    observers = [Asks(asked), Tap(lambda message, _t: said.append(message)), *more]
    made = made or scene([camera()], DRONES, seed=4)
    clock = InstantClock(START_NS)
    totals = asyncio.run(
        run(made, clock=clock, broker="none", duration_s=for_s, observers=observers)
    )
    return said, totals


def looked_at(said: Sequence[Message]) -> list[tuple[float, str]]:
    """When each drone was looked at, seconds after the beginning."""
    found = []
    for message in said:
        if message.topic == "plotfeed/truth":
            looks = tables_of([message.payload]).looks
            found += zip(((looks.t_utc_ns - START_NS) / 1e9).tolist(), looks.drone, strict=True)
    return sorted(found)


def drones_between(said: Sequence[Message], from_s: float, to_s: float) -> set[str]:
    return {drone for at_s, drone in looked_at(said) if from_s < at_s < to_s}


def answers(said: Sequence[Message]) -> list[tuple[str, int, str]]:
    messages = [SapientMessage.FromString(m.payload) for m in said if m.topic.endswith("/sapient")]
    acks = [m.task_ack for m in messages if m.HasField("task_ack")]
    return [(a.task_id, a.task_status, "; ".join(a.reason)) for a in acks]


def statuses(said: Sequence[Message]) -> list[dict[str, Any]]:
    found = [json.loads(m.payload) for m in said if m.topic == "plotfeed/camera/status"]
    return [status["mount"] for status in found]


def test_a_cue_turns_it_for_its_dwell_and_then_it_goes_home() -> None:
    said, totals = flown([(2.0, CUE, json.dumps(EAST).encode())])
    assert drones_between(said, 0.0, 2.1) == {"north"}
    assert drones_between(said, 2.5, 4.2) == set()  # it turns
    assert drones_between(said, 4.6, 7.3) == {"east"}
    assert drones_between(said, 9.9, 12.0) == {"north"}
    assert totals.controls == 1
    assert totals.refused == 0
    told = {status["cued_by"]: status for status in statuses(said)}
    assert set(told) == {"", "cue"}
    assert told["cue"]["pan_deg"] == pytest.approx(90.0)
    assert told["cue"]["tilt_deg"] == pytest.approx(6.0)
    assert told["cue"]["settled"]


def test_a_place_and_a_dwell_of_its_own() -> None:
    place = {"latitude_deg": 40.45, "longitude_deg": -3.7194, "height_m": 745.0, "dwell_s": 5.0}
    said, _ = flown([(1.0, CUE, json.dumps(place).encode())])
    assert drones_between(said, 3.6, 8.2) == {"east"}


WRONG = [
    (b"{", "expected an object of JSON such as"),
    (b"[1]", "expected an object of JSON such as"),
    (b"{}", "expected azimuth_deg, or latitude_deg"),
    (b'{"azimuth_deg": 1e9}', "azimuth_deg: input should be less than or equal to 360"),
    (b'{"azimut_deg": 1.0}', "azimut_deg: no such key; did you mean azimuth_deg?"),
    (b'{"latitude_deg": 4.0}', "a place has latitude_deg, longitude_deg and height_m"),
    (b"\xff" * 70_000, "70000 octets: at most"),
]


@pytest.mark.parametrize(("payload", "text"), WRONG, ids=[text[-20:] for _, text in WRONG])
def test_a_bad_cue_is_refused_in_a_line_and_counted(payload: bytes, text: str) -> None:
    said, totals = flown([(0.5, CUE, payload)], 2.0)
    assert totals.refused == 1
    assert text in totals.last_refusal
    assert "\n" not in totals.last_refusal
    assert drones_between(said, 0.0, 2.0) == {"north"}


def test_a_cue_for_nobody_is_refused() -> None:
    _, totals = flown([(0.5, "plotfeed/nobody/cue", json.dumps(EAST).encode())], 1.0)
    assert totals.refused == 1
    assert "no sensor that a mount turns; expected one of camera" in totals.last_refusal


def cone(**angles: float) -> dict[str, Any]:
    return {"range_bearing": {"coordinate_system": DEG_M, "datum": TRUE_NORTH, **angles}}


def test_a_sapient_task_makes_it_look_until_it_is_stopped() -> None:
    asked = [
        (1.0, TASK, task(ONE, look_at=cone(azimuth=90.0, elevation=6.0))),
        (6.0, TASK, task(ONE, Task.CONTROL_STOP)),
    ]
    said, totals = flown(asked)
    assert [(i, status) for i, status, _ in answers(said)] == [
        (ONE, TaskAck.TASK_STATUS_ACCEPTED),
        (ONE, TaskAck.TASK_STATUS_ACCEPTED),
        (ONE, TaskAck.TASK_STATUS_COMPLETED),
    ]
    assert drones_between(said, 3.6, 6.0) == {"east"}
    assert drones_between(said, 8.6, 12.0) == {"north"}
    assert totals.sapient_tasks == 2


def test_a_place_after_a_direction_takes_its_place() -> None:
    north = {"x": -3.73, "y": 40.4581, "z": 745.0, "coordinate_system": LAT_LNG, "datum": ELLIPSOID}
    asked = [
        (1.0, TASK, task(ONE, look_at=cone(azimuth=90.0, elevation=6.0))),
        (6.0, TASK, task(TWO, look_at={"location_list": {"locations": [north]}})),
    ]
    said, _ = flown(asked)
    assert {status for _, status, _ in answers(said)} == {TaskAck.TASK_STATUS_ACCEPTED}
    assert drones_between(said, 3.6, 6.0) == {"east"}
    assert drones_between(said, 8.6, 12.0) == {"north"}


def test_what_cannot_be_looked_at_is_rejected_with_the_reason() -> None:
    plain = cone(azimuth=90.0)
    plain["range_bearing"]["datum"] = 2
    asked = [
        (0.5, TASK, task(ONE, look_at=plain)),
        (0.6, TASK, task(TWO, look_at=cone(azimuth=1e9))),
    ]
    said, _ = flown(asked, 2.0)
    assert [status for _, status, _ in answers(said)] == [TaskAck.TASK_STATUS_REJECTED] * 2
    assert "degrees from true north" in answers(said)[0][2]
    assert "look_at.azimuth_deg" in answers(said)[1][2]
    fixed = scene([camera(mount=None) | {"id": "camera"}], DRONES, seed=4)
    said, _ = flown([(0.5, TASK, task(ONE, look_at=cone(azimuth=90.0)))], 1.0, fixed)
    assert answers(said) == [
        (ONE, TaskAck.TASK_STATUS_REJECTED, "look_at: no mount turns this sensor")
    ]


def test_a_session_that_was_cued_runs_again_from_its_record(tmp_path: Path) -> None:
    """By plots, by its topic and by a task: every plot is the same."""
    path = tmp_path / "record.mcap"
    keys = camera(mount={"dwell_s": 2.0, "cued_by": "radar", "zoom_s": 0.5, "fov_min_deg": 5.0})
    made = scene([keys, radar(pfa=1e-7, power_w=5e4)], DRONES, seed=9)
    asked = [
        (1.53, CUE, json.dumps(EAST | {"azimuth_deg": 45.0}).encode()),
        (4.21, TASK, task(ONE, look_at=cone(azimuth=90.0, elevation=6.0))),
        (7.77, TASK, task(ONE, Task.CONTROL_STOP)),
        (8.0, CUE, b"{}"),
    ]
    recorder = Recorder(path, attachments=attachments_of(made, START_NS), waits=True)
    first, _ = flown(asked, 12.0, made, SessionRecorder(recorder, ledger_is_sent=False))
    recorder.close()
    again: list[Message] = []
    record = SessionRecord.open(path)
    asyncio.run(
        run(
            made,
            clock=InstantClock(record.start_utc_ns),
            broker="none",
            duration_s=12.0,
            observers=[Tap(lambda message, _t: again.append(message)), RecordedTelemetry(path)],
        )
    )
    plots = [m.payload for m in first if m.topic == "plotfeed/camera/plots"]
    assert plots == [m.payload for m in again if m.topic == "plotfeed/camera/plots"]
    assert sum(len(pb.PlotBatch.FromString(p).plots) for p in plots) > 40
    assert drones_between(first, 0.0, 12.0) == {"north", "east"}
