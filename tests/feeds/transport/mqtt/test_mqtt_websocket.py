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
from support.command import plotfeed_here, running
from support.scene_files import FOR_BROWSERS, ORIGIN, radar, scene_file, scene_text
from support.waiting import PATIENCE_S
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.packets import connect_packet
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
