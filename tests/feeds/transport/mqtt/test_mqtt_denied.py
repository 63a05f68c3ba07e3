"""What mosquitto's access list or its limit on connections denies a session, and what it tells."""

from __future__ import annotations

import asyncio
import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from socketserver import BaseRequestHandler, TCPServer
from threading import Thread

import pytest
from support.brokers import free_port, mosquitto, mosquitto_with
from support.command import plotfeed, running
from support.cut_proxy import proxied
from support.scene_files import radar, scene_file, scene_text

from plotfeed.testing import MqttReceiver

DOCUMENTED = Path(__file__).parents[4] / "docs" / "mqtt.md"


@pytest.fixture(autouse=True)
def credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", "plotfeed")
    monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", "secret")


def scene(folder: Path, version: str = "any") -> Path:
    mqtt = f'prefix = "north/site/7"\nversion = "{version}"'
    return scene_file(folder, scene_text(sensors=radar(period_s=0.2, sectors=8), mqtt=mqtt))


@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_the_access_list_of_the_documentation_is_enough(tmp_path: Path, version: str) -> None:
    (access,) = re.findall(r"^user plotfeed\n.*?(?=^```)", DOCUMENTED.read_text(), re.M | re.S)
    with (
        mosquitto_with(tmp_path, access) as port,
        MqttReceiver(port, 5, "north/#") as client,
        running("run", scene(tmp_path, version), "--broker", f"mqtt://127.0.0.1:{port}") as session,
    ):
        client.wait_for(lambda m: m.topic.endswith("/plots"))
        command = b'{"sensor": "radar", "set": {"enabled": false}}'
        client.publish("north/site/7/control", command)
        client.wait_for(
            lambda m: m.topic.endswith("/settings") and bool(json.loads(m.payload)["controlled"])
        )
        client.publish("north/site/7/telemetry/x", b"rubbish")
        client.wait_for(lambda m: m.topic.endswith("/errors"))
        assert session.end(signal.SIGTERM)[2] == ""


@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_a_broker_that_passes_nothing_on_is_told(tmp_path: Path, version: str) -> None:
    """It grants the subscriptions that its access list denies."""
    with (
        mosquitto_with(tmp_path, "user plotfeed\ntopic write north/site/7/#") as port,
        running("run", scene(tmp_path, version), "--broker", f"mqtt://127.0.0.1:{port}") as session,
    ):
        told = session.process.stderr.readline()
        session.end(signal.SIGTERM)
    assert told.startswith("plotfeed: nothing comes back from north/site/7/session: ")
    assert "north/site/7/control" in told


def test_topics_that_may_not_be_written_are_named(tmp_path: Path) -> None:
    access = "user plotfeed\ntopic readwrite north/site/7/session\ntopic read north/site/7/#"
    with mosquitto_with(tmp_path, access) as port:
        url = f"mqtt://127.0.0.1:{port}"
        done = plotfeed("run", scene(tmp_path, "5"), "--broker", url, "--duration", 1)
    for topic in ("radar/status", "radar/settings"):
        line = f"{url} refuses what is published on north/site/7/{topic}: "
        assert done.stderr.count(line) == 1
    assert "session" not in done.stderr


HINT = "it hung up without an answer: it may have as many connections as it takes"


@contextmanager
def full_broker() -> Iterator[int]:
    """The port of one that takes every connection, and ends it at once."""

    class Full(BaseRequestHandler):
        """Says nothing."""

    with TCPServer(("127.0.0.1", 0), Full) as server:
        serving = Thread(target=server.serve_forever, args=(0.05,))
        serving.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            serving.join()


def test_a_broker_that_takes_no_more_connections_is_not_taken_for_tls(tmp_path: Path) -> None:
    """As mosquitto does, which miscounts after that: so it is done in its stead."""
    with full_broker() as port:
        url = f"mqtt://127.0.0.1:{port}"
        done = plotfeed("run", scene(tmp_path), "--broker", url, "--duration", 1)
    assert done.returncode == 1
    assert done.stderr.startswith(f"plotfeed: MQTT broker {url}: {HINT}, or want ")
    assert "TLS" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.asyncio
async def test_a_limit_that_has_no_room_for_wills_is_told_as_that(tmp_path: Path) -> None:
    """By a proxy that takes one connection, as mosquitto does until it miscounts."""
    port = free_port()
    with mosquitto(tmp_path, port):
        async with proxied(port) as proxy:
            proxy.most, url = 1, f"mqtt://127.0.0.1:{proxy.port}"
            words = ("run", scene(tmp_path), "--broker", url, "--duration", 1)
            done = await asyncio.to_thread(plotfeed, *words)
    assert done.returncode == 0
    assert done.stderr == f"plotfeed: plotfeed-session-wills: no last will at {url} ({HINT})\n"
