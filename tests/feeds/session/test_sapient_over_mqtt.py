"""SAPIENT over a real broker: who hears a node, from when on, and what it answers."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from support.brokers import free_port, mosquitto
from support.sapient_rules import checked
from support.sapient_tasks import ONE, TWO, task
from support.scene_files import radar, scene_file, scene_text
from support.sessions import at_work

from plotfeed.feeds.scene.scene import load
from plotfeed.testing import MqttMessage, MqttReceiver

TOPIC = "plotfeed/radar/sapient"
SENSOR = radar(period_s=0.5, sectors=16, more='report = ["sapient", "plots"]')
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
            done, refused = TaskAck.TASK_STATUS_COMPLETED, TaskAck.TASK_STATUS_REJECTED
            await asyncio.to_thread(late.wait_for, lambda m: ack_of(m).task_status == done)
            assert [content(m) for m in late.heard if not m.retained].count("registration") == 1
            late.publish(f"{TOPIC}/task", task(TWO, mode_change="dance"))
            told = await asyncio.to_thread(
                late.wait_for, lambda m: ack_of(m).task_status == refused
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
