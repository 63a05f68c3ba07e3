from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

from support.brokers import free_port, mosquitto, wait_until_listening
from support.mqtt_client import Heard, listening
from support.sapient_rules import checked
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S

REPORT = 'report = ["sapient", "plots"]'
SENSOR = radar(period_s=0.5, sectors=16, more=REPORT)
TOPIC = "plotfeed/radar/sapient"


@contextmanager
def running(scene: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    session = subprocess.Popen(
        [sys.executable, "-m", "plotfeed.feeds.cli", "run", str(scene), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield session
    finally:
        session.kill()
        session.wait(PATIENCE_S)


def content(heard: Heard) -> str | None:
    return checked(heard.payload).WhichOneof("content") if heard.topic == TOPIC else None


def test_both_versions_of_mqtt_carry_bare_messages(tmp_path: Path) -> None:
    port = free_port()
    sapient = "[sapient]\nstatus_interval_s = 0.5\n"
    with running(scene_file(tmp_path, scene_text(port=port, sensors=sapient + SENSOR))) as session:
        for each in (port, port + 1):
            wait_until_listening(each)
        with listening(port, 4, TOPIC) as old, listening(port + 1, 5, TOPIC) as new:
            for client in (old, new):
                client.wait_for(lambda m: content(m) == "detection_report")
                client.wait_for(lambda m: content(m) == "status_report")
            time.sleep(1.0)
            session.send_signal(signal.SIGTERM)
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
    assert not any(m.retained for m in new.heard)
    stamps = [checked(m.payload).timestamp.ToNanoseconds() for m in detections]
    assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(stamps))


def goodbye(message: Heard) -> bool:
    report = checked(message.payload).status_report
    return report.System.Name(report.system) == "SYSTEM_GOODBYE" if report.report_id else False


def test_a_broker_that_comes_back_hears_the_registration_again(tmp_path: Path) -> None:
    port = free_port()
    path = scene_file(tmp_path, scene_text(sensors=SENSOR))
    with ExitStack() as stack:
        with mosquitto(tmp_path, port), listening(port, 5, TOPIC) as ears:
            stack.enter_context(running(path, "--broker", f"mqtt://127.0.0.1:{port}"))
            first = ears.wait_for(lambda m: content(m) == "registration")
            ears.wait_for(lambda m: content(m) == "detection_report")
        with mosquitto(tmp_path, port), listening(port, 5, TOPIC) as ears:
            again = ears.wait_for(lambda m: content(m) == "registration")
            ears.wait_for(lambda m: content(m) == "detection_report")
            kinds = [content(m) for m in ears.heard]
    assert checked(again.payload).registration == checked(first.payload).registration
    assert checked(again.payload).node_id == checked(first.payload).node_id
    assert kinds[kinds.index("registration") + 1] == "status_report"
