from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support import command
from support.brokers import free_port, is_listening, mosquitto, wait_until_silent
from support.command import Running
from support.scene_files import FOR_BROWSERS, radar, scene_file, scene_text
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttMessage, MqttReceiver

FAST = radar(period_s=0.2, sectors=8)


@contextmanager
def running(folder: Path, *options: str, text: str | None = None) -> Iterator[Running]:
    scene = scene_file(folder, scene_text(sensors=FAST) if text is None else text)
    with command.running("run", scene, *options) as session:
        yield session


def is_status(state: str) -> Callable[[MqttMessage], bool]:
    def wanted(message: MqttMessage) -> bool:
        return message.topic.endswith("/status") and json.loads(message.payload)["state"] == state

    return wanted


def plots_of(messages: list[MqttMessage]) -> list[tuple[int, int, bytes]]:
    """Scan, sector and octets of every batch of plots."""
    found = []
    for message in messages:
        if message.topic.endswith("/plots"):
            batch = pb.PlotBatch.FromString(message.payload)
            found.append((batch.scan, batch.sector, message.payload))
    return found


def telemetry(t_utc_ns: int, **changes: object) -> bytes:
    report = {
        "time_utc": f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(t_utc_ns // 10**9))}"
        f".{t_utc_ns % 10**9:09d}Z",
        "latitude_deg": 40.46,
        "longitude_deg": -3.73,
        "altitude_m": 900.0,
        "altitude_reference": "ELLIPSOID",
        **changes,
    }
    return json.dumps(report).encode()


def test_subscribers_of_either_version_receive_the_whole_session(tmp_path: Path) -> None:
    # Turns are long, so that a machine that stalls for a while is late but skips no sector.
    text = scene_text(sensors=radar(period_s=4.0, sectors=160))
    with running(tmp_path, text=text) as session, ExitStack() as stack:
        clients = [
            stack.enter_context(MqttReceiver(port, version, "plotfeed/#"))
            for port, version in session.ports()
        ]
        began = [c.wait_for(lambda m: m.topic.endswith("/plots")) for c in clients]
        first = max(plots_of(began))[:2]
        for client in clients:
            client.wait_for(lambda m: m.topic.endswith("/048"))
            for _ in range(30):
                client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
        session.process.send_signal(signal.SIGTERM)
        for client in clients:
            client.wait_for(is_status("OFFLINE"))
        session.process.wait(PATIENCE_S)
        heard = [sorted(p for p in plots_of(client.heard) if p[:2] > first) for client in clients]
    assert heard[0] == heard[1]
    assert len(heard[0]) >= 20
    places = [scan * 160 + sector for scan, sector, _ in heard[0]]
    assert places == list(range(places[0], places[0] + len(places)))
    topics = {m.topic for m in clients[0].heard}
    assert topics == {
        "plotfeed/radar/asterix/034",
        "plotfeed/radar/asterix/048",
        "plotfeed/radar/plots",
        "plotfeed/radar/status",
        "plotfeed/radar/settings",
        "plotfeed/radar/description",
        "plotfeed/session",
        "plotfeed/truth",
    }


def test_messages_say_what_they_are_in_mqtt_5(tmp_path: Path) -> None:
    with (
        running(tmp_path) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/#") as client,
    ):
        plots = client.wait_for(lambda m: m.topic.endswith("/plots"))
        service = client.wait_for(lambda m: m.topic.endswith("/034"))
        truth = client.wait_for(lambda m: m.topic.endswith("/truth"))
        status = client.wait_for(lambda m: m.topic.endswith("/status"))
    batch = pb.PlotBatch.FromString(plots.payload)
    assert plots.content_type == "application/x-protobuf; messageType=plotfeed.v1.PlotBatch"
    assert plots.user_properties["sensor"] == "radar"
    assert plots.user_properties["scan"] == str(batch.scan)
    assert plots.user_properties["sector"] == str(batch.sector)
    assert plots.user_properties["time"].endswith("Z")
    assert service.content_type == "application/x-asterix; cat=34"
    assert truth.content_type == "application/x-protobuf; messageType=plotfeed.v1.LedgerBatch"
    assert status.content_type == "application/json"
    assert plots.expiry_s is not None
    assert status.expiry_s is None  # it is retained for whoever comes however late


def test_the_status_is_retained_for_whoever_comes_later(tmp_path: Path) -> None:
    with running(tmp_path) as session:
        for port, version in session.ports():
            with MqttReceiver(port, version, "plotfeed/radar/status") as early:
                early.wait_for(is_status("ONLINE"))
            with MqttReceiver(port, version, "plotfeed/radar/status") as late:
                assert late.wait_for(is_status("ONLINE")).retained


def test_the_truth_can_be_kept_back(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST, mqtt='truth = false\nprefix = "my/site"')
    with (
        running(tmp_path, text=text) as session,
        MqttReceiver(session.port("MQTT"), 5, "#") as ears,
    ):
        for _ in range(3):
            ears.wait_for(lambda m: m.topic == "my/site/radar/plots", len(ears.heard))
        topics = {m.topic for m in ears.heard}
    assert "my/site/truth" not in topics
    assert all(topic.startswith("my/site/radar/") for topic in topics - {"my/site/session"})


def test_a_session_that_was_killed_leaves_its_sensors_offline(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        with (
            running(tmp_path, "--broker", f"mqtt://127.0.0.1:{port}") as session,
            MqttReceiver(port, 5, "plotfeed/radar/status") as client,
        ):
            client.wait_for(is_status("ONLINE"))
            os.kill(session.process.pid, signal.SIGKILL)
            client.wait_for(is_status("OFFLINE"))
        for version in (4, 5):
            with MqttReceiver(port, version, "plotfeed/radar/status") as client:
                assert client.wait_for(is_status("OFFLINE")).retained


def test_the_embedded_broker_is_heard_on_loopback_only(tmp_path: Path) -> None:
    with running(tmp_path, text=scene_text(sensors=FAST, mqtt=FOR_BROWSERS)) as session:
        ports = [*(p for p, _ in session.ports()), session.port("WebSocket")]
        inodes = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
    listeners = [line.split()[1] for line in inodes.splitlines() if line.split()[3] == "0A"]
    for port in ports:
        addresses = [a.split(":")[0] for a in listeners if int(a.split(":")[1], 16) == port]
        assert addresses == ["0100007F"], port


def test_two_sessions_find_brokers_of_their_own(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST)
    text = re.sub(r"(?m)^port = \d+$", "", text)  # any will do
    with running(tmp_path, text=text) as one, running(tmp_path, text=text) as other:
        assert set(one.ports()).isdisjoint(other.ports())


def test_telemetry_over_either_version_becomes_plots(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST, drones="")
    with running(tmp_path, text=text) as session, ExitStack() as stack:
        ears = stack.enter_context(MqttReceiver(session.port("MQTT"), 5, "plotfeed/truth"))
        senders = [stack.enter_context(MqttReceiver(*place)) for place in session.ports()]
        for i, sender in enumerate(senders):
            sender.publish(f"plotfeed/telemetry/d{i}", telemetry(time.time_ns()))
        for i in range(len(senders)):
            ears.wait_for(
                lambda m, name=f"d{i}": (
                    name  # type: ignore[misc]
                    in {look.drone for entry in entries_in(m.payload) for look in entry.looks}
                )
            )
        code, out, err = session.end(signal.SIGTERM)
    assert code == 0
    assert "telemetry 2 refused 0" in out
    assert err == ""


@pytest.mark.asyncio
async def test_a_session_outlives_its_broker(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its broker goes and comes back; it reconnects, hears telemetry again, and counts the loss."""
    port = free_port()
    scene = load(scene_file(tmp_path, scene_text(sensors=FAST, drones="")))

    async with asyncio.timeout(PATIENCE_S):
        stop, ready = asyncio.Event(), asyncio.Event()
        mosquitto_runs = ExitStack()
        await asyncio.to_thread(mosquitto_runs.enter_context, mosquitto(tmp_path, port))
        grown: list[SessionCounters] = []

        def on_ready(_urls: dict[str, str], totals: SessionCounters) -> None:
            grown.append(totals)
            ready.set()

        working = asyncio.create_task(
            run(
                scene,
                clock=WallClock(),
                broker=f"mqtt://127.0.0.1:{port}",
                stop=stop,
                on_ready=on_ready,
            )
        )
        await asyncio.wait_for(ready.wait(), PATIENCE_S)
        (totals,) = grown
        await asyncio.to_thread(mosquitto_runs.close)
        await until(lambda: totals.undelivered > 5)
        mosquitto_runs = ExitStack()
        await asyncio.to_thread(mosquitto_runs.enter_context, mosquitto(tmp_path, port))
        client = await asyncio.to_thread(MqttReceiver, port, 5, "plotfeed/#")
        while totals.telemetry == 0:
            client.publish("plotfeed/telemetry/d", telemetry(time.time_ns()))
            await asyncio.sleep(0.1)
        await asyncio.to_thread(client.wait_for, lambda m: m.topic.endswith("/plots"))
        status = await asyncio.to_thread(client.wait_for, is_status("ONLINE"))
        await until(lambda: totals.messages > totals.undelivered)  # it goes on delivering
        stop.set()
        await asyncio.to_thread(client.wait_for, is_status("OFFLINE"))
        totals = await working
        await asyncio.to_thread(client.close)
        await asyncio.to_thread(mosquitto_runs.close)
    assert json.loads(status.payload)["sensor"] == "radar"
    assert totals.telemetry >= 1
    assert totals.undelivered > 5
    lost = [r.message for r in caplog.records if "lost the connection" in r.message]
    assert len(lost) == 1  # of the one connection for data; those of last wills say nothing


@pytest.mark.asyncio
async def test_a_broker_that_cannot_start_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    scene = load(scene_file(tmp_path, scene_text(sensors=FAST)))
    with pytest.raises(PlotfeedError, match="did not start") as caught:
        await run(scene, duration_s=1)
    assert "\n" not in str(caught.value)


def test_nothing_listens_once_a_session_has_ended(tmp_path: Path) -> None:
    with running(tmp_path) as session:
        ports = [p for p, _ in session.ports()]
        assert all(is_listening(port) for port in ports)
        assert session.end(signal.SIGTERM)[0] == 0
        for port in ports:
            wait_until_silent(port)
