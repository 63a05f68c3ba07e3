from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from support.brokers import is_listening
from support.command import plotfeed, running
from support.mqtt_websocket import FOR_BROWSERS, ORIGIN, browsing
from support.scene_files import radar, scene_file, scene_text

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient

FAST = radar(period_s=0.2, sectors=8)


def test_a_browser_receives_what_other_subscribers_do(tmp_path: Path) -> None:
    mqtt = f'prefix = "north/site/7"\n{FOR_BROWSERS}'
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt=mqtt))
    wanted = {"asterix/048", "asterix/034", "plots", "status"}
    seen = {}
    with (
        running("run", scene) as session,
        browsing(session.port("WebSocket"), "north/site/7/#") as page,
    ):
        for message in page.published():
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
                message = next(page.published())
    assert message.retained
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
            with pytest.raises(ConnectionRefusedError, match="403"), browsing(port, **headers):
                pass
        with browsing(port, "plotfeed/#") as page:
            next(page.published())
        _, _, err = session.end(signal.SIGTERM)
    assert err == ""


def test_without_its_key_there_is_no_websocket(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    with running("run", scene) as session:
        assert "WebSocket" not in "".join(session.introduction)
        assert not is_listening(session.port("MQTT") + 1)
        with pytest.raises(ConnectionResetError), browsing(session.port("MQTT")):
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
