"""`inject` publishes what a live source says, tells what it took, and ends as it is told."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import plotfeed, plotfeed_here, running
from support.scene_files import radar, scene_file, scene_text
from support.vehicles import sending_vehicle

from plotfeed.feeds.transport.mqtt.connection import MqttConnection

pytest.importorskip("pymavlink")
# Of now, whenever that is.
AIRBORNE = "".join(
    f"MSG,3,1,1,{icao},1,,,,,,1000,,,40.45,{longitude},,,,,,0\n"
    for icao, longitude in (("484412", "-3.72"), ("485020", "-3.74"))
)


def test_what_autopilots_and_receivers_say_flies_in_a_session_elsewhere(tmp_path: Path) -> None:
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=radar(period_s=0.5), drones=""))
    with running("run", scene, "--duration", "60") as session:
        broker = ("--broker", f"mqtt://127.0.0.1:{session.port('MQTT')}")
        with sending_vehicle(port):
            done = plotfeed("inject", f"mavlink:udp://:{port}", *broker, "--duration", "4")
        to_the_end = plotfeed("inject", "sbs1:-", *broker, stdin=f"nonsense\n{AIRBORNE}")
    assert done.returncode == 0, done.stderr
    assert f"listens to mavlink:udpin:127.0.0.1:{port}, drones are mav-{{system}}" in done.stdout
    assert "drones: mav-1" in done.stdout
    assert "undelivered 0" in done.stdout
    assert "refused" not in done.stderr
    assert to_the_end.returncode == 0, to_the_end.stderr
    assert "drones: 484412, 485020" in to_the_end.stdout
    assert "not taken: undecodable 1: a line 'nonsense'; expected SBS-1" in to_the_end.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("mavlink:pigeon:1",), "expected one of"),
        (("mavlink:udp::14550", "--drone", "{serial}"), "--drone: {serial} is not known"),
        (("mavlink:udp::14550", "--speed", "2"), "are for files"),
        (("remote-id:-",), "expected one of http, https, mcast, udp, udpin, udpout"),
        (
            ("mavlink:udp::14550", "--set", "interface=lo"),
            "--set interface: only for a multicast group",
        ),
        (("mavlink:udp::14550", "--set", "columns.time=t"), "--set columns: no such key here"),
        (("mavlink:udp::14550", "--set", "ask_hz"), "--set ask_hz: expected KEY=VALUE"),
        (("mavlink:udp::14550", "--set", "ask_hz=0"), "--set ask_hz: "),
        (("nothing.srt", "--set", "utc_offset_h=far"), "--set utc_offset_h: "),
        (("nothing.srt", "--gps-order", "lat-lon"), "It is --set gps_order=VALUE now."),
        (("nothing.srt",), "cannot be read: No such file"),
    ],
)
def test_wrong_words_are_told_before_anything_is_sent(words: tuple[str, ...], says: str) -> None:
    done = plotfeed_here("inject", *words, "--broker", "mqtt://127.0.0.1:1")
    assert done.returncode == 2
    assert says in done.stderr


def test_what_comes_after_the_end_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a vehicle that goes on while the broker is slow to let go."""
    close, port, broker_port = MqttConnection.close, free_port(), free_port()

    async def close_slowly(connection: MqttConnection) -> None:
        await asyncio.sleep(0.5)
        await close(connection)

    monkeypatch.setattr(MqttConnection, "close", close_slowly)
    broker = ("--broker", f"mqtt://127.0.0.1:{broker_port}")
    with mosquitto(tmp_path, broker_port), sending_vehicle(port):
        done = plotfeed_here("inject", f"mavlink:udp://:{port}", *broker, "--duration", "2")
    assert done.returncode == 0, done.stdout
    assert "drones: mav-1" in done.stdout


def test_a_taken_port_is_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        done = plotfeed_here("inject", f"mavlink:udp://:{port}", "--broker", "mqtt://127.0.0.1:1")
    assert done.returncode == 1
    assert done.stderr == f"plotfeed: mavlink:udpin:127.0.0.1:{port}: Address already in use\n"
