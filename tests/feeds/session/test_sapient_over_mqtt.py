from __future__ import annotations

import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from support.brokers import free_port, mosquitto, wait_until_listening
from support.command import running
from support.sapient_rules import checked
from support.sapient_tasks import ONE, TWO, task
from support.scene_files import radar, scene_file, scene_text

from plotfeed.testing import MqttMessage, MqttReceiver

REPORT = 'report = ["sapient", "plots"]'
SENSOR = radar(period_s=0.5, sectors=16, more=REPORT)
TOPIC = "plotfeed/radar/sapient"


def content(heard: MqttMessage) -> str | None:
    return checked(heard.payload).WhichOneof("content") if heard.topic == TOPIC else None


def test_both_versions_of_mqtt_carry_bare_messages(tmp_path: Path) -> None:
    port = free_port()
    sapient = "[sapient]\nstatus_interval_s = 0.5\n"
    with running(
        "run", scene_file(tmp_path, scene_text(port=port, sensors=sapient + SENSOR))
    ) as session:
        wait_until_listening(port)
        with MqttReceiver(port, 4, TOPIC) as old, MqttReceiver(port, 5, TOPIC) as new:
            for client in (old, new):
                client.wait_for(lambda m: content(m) == "detection_report")
                client.wait_for(lambda m: content(m) == "status_report")
            time.sleep(1.0)
            session.process.terminate()
            for client in (old, new):
                client.wait_for(goodbye)
    found = new.wait_for(lambda m: content(m) == "detection_report")
    assert found.content_type == (
        "application/x-protobuf; messageType=sapient_msg.bsi_flex_335_v2_0.SapientMessage"
    )
    assert found.user_properties["type"] == "plotfeed.sapient"
    detections = [m for m in new.heard if content(m) == "detection_report"]
    ids = [m.user_properties["id"] for m in detections]
    assert len(set(ids)) == len(ids)
    assert {content(m) for m in new.heard if m.retained} <= {"registration"}
    stamps = [checked(m.payload).timestamp.ToNanoseconds() for m in detections]
    assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(stamps))


def goodbye(message: MqttMessage) -> bool:
    report = checked(message.payload).status_report
    return report.System.Name(report.system) == "SYSTEM_GOODBYE" if report.report_id else False


def test_a_broker_that_comes_back_hears_the_registration_again(tmp_path: Path) -> None:
    port = free_port()
    path = scene_file(tmp_path, scene_text(sensors=SENSOR))
    with ExitStack() as stack:
        with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC) as ears:
            stack.enter_context(running("run", path, "--broker", f"mqtt://127.0.0.1:{port}"))
            first = ears.wait_for(lambda m: content(m) == "registration")
            ears.wait_for(lambda m: content(m) == "detection_report")
        with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC) as ears:
            again = ears.wait_for(lambda m: content(m) == "registration")
            ears.wait_for(lambda m: content(m) == "detection_report")
            kinds = [content(m) for m in ears.heard]
    assert checked(again.payload).registration == checked(first.payload).registration
    assert checked(again.payload).node_id == checked(first.payload).node_id
    assert kinds[kinds.index("registration") + 1] == "status_report"


def test_whoever_comes_later_has_the_registration_and_may_ask(tmp_path: Path) -> None:
    """Retained where all else is said; after the end there is the goodbye in its place."""
    port, inbox = free_port(), f"{TOPIC}/task"
    path = scene_file(tmp_path, scene_text(sensors=SENSOR))

    def status_of(m: MqttMessage) -> int:
        return checked(m.payload).task_ack.task_status

    with ExitStack() as stack:
        stack.enter_context(mosquitto(tmp_path, port))
        session = stack.enter_context(running("run", path, "--broker", f"mqtt://127.0.0.1:{port}"))
        early = stack.enter_context(MqttReceiver(port, 5, TOPIC))
        early.wait_for(lambda m: content(m) == "detection_report")
        late = stack.enter_context(MqttReceiver(port, 4, TOPIC))
        registered = late.wait_for(lambda m: content(m) == "registration")
        assert registered.retained
        assert late.heard[0] == registered
        late.publish(inbox, task(ONE, request="Registration"))
        late.wait_for(lambda m: content(m) == "registration" and not m.retained)
        late.wait_for(lambda m: status_of(m) == TaskAck.TASK_STATUS_COMPLETED)
        late.publish(inbox, task(TWO, mode_change="dance"))
        refused = late.wait_for(lambda m: status_of(m) == TaskAck.TASK_STATUS_REJECTED)
        assert "expected one of default, standby" in checked(refused.payload).task_ack.reason[0]
        session.process.terminate()
        late.wait_for(goodbye)
        after = stack.enter_context(MqttReceiver(port, 5, TOPIC))
        assert after.wait_for(goodbye).retained
        assert len(after.heard) == 1
