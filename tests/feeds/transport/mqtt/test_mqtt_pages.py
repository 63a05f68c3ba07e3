"""What docs/mqtt.md and docs/udp.md tell to write down works as it stands there."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from support.brokers import free_port, mosquitto, password_file, wait_until_listening
from support.certificates import Certificates

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.feeds.transport.brokers import broker_address
from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAddress

DOCS = Path(__file__).parents[4] / "docs"
REST = """
[scene]
name = "pages"
seed = 1
site = { latitude_deg = 40.0, longitude_deg = -3.0, height_m = 0.0 }
[[sensor]]
id = "radar"
type = "active_radar"
preset = "echodyne"
"""


def blocks(page: str, kind: str = "") -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```$", (DOCS / page).read_text(), re.M | re.S)
    return [text for its_kind, text in found if its_kind == kind]


def test_the_tables_of_the_pages_are_tables_of_a_scene(tmp_path: Path) -> None:
    limits, mqtt, credentials, queue = blocks("mqtt.md", "toml")
    assert from_tree(tomllib.loads(REST + limits), tmp_path / "scene.toml").mqtt.broker is None
    (udp,) = blocks("udp.md", "toml")
    scene = from_tree(tomllib.loads(REST + mqtt + queue + udp), tmp_path / "scene.toml")
    assert len(scene.udp) == 3
    assert scene.mqtt.queue.policy == "drop-oldest"
    assert [scene.mqtt.queue.limit(qos) for qos in (0, 1)] == [2000, 2000]
    assert [MqttQueueKeys().limit(qos) for qos in (0, 1)] == [0, 10_000]
    (tmp_path / "credentials.toml").write_text(credentials)
    assert scene.mqtt.broker is not None
    address = broker_address(scene, scene.mqtt.broker)
    assert str(address) == "mqtts://broker.example:8883"
    assert address.access.username == "plotfeed"
    assert address.access.ca_file == tmp_path / "ca.pem"
    assert address.versions == VERSIONS["any"]


def test_the_settings_for_mosquitto_are_settings_of_mosquitto(tmp_path: Path) -> None:
    (text,) = (block for block in blocks("mqtt.md") if "listener 8883" in block)
    secured, browsers = free_port(), free_port()
    keys = Certificates(tmp_path)
    for written, here in {
        "listener 8883": f"listener {secured} 127.0.0.1",
        "listener 9001": f"listener {browsers} 127.0.0.1",
        "/etc/mosquitto/passwords": password_file(tmp_path, "plotfeed", "x"),
        "/etc/mosquitto/broker.pem": keys.broker.certificate,
        "/etc/mosquitto/broker.key": keys.broker.key,
        "/etc/mosquitto/ca.pem": keys.ca,
    }.items():
        assert written in text
        text = text.replace(written, str(here))
    with mosquitto(tmp_path, secured, text, per_listener=False):
        wait_until_listening(browsers)
    assert str(BrokerAddress.parse("mqtts://broker.example")).endswith(":8883")
