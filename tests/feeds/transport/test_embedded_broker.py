"""What the embedded broker takes, how it bears a client that wants too much, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from support.brokers import deaf_server, free_port, port_is_taken, wait_until_silent
from support.command import plotfeed, running
from support.mqtt_websocket import FOR_BROWSERS
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.transport import embedded_broker
from plotfeed.feeds.transport.embedded_broker import BrokerError, EmbeddedBroker, Ports, free_ports
from plotfeed.testing import MqttReceiver

FAST = radar(period_s=0.2, sectors=8)


@pytest.mark.parametrize(
    ("offset", "protocol"), [(0, "MQTT 3.1.1"), (1, "MQTT 5"), (2, "WebSocket")]
)
def test_a_port_that_a_scene_names_is_not_exchanged(
    tmp_path: Path, offset: int, protocol: str
) -> None:
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=FAST, port=port, mqtt=FOR_BROWSERS))
    with port_is_taken(port + offset):
        done = plotfeed("run", scene, "--duration", 1)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        f"plotfeed: mqtt.port = {port}: port {port + offset} of 127.0.0.1, for {protocol}, is "
        "taken; name another, or leave the key out to have any that is free\n"
    )


def test_where_the_usual_port_is_taken_another_stands_in_and_that_is_told() -> None:
    with port_is_taken(1883), running("demo", "--page", "none") as demo:
        (line,) = (line for line in demo.introduction if line.startswith("  MQTT 3.1.1"))
        port = demo.port("MQTT 3.1.1")
        assert port != 1883
        assert line.split() == [
            "MQTT",
            "3.1.1",
            f"mqtt://127.0.0.1:{port}",
            *["(port", "1883", "is", "taken)"],
        ]
        assert f"look at it: plotfeed show mqtt://127.0.0.1:{port};" in demo.introduction[-1]
        with MqttReceiver(port, 4, "plotfeed/#") as client:
            client.wait_for(lambda m: m.topic == "plotfeed/session")


def test_free_ports_are_the_preferred_ones_if_nobody_has_them() -> None:
    preferred = free_port()
    assert free_ports(preferred) == Ports(preferred, preferred + 1)
    with_websocket = free_ports(preferred, websocket=True)
    assert with_websocket == Ports(preferred, preferred + 1, preferred + 2)


def test_ports_that_are_taken_are_passed_over() -> None:
    with deaf_server() as port:
        ports = free_ports(port)
        assert ports.mqtt3 != port
        assert ports.instead_of[ports.mqtt3] == port


def test_ports_beyond_the_last_are_passed_over() -> None:
    assert 0 < free_ports(65535).mqtt5 < 65536


@pytest.mark.asyncio
async def test_where_it_is_not_installed_it_is_said_how_to_name_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "iotcore", None)
    with pytest.raises(BrokerError, match=r"not installed.*--broker mqtt://HOST:PORT"):
        await EmbeddedBroker.start(free_port())


@pytest.mark.asyncio
async def test_a_port_that_is_lost_while_the_broker_starts_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        taken = holder.getsockname()[1]
        found = iter([Ports(free_port(), taken)])
        monkeypatch.setattr(
            embedded_broker, "free_ports", lambda *args: next(found, None) or free_ports(*args)
        )
        started = await EmbeddedBroker.start(free_port())
        try:
            assert started.ports.mqtt5 != taken
            with MqttReceiver(started.ports.mqtt5, 5):
                pass
        finally:
            started.stop()


@pytest.mark.asyncio
async def test_websocket_without_its_library_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embedded_broker, "find_spec", lambda name: name != "websockets" or None)
    keys = EmbeddedBrokerKeys(websocket_origins=())
    with pytest.raises(BrokerError) as caught:
        await EmbeddedBroker.start(free_port(), keys)
    expected = "mqtt.embedded.websocket_origins needs more: pip install 'plotfeed[page]'"
    assert str(caught.value) == expected


@pytest.mark.parametrize("version", [4, 5])
def test_a_client_that_has_too_much_retained_does_not_fill_the_memory(
    tmp_path: Path, version: int
) -> None:
    """The broker begins anew without it, says why, and the session goes on as it was."""
    text = scene_text(sensors=FAST, mqtt="[mqtt.embedded]\nmax_memory_mib = 64")
    with running("run", scene_file(tmp_path, text)) as session:
        port = {v: p for p, v in session.ports()}[version]
        before = {*_children(session.process.pid)}
        while before == {*_children(session.process.pid)}:  # it may cut off an attacker by itself
            with suppress(OSError):
                _attack(port, version, bytes(250_000))
        again = _connected(port, version, "#")
        for topic in ("session", "radar/settings", "radar/status", "radar/plots"):
            again.wait_for(lambda m, topic=topic: m.topic == f"plotfeed/{topic}")  # type: ignore[misc]
        assert not any(m.topic.startswith("attack/") for m in again.heard)
        again.close()
        code, _, err = session.end(signal.SIGTERM)
    assert code == 0
    protocol = {4: "MQTT 3.1.1", 5: "MQTT 5"}[version]
    assert (
        err.count(
            f"plotfeed: the embedded broker of {protocol} has ended (it took more than 64 MiB, "
            "mqtt.embedded.max_memory_mib); it starts anew\n"
        )
        == 1
    )


def test_connections_beyond_the_limit_are_not_taken(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST, mqtt="[mqtt.embedded]\nmax_connections = 10")
    with running("run", scene_file(tmp_path, text)) as session, ExitStack() as clients:
        port = session.port("MQTT 5")
        taken = 0
        with suppress(OSError, AssertionError):
            for _ in range(50):
                clients.enter_context(MqttReceiver(port, 5))
                taken += 1
        assert 5 <= taken < 10  # the session is one, too


def test_many_connections_that_say_nothing_keep_nobody_out(tmp_path: Path) -> None:
    with (
        running("run", scene_file(tmp_path, scene_text(sensors=FAST))) as session,
        ExitStack() as held,
    ):
        port = session.port("MQTT 3.1.1")
        for _ in range(900):
            held.enter_context(socket.create_connection(("127.0.0.1", port)))
        with MqttReceiver(port, 4, "plotfeed/#") as client:
            client.wait_for(lambda m: m.topic.endswith("/plots"))


def test_a_message_that_is_too_large_cuts_off_who_sends_it_alone(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST, mqtt="[mqtt.embedded]\nmax_payload_octets = 65536")
    with running("run", scene_file(tmp_path, text)) as session:
        port = session.port("MQTT 5")
        with (
            MqttReceiver(port, 5, "plotfeed/#", "other/#") as client,
            MqttReceiver(port, 5) as other,
        ):
            other.publish("other/small", bytes(65_000))
            client.wait_for(lambda m: m.topic == "other/small")
            with suppress(OSError):
                other.publish("other/large", bytes(70_000))
            other.wait_until_cut_off()
            client.wait_for(lambda m: m.topic.endswith("/plots"), len(client.heard))
            assert not any(m.topic == "other/large" for m in client.heard)


def test_a_session_that_was_killed_leaves_nothing_running_and_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=FOR_BROWSERS))
    with running("run", scene) as session, ExitStack() as stack:
        clients = [
            stack.enter_context(MqttReceiver(*place, "plotfeed/#")) for place in session.ports()
        ]
        children = [*_children(session.process.pid)]
        assert len(children) == 3
        os.kill(session.process.pid, signal.SIGKILL)
        for client in clients:
            client.wait_until_cut_off()
        for protocol in ("MQTT 3.1.1", "MQTT 5", "WebSocket"):
            wait_until_silent(session.port(protocol))
        wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children))
    assert {path.name for path in temporary.iterdir()} <= {f"plotfeed-{os.getuid()}.lock"}


def test_a_broker_that_dies_is_started_anew(tmp_path: Path) -> None:
    with running("run", scene_file(tmp_path, scene_text(sensors=FAST))) as session:
        port = session.port("MQTT 5")
        with MqttReceiver(port, 5) as client:
            for pid in _children(session.process.pid):
                os.kill(pid, signal.SIGKILL)
            client.wait_until_cut_off()
        again = _connected(port, 5, "plotfeed/#")
        settings = again.wait_for(lambda m: m.topic.endswith("/settings"))
        again.wait_for(lambda m: m.topic.endswith("/plots"))
        again.close()
        _, _, err = session.end(signal.SIGTERM)
    assert json.loads(settings.payload)["sensor"] == "radar"
    assert err.count("has ended (exit code -9); it starts anew") == 2


def _attack(port: int, version: int, octets: bytes) -> None:
    """Have messages retained, each on a topic of its own, until cut off or 500 MB are sent."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as attacker:
        none = b"\0" if version == 5 else b""
        hello = b"\0\4MQTT" + bytes([version, 2, 0, 60]) + none + b"\0\6attack"
        attacker.sendall(bytes([0x10, len(hello)]) + hello)
        assert attacker.recv(4)[:1] == b"\x20"
        for number in range(500_000_000 // len(octets)):
            body = b"\0\x0cattack/" + b"%05d" % number + none + octets
            length = bytes([len(body) & 127 | 128, len(body) >> 7 & 127 | 128, len(body) >> 14])
            attacker.sendall(b"\x31" + length + body)
        raise AssertionError("nothing stopped the attack")


def _children(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").iterdir():
        yield from map(int, (task / "children").read_text().split())


def _connected(port: int, version: int, *filters: str) -> MqttReceiver:
    found: list[MqttReceiver] = []

    def connects() -> bool:
        with suppress(OSError, AssertionError):
            found.append(MqttReceiver(port, version, *filters))
        return bool(found)

    wait_until(connects)
    return found[0]
