"""What a session is asked while it runs: mounts to look somewhere, sensors and time to change."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from support.brokers import free_port, own_broker
from support.sapient_rules import ONE, THREE, TWO, task
from support.scene_files import radar as radar_text
from support.scene_files import scene_file, scene_text
from support.sessions import Asked, AtWork, at_work, simulated
from support.waiting import until

from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.sapient.encode_sapient import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH
from plotfeed.testing import START_NS, MqttReceiver, held, radar, scene, staring

CUE, TASK = "plotfeed/camera/cue", "plotfeed/camera/sapient/task"
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


def answers(ran: AtWork) -> list[tuple[str, int, str]]:
    messages = [SapientMessage.FromString(payload) for payload in ran.on("camera/sapient")]
    acks = [m.task_ack for m in messages if m.HasField("task_ack")]
    return [(a.task_id, a.task_status, "; ".join(a.reason)) for a in acks]


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
    ("plotfeed/control", b'{"clock": {"speed": 10}}'): "real time cannot be held or hurried",
}


def test_what_cannot_be_asked_is_refused_in_a_line_and_counted() -> None:
    asked = [(0.1 * (i + 1), topic, payload) for i, (topic, payload) in enumerate(WRONG)]
    ran = flown(*asked, for_s=2.0)
    details = [error["detail"] for error in ran.told("errors")]
    for text, detail in zip(WRONG.values(), details, strict=True):
        assert text in detail
        assert "\n" not in detail
    assert ran.totals.refused == len(WRONG)
    assert drones_between(ran, 0.0, 2.0) == {"north"}


def cone(**angles: float) -> dict[str, Any]:
    return {"range_bearing": {"coordinate_system": DEG_M, "datum": TRUE_NORTH, **angles}}


LOOK_EAST = task(ONE, look_at=cone(azimuth=90.0, elevation=6.0))


def test_a_sapient_task_makes_it_look_until_it_is_stopped() -> None:
    ran = flown((1.0, TASK, LOOK_EAST), (6.0, TASK, task(ONE, Task.CONTROL_STOP)))
    assert [(i, status) for i, status, _ in answers(ran)] == [
        (ONE, TaskAck.TASK_STATUS_ACCEPTED),
        (ONE, TaskAck.TASK_STATUS_ACCEPTED),
        (ONE, TaskAck.TASK_STATUS_COMPLETED),
    ]
    assert drones_between(ran, 3.6, 6.0) == {"east"}
    assert drones_between(ran, 8.6, 12.0) == {"north"}
    assert ran.totals.sapient_tasks == 2


def test_a_place_after_a_direction_takes_its_place() -> None:
    north = {"x": -3.73, "y": 40.4581, "z": 745.0, "coordinate_system": LAT_LNG, "datum": ELLIPSOID}
    look_north = task(TWO, look_at={"location_list": {"locations": [north]}})
    ran = flown((1.0, TASK, LOOK_EAST), (6.0, TASK, look_north))
    assert {status for _, status, _ in answers(ran)} == {TaskAck.TASK_STATUS_ACCEPTED}
    assert drones_between(ran, 3.6, 6.0) == {"east"}
    assert drones_between(ran, 8.6, 12.0) == {"north"}


def test_what_cannot_be_looked_at_is_rejected_with_the_reason() -> None:
    plain = cone(azimuth=90.0)
    plain["range_bearing"]["datum"] = 2
    asked = [task(ONE, look_at=plain), task(TWO, look_at=cone(azimuth=1e9))]
    found = answers(flown((0.5, TASK, asked[0]), (0.6, TASK, asked[1]), for_s=2.0))
    assert [status for _, status, _ in found] == [TaskAck.TASK_STATUS_REJECTED] * 2
    assert "degrees from true north" in found[0][2]
    assert "look_at.azimuth_deg" in found[1][2]
    fixed = scene([camera(mount=None) | {"id": "camera"}], DRONES, seed=4)
    found = answers(flown((0.5, TASK, LOOK_EAST), for_s=1.0, made=fixed))
    reason = "look_at: no mount turns this sensor"
    assert found == [(ONE, TaskAck.TASK_STATUS_REJECTED, reason)]


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


# Commands over a real broker.

MS = 1_000_000
CONTROL, SETTINGS, ERRORS = "plotfeed/control", "plotfeed/radar/settings", "plotfeed/errors"
DESCRIPTION = "plotfeed/radar/description"
REFUSED = {
    b"[]": "expected an object",
    b'{"sensor": "nobody", "reset": true}': "there is no 'nobody'; expected one of radar",
    b'{"sensor": "radar", "set": {"link": {"latency": 5}}}': "latency",
    b" " * (1 << 17): "at most 65536",
}


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
            for number, (payload, words) in enumerate(REFUSED.items(), 1):
                ears.publish(CONTROL, payload)
                await until(lambda: len(ears.on(ERRORS)) >= number)  # noqa: B023
                error = told(ears, ERRORS)
                assert words in error["detail"]
                assert error["detail"].isprintable()
                expected = {"topic": CONTROL, "drone": "", "reason": "control"}
                assert error.items() >= {**expected, "count": str(number)}.items()
            ears.publish(CONTROL, b'{"clock": {"paused": true}}')
            await until(lambda: clock.is_paused)
            stood_ns = clock.now_ns()
            ears.publish(CONTROL, b'{"clock": {"step_s": 1.5}}')
            await until(lambda: clock.now_ns() > stood_ns and clock.is_paused)
            assert clock.now_ns() == stood_ns + 1500 * MS
            ears.publish(CONTROL, b'{"clock": {"paused": false, "speed": 20}}')
            await until(lambda: clock.speed == 20 and not clock.is_paused)
            await session.sectors_more(20)
    assert (session.totals.controls, session.totals.refused) == (4, len(REFUSED))
    sector_ns, step_end_ns = 6_000 * MS // 96, stood_ns + 1500 * MS
    ends_ns = {batch.sector.end_ns for batch in session.sectors}
    stepped = range(stood_ns // sector_ns + 1, step_end_ns // sector_ns + 1)
    assert {number * sector_ns for number in stepped} <= ends_ns  # standing misses none
