from __future__ import annotations

import json
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import pytest
from paho.mqtt.client import CallbackAPIVersion, Client, MQTTMessage
from support.brokers import is_listening
from support.command import plotfeed, running
from support.scene_files import FOR_BROWSERS, ORIGIN, radar, scene_file, scene_text
from support.waiting import PATIENCE_S
from websockets.exceptions import InvalidMessage, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient

FAST = radar(period_s=0.2, sectors=8)


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


def test_a_browser_receives_what_other_subscribers_do(tmp_path: Path) -> None:
    mqtt = f'prefix = "north/site/7"\n{FOR_BROWSERS}'
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=mqtt))
    wanted = {"asterix/048", "asterix/034", "plots", "status"}
    seen = {}
    with (
        running("run", scene) as session,
        browsing(session.port("WebSocket"), "north/site/7/#") as page,
    ):
        for message in page:
            kind = message.topic.removeprefix("north/site/7/radar/")
            seen[kind] = message
            if wanted <= seen.keys():
                break
    for category in (48, 34):
        records, errors = decode_lenient(seen[f"asterix/{category:03d}"].payload)
        assert not errors
        assert {record.category for record in records} == {category}
    assert pb.PlotBatch.FromString(seen["plots"].payload).sensor == "radar"
    assert json.loads(seen["status"].payload)["state"] == "ONLINE"


def test_a_page_that_comes_late_is_told_the_status(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=FOR_BROWSERS))
    with running("run", scene) as session:
        for _ in range(2):  # the first may come before the status
            with browsing(session.port("WebSocket"), "plotfeed/radar/status") as page:
                message = next(page)
    assert message.retain
    assert json.loads(message.payload)["state"] == "ONLINE"


def test_pages_of_other_sites_are_turned_away(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=FOR_BROWSERS))
    with running("run", scene) as session:
        port = session.port("WebSocket")
        for headers in (
            {"origin": "http://evil.example"},
            {"origin": "null"},
            {"origin": f"{ORIGIN}0"},
            {"host": "evil.example"},
            {"origin": "http://evil.example", "host": "evil.example"},
        ):
            with pytest.raises(InvalidStatus, match="403"), opened(port, **headers):
                pass
        with opened(port) as page:
            assert page.subprotocol == "mqtt"  # else a browser closes the connection
            assert not page.protocol.extensions
        _, _, err = session.end(signal.SIGTERM)
    assert err == ""


def test_without_its_key_there_is_no_websocket(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    with running("run", scene) as session:
        assert "WebSocket" not in "".join(session.introduction)
        assert not is_listening(session.port("MQTT") + 1)
        with pytest.raises((InvalidMessage, OSError)), opened(session.port("MQTT")):
            pass


@pytest.mark.parametrize(
    "origin", ["*", "null", "localhost:80", "http://a/", "http://a/b", "ws://a"]
)
def test_what_is_no_origin_is_refused(tmp_path: Path, origin: str) -> None:
    keys = f'[mqtt.embedded]\nwebsocket_origins = ["{origin}"]'
    done = plotfeed("check", scene_file(tmp_path, scene_text(mqtt=keys)))
    assert done.returncode == 2
    assert "mqtt.embedded.websocket_origins" in done.stderr
    assert "expected http://HOST:PORT" in done.stderr
