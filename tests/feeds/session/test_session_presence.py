"""Who runs on a prefix, as brokers tell it: sessions that end, die, break, or meet each other."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import command
from support.brokers import free_port, mosquitto, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.testing import MqttMessage, MqttReceiver

SENSORS = [f"s{i}" for i in range(12)]
RADARS = "".join(radar(name, period_s=5.0, sectors=4) for name in SENSORS)
TOPIC, STATUSES = "plotfeed/session", [f"plotfeed/{name}/status" for name in SENSORS]


def scene_of(folder: Path, version: str = "any") -> Path:
    return scene_file(folder, scene_text(sensors=RADARS, mqtt=f'version = "{version}"'))


def said(message: MqttMessage) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(message.payload)
    return found


def retained(port: int, topic: str = TOPIC, version: int = 5) -> dict[str, Any]:
    with MqttReceiver(port, version, topic) as client:
        message = client.wait_for(lambda m: m.topic == topic)
    assert message.retained
    return said(message)


def wait_for_all(ears: MqttReceiver, state: str) -> None:
    """Every sensor says, or is said, to be so."""
    for topic in STATUSES:
        ears.wait_for(lambda m, topic=topic: m.topic == topic and said(m)["state"] == state)  # type: ignore[misc]


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_two_sessions_on_one_prefix_know_of_each_other(tmp_path: Path, how: signal.Signals) -> None:
    """And when one has ended, or died, what is retained is of the one that runs."""
    port = free_port()
    words = ("run", scene_of(tmp_path, "3.1.1"), "--broker", f"mqtt://127.0.0.1:{port}")

    def knows(message: MqttMessage, me: str, other: str) -> bool:
        told = said(message)
        return message.topic == TOPIC and told["session"] == me and other in told["heard"]

    def is_of(message: MqttMessage, session: str, state: str) -> bool:
        told = said(message)
        return message.topic == TOPIC and (told["session"], told["state"]) == (session, state)

    with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC, "plotfeed/+/status") as client:
        with command.running(*words) as one:
            first = said(client.wait_for(lambda m: m.topic == TOPIC))["session"]
            wait_for_all(client, "ONLINE")
            with command.running(*words) as two:
                second = said(
                    client.wait_for(lambda m: m.topic == TOPIC and said(m)["session"] != first)
                )["session"]
                client.wait_for(lambda m: knows(m, first, second))
                client.wait_for(lambda m: knows(m, second, first))
                number = len(client.heard)
                two.process.send_signal(how)
                _, err_of_two = two.process.communicate()
            state = "ENDED" if how == signal.SIGTERM else "DIED"
            client.wait_for(lambda m: is_of(m, second, state))
            client.wait_for(lambda m: is_of(m, first, "RUNNING"), number)
            now = retained(port)
            number = len(client.heard)
            _, _, err_of_one = one.end(signal.SIGTERM)
            wait_for_all(client, "OFFLINE")
            time.sleep(0.3)  # By its own word, which a last will would follow with less
        told = [m.topic for m in client.heard[number:] if said(m)["state"] == "OFFLINE"]
        assert sorted(told) == sorted(STATUSES)
        assert (now["session"], now["state"], now["heard"]) == (first, "RUNNING", [])
        assert retained(port)["state"] == "ENDED"
    line = "plotfeed: another session ({}, scene 'test') publishes on plotfeed/# too: "
    assert err_of_one.count(line.format(second)) == 1
    assert err_of_one.count(f"plotfeed: the other session ({second}) has {state.lower()}") == 1
    if how == signal.SIGTERM:
        assert err_of_two.count(line.format(first)) == 1


@pytest.mark.parametrize("broker", [mosquitto, own_broker])
def test_what_is_left_of_a_session_that_died_is_no_session(
    tmp_path: Path, broker: Callable[[Path, int], Any]
) -> None:
    """Neither what is retained of one, as if it ran, nor rubbish; each of its sensors is OFFLINE.

    For those who listened all the time, and for those who come later.
    """
    port, old = free_port(), {"session": "a1b2", "state": "RUNNING", "heard": [], "scene": "old"}
    rubbish = (b"", b"\xff", b"[" * 10_000, b"{}", b'{"session": 1, "state": "ENDED"}')
    words = ("run", scene_of(tmp_path), "--broker", f"mqtt://127.0.0.1:{port}")
    with broker(tmp_path, port), MqttReceiver(port, 4, "plotfeed/#") as client:
        client.publish(TOPIC, json.dumps(old).encode(), retain=True)
        with command.running(*words) as session:
            client.wait_for(lambda m: m.topic == TOPIC and said(m)["session"] != "a1b2")
            for payload in rubbish:
                client.publish(TOPIC, payload)
            wait_for_all(client, "ONLINE")
            client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            session.process.kill()
            err = session.process.communicate()[1]
        assert err == ""
        wait_for_all(client, "OFFLINE")
        wait_until(lambda: retained(port)["state"] == "DIED")
        for version in (4, 5):
            assert retained(port, STATUSES[-1], version)["state"] == "OFFLINE"


class Breaks(Observer):
    def report(self, _report: Batch) -> None:
        raise ZeroDivisionError


@pytest.mark.asyncio
async def test_a_session_that_breaks_is_not_there_either(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        broker, breaks = f"mqtt://127.0.0.1:{port}", [Breaks()]
        with pytest.raises(ZeroDivisionError):
            await run(load(scene_of(tmp_path)), broker=broker, observers=breaks)
        wait_until(lambda: retained(port)["state"] == "DIED")
        wait_until(lambda: retained(port, STATUSES[0])["state"] == "OFFLINE")


def test_the_embedded_broker_which_dies_with_its_session_has_one_connection(tmp_path: Path) -> None:
    with command.running("run", scene_of(tmp_path)) as session:
        port = session.port("MQTT")
        with MqttReceiver(port, 4, "plotfeed/+/status") as ears:
            wait_for_all(ears, "ONLINE")
        folder = Path(f"/proc/{session.process.pid}/fd")
        sockets = {str(each.readlink()) for each in folder.iterdir() if each.is_symlink()}
        lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        to_it = [line for line in lines if line[2].endswith(f":{port:04X}")]
        assert sum(f"socket:[{line[9]}]" in sockets for line in to_it) == 1
