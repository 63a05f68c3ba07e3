"""What brokers pass on of sessions, and tell of those that end, die, break or meet."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from support import command
from support.brokers import free_port, mosquitto, own_broker, sockets, wait_until_silent
from support.scene_files import FOR_BROWSERS, radar, scene_file, scene_text
from support.sessions import simulated
from support.waiting import wait_until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.part import PartHold
from plotfeed.feeds.session.presence import SessionPresence
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.state import AltitudeReference
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import START_NS, MqttMessage, MqttReceiver

VERSIONS = (4, 5)
SECTORS = 120
TOPIC = "plotfeed/session"


def said(message: MqttMessage) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(message.payload)
    return found


def wait_for_all(ears: MqttReceiver, sensors: list[str], state: str) -> None:
    """Every sensor says, or is said, to be so."""
    for name in sensors:
        topic = f"plotfeed/{name}/status"
        ears.wait_for(lambda m, topic=topic: m.topic == topic and said(m)["state"] == state)  # type: ignore[misc]


def retained(port: int, topic: str = TOPIC, version: int = 5) -> dict[str, Any]:
    with MqttReceiver(port, version, topic) as client:
        message = client.wait_for(lambda m: m.topic == topic)
    assert message.retained
    return said(message)


def looked_at(message: MqttMessage) -> set[str]:
    """Drones."""
    entries = entries_in(message.payload) if message.topic == "plotfeed/truth" else []
    return {look.drone for entry in entries for look in entry.looks}


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> dict[int, list[MqttMessage]]:
    """All of a session with a broker of its own, by version of MQTT; it ends by a signal."""
    # Turns are long, so that a machine that stalls for a while is late but skips no sector.
    sensors = radar(period_s=3.0, sectors=SECTORS)
    seen = "stale_after_s = 60.0"  # When the beam comes round
    text = scene_text(sensors=sensors, drones="", mqtt=FOR_BROWSERS, telemetry=seen)
    scene = scene_file(tmp_path_factory.mktemp("session"), text)
    place = 40.46, -3.73, 900.0, AltitudeReference.ELLIPSOID
    with command.running("run", scene) as at_work, ExitStack() as stack:
        port, web = at_work.port("MQTT"), at_work.port("WebSocket")
        clients = {v: stack.enter_context(MqttReceiver(port, v, "plotfeed/#")) for v in VERSIONS}
        for version, client in clients.items():
            report = PositionReport(time.time_ns(), *place).to_json()
            client.publish(f"plotfeed/telemetry/d{version}", report)
        for version, client in clients.items():
            wait_for_all(client, ["radar"], "ONLINE")
            for drone in (f"d{version}" for version in VERSIONS):
                client.wait_for(lambda m, drone=drone: drone in looked_at(m))  # type: ignore[misc]
            for _ in range(20):
                client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            assert retained(port, "plotfeed/radar/status", version)["state"] == "ONLINE"
        assert {s.address for s in sockets() if s.port in (port, web) and s.listens} == {"0100007F"}
        folder = Path(f"/proc/{at_work.process.pid}/fd")
        own = {str(each.readlink()) for each in folder.iterdir() if each.is_symlink()}
        to_it = [each for each in sockets() if each.peer_port == port]
        assert (
            sum(f"socket:[{each.inode}]" in own for each in to_it) == 1
        )  # it dies with its broker
        at_work.process.send_signal(signal.SIGTERM)
        for client in clients.values():
            wait_for_all(client, ["radar"], "OFFLINE")
        code, out, err = at_work.end(signal.SIGTERM)
        wait_until_silent(port)
        wait_until_silent(web)
    assert (code, err) == (0, "")
    assert "telemetry 2 refused 0" in out
    return {version: client.heard for version, client in clients.items()}


def test_subscribers_of_either_version_receive_the_whole_session(
    heard: dict[int, list[MqttMessage]],
) -> None:
    found = [
        {batch.scan * SECTORS + batch.sector: m.payload for m, batch in plots_of(heard[version])}
        for version in VERSIONS
    ]
    first = max(min(each) for each in found)
    common = [{n: payload for n, payload in each.items() if n >= first} for each in found]
    assert common[0] == common[1]
    assert [*common[0]] == list(range(first, first + len(common[0])))
    assert len(common[0]) >= 20
    assert {m.topic.removeprefix("plotfeed/") for m in heard[5]} == {
        *("radar/asterix/034", "radar/asterix/048", "radar/plots", "session", "truth"),
        *("radar/status", "radar/settings", "radar/description", "telemetry/d4", "telemetry/d5"),
    }


def plots_of(heard: list[MqttMessage]) -> list[tuple[MqttMessage, pb.PlotBatch]]:
    told = [message for message in heard if message.topic.endswith("/plots")]
    return [(message, pb.PlotBatch.FromString(message.payload)) for message in told]


def test_messages_say_what_they_are_in_mqtt_5(heard: dict[int, list[MqttMessage]]) -> None:
    by_end = {m.topic.rpartition("/")[2]: m for m in heard[5]}
    status, (plots, batch) = by_end["status"], plots_of(heard[5])[-1]
    protobuf = "application/x-protobuf; messageType=plotfeed.v1."
    assert plots.content_type == f"{protobuf}PlotBatch"
    assert by_end["truth"].content_type == f"{protobuf}LedgerBatch"
    assert by_end["034"].content_type == "application/x-asterix; cat=34"
    assert status.content_type == "application/json"
    properties = plots.user_properties
    assert (properties["sensor"], properties["scan"]) == ("radar", str(batch.scan))
    assert (properties["sector"], properties["time"][-1]) == (str(batch.sector), "Z")
    assert plots.expiry_s is not None
    assert status.expiry_s is None  # it is retained for whoever comes however late


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


# Who runs on a prefix.

SENSORS = [f"s{i}" for i in range(12)]
RADARS = "".join(radar(name, period_s=5.0, sectors=4) for name in SENSORS)


def scene_of(folder: Path, version: str = "any") -> Path:
    return scene_file(folder, scene_text(sensors=RADARS, mqtt=f'version = "{version}"'))


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_two_sessions_on_one_prefix_know_of_each_other(tmp_path: Path, how: signal.Signals) -> None:
    """And when one has ended, or died, what is retained is of the one that runs."""
    port = free_port()
    words = ("run", scene_of(tmp_path, "3.1.1"), "--broker", f"mqtt://127.0.0.1:{port}")

    def wait_for(since: int = 0, **wanted: str) -> str:
        """The session that tells that it is so, and that it has `heard` of another."""

        def is_told(message: MqttMessage) -> bool:
            if message.topic != TOPIC:
                return False
            told = said(message)
            return all(wants in told[key] for key, wants in wanted.items())

        return str(said(client.wait_for(is_told, since))["session"])

    with mosquitto(tmp_path, port), MqttReceiver(port, 5, TOPIC, "plotfeed/+/status") as client:
        with command.running(*words) as one:
            first = wait_for()
            wait_for_all(client, SENSORS, "ONLINE")
            with command.running(*words) as two:
                second = wait_for(heard=first)
                wait_for(session=first, heard=second)
                number = len(client.heard)
                two.process.send_signal(how)
                _, err_of_two = two.process.communicate()
            state = "ENDED" if how == signal.SIGTERM else "DIED"
            wait_for(session=second, state=state)
            wait_for(number, session=first, state="RUNNING")
            now = retained(port)
            number = len(client.heard)
            _, _, err_of_one = one.end(signal.SIGTERM)
            wait_for_all(client, SENSORS, "OFFLINE")
            time.sleep(0.3)  # By its own word, which a last will would follow with less
        told = [m.topic for m in client.heard[number:] if said(m)["state"] == "OFFLINE"]
        assert sorted(told) == sorted(f"plotfeed/{name}/status" for name in SENSORS)
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
            wait_for_all(client, SENSORS, "ONLINE")
            client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            session.process.kill()
            err = session.process.communicate()[1]
        assert err == ""
        wait_for_all(client, SENSORS, "OFFLINE")
        wait_until(lambda: retained(port)["state"] == "DIED")
        for version in VERSIONS:
            assert retained(port, "plotfeed/s11/status", version)["state"] == "OFFLINE"


def test_a_session_that_is_said_to_have_died_says_that_it_runs(tmp_path: Path) -> None:
    """By a last will that comes when it is connected again."""
    said_by, clock, hold = list[Message](), InstantClock(START_NS), PartHold()
    scene = load(scene_of(tmp_path))
    presence = SessionPresence(scene, clock, SessionCounters(), said_by.append, hold=hold)
    presence.begin(START_NS)
    for message in (said_by[0], presence.will(START_NS)):
        presence.hear(message.payload)
    assert [json.loads(m.payload)["state"] for m in said_by] == ["RUNNING", "RUNNING"]


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
        wait_until(lambda: retained(port, "plotfeed/s0/status")["state"] == "OFFLINE")
