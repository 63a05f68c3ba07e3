"""Sensors of a session that dies are OFFLINE for whoever listens, by real brokers."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from support import command
from support.brokers import free_port, mosquitto, own_broker
from support.scene_files import radar, scene_file, scene_text

from plotfeed.testing import MqttReceiver

SENSORS = [f"s{i}" for i in range(12)]
RADARS = "".join(radar(name, period_s=5.0, sectors=4) for name in SENSORS)


@contextmanager
def session(folder: Path, *options: str, mqtt: str = "") -> Iterator[command.Running]:
    scene = scene_file(folder, scene_text(sensors=RADARS, mqtt=mqtt))
    with command.running("run", scene, *options) as running:
        yield running


def states(ears: MqttReceiver, sensor: str) -> list[str]:
    return [json.loads(payload)["state"] for payload in ears.on(f"plotfeed/{sensor}/status")]


def wait_for_all(ears: MqttReceiver, state: str) -> None:
    for sensor in SENSORS:
        topic = f"plotfeed/{sensor}/status"
        ears.wait_for(
            lambda m, topic=topic: (  # type: ignore[misc]
                m.topic == topic and json.loads(m.payload)["state"] == state
            )
        )


@pytest.mark.parametrize(("broker", "version"), [(mosquitto, "3.1.1"), (own_broker, "any")])
def test_every_sensor_of_a_session_that_was_killed_is_offline(
    broker: Callable[[Path, int], AbstractContextManager[Any]], version: str, tmp_path: Path
) -> None:
    """For those who listened all the time, and for those who come later."""
    port = free_port()
    spoken = f'version = "{version}"'
    with broker(tmp_path, port), MqttReceiver(port, 4, "plotfeed/+/status") as ears:
        with session(tmp_path, "--broker", f"mqtt://127.0.0.1:{port}", mqtt=spoken) as running:
            wait_for_all(ears, "ONLINE")
            os.kill(running.process.pid, signal.SIGKILL)
            wait_for_all(ears, "OFFLINE")
        for listener in (4, 5):
            with MqttReceiver(port, listener, "plotfeed/+/status") as late:
                wait_for_all(late, "OFFLINE")
                assert all(message.retained for message in late.heard)


def test_a_session_that_ends_as_told_is_offline_once(tmp_path: Path) -> None:
    """By its own word, which a last will would follow with less."""
    port = free_port()
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, "plotfeed/+/status") as ears:
        with session(tmp_path, "--broker", f"mqtt://127.0.0.1:{port}") as running:
            wait_for_all(ears, "ONLINE")
            assert running.end(signal.SIGTERM)[0] == 0
        wait_for_all(ears, "OFFLINE")
        time.sleep(0.3)
        assert all(states(ears, sensor).count("OFFLINE") == 1 for sensor in SENSORS)


def test_the_embedded_broker_which_dies_with_its_session_has_one_connection(tmp_path: Path) -> None:
    with session(tmp_path) as running:
        port = running.port("MQTT")
        with MqttReceiver(port, 4, "plotfeed/+/status") as ears:
            wait_for_all(ears, "ONLINE")
        assert established(running.process.pid, port) == 1


def established(pid: int, port: int) -> int:
    """TCP connections of a process to a port."""
    folder = Path(f"/proc/{pid}/fd")
    sockets = {str(each.readlink()) for each in folder.iterdir() if each.is_symlink()}
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(
        line[2].endswith(f":{port:04X}") and f"socket:[{line[9]}]" in sockets for line in lines
    )
