"""A session in a process of its own, and who listens to the broker that it brings along."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.brokers import wait_until_silent
from support.command import running
from support.scene_files import FOR_BROWSERS, radar, scene_file, scene_text
from support.sessions import simulated

from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttMessage, MqttReceiver

VERSIONS = (4, 5)
SECTORS = 120


@dataclass(frozen=True)
class Session:
    """What is known of it afterwards."""

    heard: dict[int, list[MqttMessage]]  # From its beginning to its end, by version of MQTT
    late: dict[int, MqttMessage]  # The first of its status to who comes later, by version
    listeners: dict[int, set[str]]  # Addresses on which this machine listens, by port
    ports: set[int]  # Its own
    ended: tuple[int, str, str]  # Exit code and what was printed


def is_status(state: str) -> Callable[[MqttMessage], bool]:
    def wanted(message: MqttMessage) -> bool:
        return message.topic.endswith("/status") and json.loads(message.payload)["state"] == state

    return wanted


def telemetry() -> bytes:
    now_ns = time.time_ns()
    report = {
        "time_utc": f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(now_ns // 10**9))}"
        f".{now_ns % 10**9:09d}Z",
        "latitude_deg": 40.46,
        "longitude_deg": -3.73,
        "altitude_m": 900.0,
        "altitude_reference": "ELLIPSOID",
    }
    return json.dumps(report).encode()


def listeners() -> dict[int, set[str]]:
    found: dict[int, set[str]] = {}
    for file in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{file}").read_text().splitlines():
            _, local, _, state, *_ = line.split()
            if state == "0A":
                address, _, port = local.partition(":")
                found.setdefault(int(port, 16), set()).add(address)
    return found


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    # Turns are long, so that a machine that stalls for a while is late but skips no sector.
    sensors = radar(period_s=3.0, sectors=SECTORS)
    seen = "stale_after_s = 60.0"  # When the beam comes round
    text = scene_text(sensors=sensors, drones="", mqtt=FOR_BROWSERS, telemetry=seen)
    scene = scene_file(tmp_path_factory.mktemp("session"), text)
    with running("run", scene) as at_work, ExitStack() as stack:
        port = at_work.port("MQTT")
        clients = {v: stack.enter_context(MqttReceiver(port, v, "plotfeed/#")) for v in VERSIONS}
        for version, client in clients.items():
            client.publish(f"plotfeed/telemetry/d{version}", telemetry())
        late = {}
        for version, client in clients.items():
            client.wait_for(is_status("ONLINE"))
            for drone in (f"d{version}" for version in VERSIONS):
                client.wait_for(lambda m, drone=drone: drone in looked_at(m))  # type: ignore[misc]
            for _ in range(20):
                client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            with MqttReceiver(port, version, "plotfeed/radar/status") as another:
                late[version] = another.wait_for(is_status("ONLINE"))
        listen, ports = listeners(), {port, at_work.port("WebSocket")}
        at_work.process.send_signal(signal.SIGTERM)
        for client in clients.values():
            client.wait_for(is_status("OFFLINE"))
        ended = at_work.end(signal.SIGTERM)
    return Session({v: c.heard for v, c in clients.items()}, late, listen, ports, ended)


def looked_at(message: MqttMessage) -> set[str]:
    """Drones."""
    entries = entries_in(message.payload) if message.topic == "plotfeed/truth" else []
    return {look.drone for entry in entries for look in entry.looks}


def test_subscribers_of_either_version_receive_the_whole_session(session: Session) -> None:
    def sectors(heard: list[MqttMessage]) -> Iterator[tuple[int, bytes]]:
        for message in heard:
            if message.topic.endswith("/plots"):
                batch = pb.PlotBatch.FromString(message.payload)
                yield batch.scan * SECTORS + batch.sector, message.payload

    found = [dict(sectors(session.heard[version])) for version in VERSIONS]
    first = max(min(each) for each in found)
    common = [{n: payload for n, payload in each.items() if n >= first} for each in found]
    assert common[0] == common[1]
    assert [*common[0]] == list(range(first, first + len(common[0])))
    assert len(common[0]) >= 20
    assert {m.topic.removeprefix("plotfeed/") for m in session.heard[5]} == {
        *("radar/asterix/034", "radar/asterix/048", "radar/plots", "session", "truth"),
        *("radar/status", "radar/settings", "radar/description", "telemetry/d4", "telemetry/d5"),
    }


def test_messages_say_what_they_are_in_mqtt_5(session: Session) -> None:
    by_end = {m.topic.rpartition("/")[2]: m for m in session.heard[5]}
    plots, status = by_end["plots"], by_end["status"]
    batch = pb.PlotBatch.FromString(plots.payload)
    protobuf = "application/x-protobuf; messageType=plotfeed.v1."
    assert plots.content_type == f"{protobuf}PlotBatch"
    assert by_end["truth"].content_type == f"{protobuf}LedgerBatch"
    assert by_end["034"].content_type == "application/x-asterix; cat=34"
    assert status.content_type == "application/json"
    said = plots.user_properties
    assert (said["sensor"], said["scan"]) == ("radar", str(batch.scan))
    assert (said["sector"], said["time"][-1]) == (str(batch.sector), "Z")
    assert plots.expiry_s is not None
    assert status.expiry_s is None  # it is retained for whoever comes however late


def test_the_status_is_retained_for_whoever_comes_later(session: Session) -> None:
    assert all(session.late[version].retained for version in VERSIONS)


def test_the_embedded_broker_is_heard_on_loopback_until_the_end(session: Session) -> None:
    assert {address for port in session.ports for address in session.listeners[port]} == {
        "0100007F"
    }
    for port in session.ports:
        wait_until_silent(port)


def test_a_signal_ends_it_and_says_what_came_in(session: Session) -> None:
    code, out, err = session.ended
    assert (code, err) == (0, "")
    assert "telemetry 2 refused 0" in out


def test_the_truth_can_be_kept_back_and_another_prefix_be_used(tmp_path: Path) -> None:
    text = scene_text(port=1883, mqtt='truth = false\nprefix = "my/site"')
    topics = {m.topic for m, _ in simulated(load(scene_file(tmp_path, text)), 2.0).said}
    assert "my/site/radar/plots" in topics
    assert all(topic.startswith("my/site/radar/") for topic in topics - {"my/site/session"})


@pytest.mark.asyncio
async def test_a_broker_that_cannot_start_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    scene = load(scene_file(tmp_path, scene_text()))
    with pytest.raises(PlotfeedError, match="did not start") as caught:
        await run(scene, duration_s=1)
    assert "\n" not in str(caught.value)
