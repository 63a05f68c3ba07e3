"""Two sessions on one prefix know of each other; none that is gone stands there as if it ran."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from support import command
from support.brokers import free_port, mosquitto
from support.scene_files import radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.testing import MqttMessage, MqttReceiver

TEXT = scene_text(sensors=radar(period_s=0.2, sectors=8))
TOPIC = "plotfeed/session"


def said(message: MqttMessage) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(message.payload)
    return found


def retained(port: int, topic: str = TOPIC) -> dict[str, Any]:
    with MqttReceiver(port, 5, topic) as client:
        message = client.wait_for(lambda m: m.topic == topic)
    assert message.retained
    return said(message)


def knows(message: MqttMessage, me: str, other: str) -> bool:
    told = said(message)
    return bool(told["session"] == me and other in told["heard"])


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_two_sessions_on_one_prefix_know_of_each_other(tmp_path: Path, how: signal.Signals) -> None:
    """And when one has ended, or died, what is retained is of the one that runs."""
    port = free_port()
    scene, url = scene_file(tmp_path, TEXT), f"mqtt://127.0.0.1:{port}"
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC) as client:
        with command.running("run", scene, "--broker", url) as one:
            first = said(client.wait_for(lambda m: said(m)["state"] == "RUNNING"))["session"]
            with command.running("run", scene, "--broker", url) as two:
                second = said(client.wait_for(lambda m: said(m)["session"] != first))["session"]
                client.wait_for(lambda m: knows(m, first, second))
                client.wait_for(lambda m: knows(m, second, first))
                number = len(client.heard)
                two.process.send_signal(how)
                _, err_of_two = two.process.communicate()
            state = "ENDED" if how == signal.SIGTERM else "DIED"
            client.wait_for(lambda m: said(m)["session"] == second and said(m)["state"] == state)
            client.wait_for(lambda m: said(m)["session"] == first, number)
            now = retained(port)
            _, _, err_of_one = one.end(signal.SIGTERM)
        assert (now["session"], now["state"], now["heard"]) == (first, "RUNNING", [])
        assert retained(port)["state"] == "ENDED"
    line = "plotfeed: another session ({}, scene 'test') publishes on plotfeed/# too: "
    assert err_of_one.count(line.format(second)) == 1
    assert err_of_one.count(f"plotfeed: the other session ({second}) has {state.lower()}") == 1
    if how == signal.SIGTERM:
        assert err_of_two.count(line.format(first)) == 1


def test_what_is_left_of_a_session_that_died_is_no_session(tmp_path: Path) -> None:
    """Neither what is retained of it, as if it ran, nor rubbish."""
    port = free_port()
    scene, url = scene_file(tmp_path, TEXT), f"mqtt://127.0.0.1:{port}"
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as client:
        old = {"session": "a1b2", "state": "RUNNING", "heard": [], "scene": "old"}
        client.publish(TOPIC, json.dumps(old).encode(), retain=True)
        with command.running("run", scene, "--broker", url) as session:
            client.wait_for(lambda m: m.topic == TOPIC and said(m)["session"] != "a1b2")
            for rubbish in (
                b"",
                b"\xff",
                b"[" * 10_000,
                b"{}",
                b'{"session": 1, "state": "ENDED"}',
            ):
                client.publish(TOPIC, rubbish)
            client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            os.kill(session.process.pid, signal.SIGKILL)
            err = session.process.communicate()[1]
        assert err == ""
        wait_until(lambda: retained(port)["state"] == "DIED")


class Breaks(Observer):
    def report(self, _report: Batch) -> None:
        raise ZeroDivisionError


@pytest.mark.asyncio
async def test_a_session_that_breaks_is_not_there_either(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        with pytest.raises(ZeroDivisionError):
            await run(
                load(scene_file(tmp_path, TEXT)),
                broker=f"mqtt://127.0.0.1:{port}",
                observers=[Breaks()],
            )
        wait_until(lambda: retained(port)["state"] == "DIED")
        wait_until(lambda: retained(port, "plotfeed/radar/status")["state"] == "OFFLINE")
