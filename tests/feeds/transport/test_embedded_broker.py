"""What the embedded broker takes, how it bears a client that wants too much, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import pytest
from paho.mqtt.client import CallbackAPIVersion, Client, MQTTMessage
from support.brokers import deaf_server, free_port, port_is_taken, wait_until_silent
from support.command import plotfeed_here, running
from support.scene_files import FOR_BROWSERS, ORIGIN, radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.transport import embedded_broker
from plotfeed.feeds.transport.broker_process import listeners
from plotfeed.feeds.transport.embedded_broker import BrokerError, EmbeddedBroker
from plotfeed.feeds.transport.mqtt.packets import connect_packet
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.testing import MqttReceiver

FAST = radar(period_s=0.2, sectors=8)


def test_ports_are_the_preferred_ones_if_nobody_has_them_and_they_are_ports() -> None:
    def ports_had(*wanted: int) -> list[int]:
        with ExitStack() as stack:
            found = listeners("127.0.0.1", wanted, may_be_others=True)
            return [stack.enter_context(each).getsockname()[1] for each in found]

    preferred = free_port()
    assert ports_had(preferred, preferred + 1) == [preferred, preferred + 1]
    assert 0 < ports_had(65535, 65536)[1] < 65536
    with deaf_server() as port:
        assert ports_had(port) != [port]


@pytest.mark.asyncio
async def test_a_port_that_somebody_holds_is_replaced_and_told_of_unless_a_scene_names_it() -> None:
    port, keys = free_port(), EmbeddedBrokerKeys(websocket_origins=())
    with port_is_taken(port + 1), pytest.raises(BrokerError) as refused:
        await EmbeddedBroker.start(port, keys, may_be_others=False)
    assert str(refused.value) == (
        f"mqtt.port = {port}: port {port + 1} of 127.0.0.1, for WebSocket, is taken; name another, "
        "or leave the key out to have any that is free"
    )
    with deaf_server() as taken:
        started = await EmbeddedBroker.start(taken)
        try:
            own = started.ports.mqtt
            told = f"mqtt://127.0.0.1:{own} (port {taken} is taken)"
            assert started.ports.urls() == {"MQTT": told}  # of WebSocket nothing without its key
            with MqttReceiver(own, 5):
                pass
        finally:
            await started.stop()


@pytest.mark.asyncio
async def test_a_host_that_this_machine_does_not_have_is_said_as_the_system_says_it() -> None:
    for may_be_others in (True, False):
        with pytest.raises(OSError, match=r"Cannot assign requested address$"):
            await EmbeddedBroker.start(
                free_port(), EmbeddedBrokerKeys(host="192.0.2.1"), may_be_others=may_be_others
            )


@pytest.mark.asyncio
async def test_websocket_without_its_library_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embedded_broker, "find_spec", lambda name: name != "websockets" or None)
    expected = r"^mqtt\.embedded\.websocket_origins needs more: pip install 'plotfeed\[page\]'$"
    with pytest.raises(BrokerError, match=expected):
        await EmbeddedBroker.start(free_port(), EmbeddedBrokerKeys(websocket_origins=()))


def test_users_may_do_what_their_names_say_and_nobody_comes_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("TELEMETRY", "CONTROL", "PLOTS", "TRUTH"):
        monkeypatch.setenv(f"PLOTFEED_BROKER_{name}", f"{name.lower()}-password-16")
    text = scene_text(sensors=FAST, mqtt="[mqtt.embedded]\nusers = true")
    with running("run", scene_file(tmp_path, text)) as session, ExitStack() as clients:
        port = session.port("MQTT")

        def come(name: str, *filters: str) -> MqttReceiver:
            entry = (name, f"{name}-password-16")
            return clients.enter_context(MqttReceiver(port, 4, *filters, user=entry))

        for wrong in (None, ("plots", "guessed"), ("session", ""), ("nobody", "")):
            with pytest.raises((AssertionError, OSError)):
                MqttReceiver(port, 5, user=wrong)
        truth, plots, control, telemetry = (
            come(name, "plotfeed/#", "tracks/#")
            for name in ("truth", "plots", "control", "telemetry")
        )
        everybody = (truth, plots, control, telemetry)
        for client in everybody:
            client.publish("plotfeed/telemetry/intruder", b"{}")
            client.publish("plotfeed/control", b'{"of": "' + str(id(client)).encode() + b'"}')
            client.publish("tracks/1", str(id(client)).encode())
        truth.wait_for(lambda m: m.topic == "plotfeed/truth")
        plots.wait_for(lambda m: m.topic == "plotfeed/errors")
        plots.wait_for(lambda m: m.topic == "tracks/1")
        truth.wait_for(lambda m: m.topic == "plotfeed/telemetry/intruder")
        for client in everybody:
            client.wait_for(lambda m: m.topic == "plotfeed/session")
        plots.wait_for(lambda m: m.topic == "plotfeed/radar/plots")
    heard = {client: {m.topic for m in client.heard} for client in everybody}
    secret = {"plotfeed/truth", "plotfeed/telemetry/intruder"}
    assert not secret & (heard[plots] | heard[control] | heard[telemetry])
    assert "plotfeed/radar/plots" in heard[control] & heard[plots] & heard[truth]
    assert "plotfeed/radar/plots" not in heard[telemetry]
    # Each told one thing of each kind, and only who may: a topic heard once is from one client.
    assert [len(truth.on(f"plotfeed/{end}")) for end in ("telemetry/intruder", "control")] == [1, 1]
    assert plots.on("tracks/1") == [str(id(plots)).encode()]


def test_passwords_are_drawn_and_told_once_where_nobody_fixes_them(tmp_path: Path) -> None:
    text = scene_text(sensors=FAST, mqtt='[mqtt.embedded]\nhost = "0.0.0.0"')
    with running("run", scene_file(tmp_path, text)) as session:
        port = session.port("MQTT")
        with pytest.raises((AssertionError, OSError)):
            MqttReceiver(port, 5)
        _, _, err = session.end(signal.SIGTERM)
    (line,) = (each for each in err.splitlines() if "users of the embedded broker" in each)
    told = dict(pair.split() for pair in line.partition("password: ")[2].split(", "))
    assert told.keys() == {"telemetry", "control", "plots", "truth"}
    assert all(len(password) >= 16 for password in told.values())


def test_many_connections_that_say_nothing_keep_nobody_out(tmp_path: Path) -> None:
    with (
        running("run", scene_file(tmp_path, scene_text(sensors=FAST))) as session,
        ExitStack() as held,
    ):
        port = session.port("MQTT")
        for _ in range(900):
            held.enter_context(socket.create_connection(("127.0.0.1", port)))
        with MqttReceiver(port, 4, "plotfeed/#") as client:
            client.wait_for(lambda m: m.topic.endswith("/plots"))


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
        assert len(children) == 1
        os.kill(session.process.pid, signal.SIGKILL)
        for client in clients:
            client.wait_until_cut_off()
        for protocol in ("MQTT", "WebSocket"):
            wait_until_silent(session.port(protocol))
        wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children))
    assert not [*temporary.iterdir()]


def test_a_broker_that_dies_is_started_anew(tmp_path: Path) -> None:
    with running("run", scene_file(tmp_path, scene_text(sensors=FAST))) as session:
        port = session.port("MQTT")
        with MqttReceiver(port, 5) as client:
            for pid in _children(session.process.pid):
                os.kill(pid, signal.SIGKILL)
            client.wait_until_cut_off()
        found: list[MqttReceiver] = []

        def is_back() -> bool:
            with suppress(OSError, AssertionError):
                found.append(MqttReceiver(port, 5, "plotfeed/#"))
            return bool(found)

        wait_until(is_back)
        with found[0] as again:
            settings = again.wait_for(lambda m: m.topic.endswith("/settings"))
            again.wait_for(lambda m: m.topic.endswith("/plots"))
        _, _, err = session.end(signal.SIGTERM)
    assert json.loads(settings.payload)["sensor"] == "radar"
    assert err.count("has ended (exit code -9); it starts anew") == 1


def _children(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").iterdir():
        yield from map(int, (task / "children").read_text().split())


# WebSocket, for pages.


@contextmanager
def browsing(port: int, topic_filter: str) -> Iterator[Iterator[MQTTMessage]]:
    """What comes to a page of ORIGIN that subscribes; fails if nothing does for long."""
    came = SimpleQueue[MQTTMessage]()
    client = Client(CallbackAPIVersion.VERSION2, transport="websockets")
    client.ws_set_options("/mqtt", {"Origin": ORIGIN})
    client.on_connect = lambda *_: client.subscribe(topic_filter)
    client.on_message = lambda *told: came.put(told[2])
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        yield iter(partial(came.get, timeout=PATIENCE_S), None)
    finally:
        client.disconnect()
        client.loop_stop()


@contextmanager
def opened(port: int, origin: str = ORIGIN, host: str = "127.0.0.1") -> Iterator[ClientConnection]:
    """The WebSocket alone, by a page of that origin that has asked for that host."""
    with (
        socket.create_connection(("127.0.0.1", port), PATIENCE_S) as wire,
        connect(
            f"ws://{host}:{port}/mqtt",
            sock=wire,
            origin=Origin(origin),
            subprotocols=[Subprotocol("mqtt")],
        ) as page,
    ):
        yield page


def test_a_browser_receives_what_other_subscribers_do_and_other_sites_nothing(
    tmp_path: Path,
) -> None:
    mqtt = f'prefix = "north/site/7"\n{FOR_BROWSERS}'
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=mqtt))
    wanted, seen = {"asterix/048", "asterix/034", "plots", "status"}, dict[str, MQTTMessage]()
    with running("run", scene) as session:
        port = session.port("WebSocket")
        with browsing(port, "north/site/7/#") as page:
            while not wanted <= seen.keys():
                message = next(page)
                seen[message.topic.removeprefix("north/site/7/radar/")] = message
        with browsing(port, "north/site/7/radar/status") as page:  # who comes late is told it, too
            late = next(page)
        for headers in (
            {"origin": "http://evil.example"},
            {"origin": "null"},
            {"origin": f"{ORIGIN}0"},
            {"host": "evil.example"},
        ):
            with pytest.raises(InvalidStatus, match="403"), opened(port, **headers):
                pass
        will = Message("will", b"gone", "", 0, retain=True)  # for who comes late, too
        with browsing(port, "will") as others:
            with opened(port) as page:
                assert page.subprotocol == "mqtt"  # else a browser closes the connection
                assert not page.protocol.extensions
                page.send(connect_packet("page", 4, will=will, keep_alive_s=0))
                page.recv()
            assert next(others).payload == b"gone"  # of a page that is closed
        _, _, err = session.end(signal.SIGTERM)
    assert err == ""
    for category in (48, 34):
        records, errors = decode_lenient(seen[f"asterix/{category:03d}"].payload)
        assert not errors
        assert {record.category for record in records} == {category}
    assert pb.PlotBatch.FromString(seen["plots"].payload).sensor == "radar"
    assert late.retain
    assert json.loads(seen["status"].payload)["state"] == "ONLINE"
    assert json.loads(late.payload)["state"] == "ONLINE"


def test_what_is_no_origin_is_refused(tmp_path: Path) -> None:
    for origin in ("*", "null", "localhost:80", "http://a/", "http://a/b", "ws://a"):
        keys = f'[mqtt.embedded]\nwebsocket_origins = ["{origin}"]'
        done = plotfeed_here("check", scene_file(tmp_path, scene_text(mqtt=keys)))
        assert done.returncode == 2
        assert "mqtt.embedded.websocket_origins" in done.stderr
        assert "expected http://HOST:PORT" in done.stderr
