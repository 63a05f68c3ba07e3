"""Whole commands through a broker that asks for TLS, certificates and passwords."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto, password_file
from support.certificates import Certificates
from support.command import Started, plotfeed, plotfeed_here, running
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttReceiver

FAST = radar(period_s=0.2, sectors=8)
ABOUT = {"status", "settings", "description"}
ME, PASSWORD, WRONG = "surveyor", "open sesame", "open barley"


@dataclass(frozen=True)
class Broker:
    """Mosquitto: by TLS for who has a certificate and a password, and openly for the test."""

    secured: int
    open: int
    certificates: Certificates
    credentials: Path

    @property
    def url(self) -> str:
        return f"mqtts://127.0.0.1:{self.secured}"

    def keys(self, **changes: object) -> list[str]:
        """The option of `show` and `inject`, whose file holds all but what is None."""
        ours = self.certificates
        keys = {
            "username": ME,
            "password": PASSWORD,
            "ca_file": ours.ca,
            "client_certificate_file": ours.client.certificate,
            "client_key_file": ours.client.key,
            **changes,
        }
        text = "".join(f'{key} = "{value}"\n' for key, value in keys.items() if value)
        file = self.credentials.with_name(f"{len(list(self.credentials.parent.iterdir()))}.toml")
        file.write_text(text)
        return ["--credentials", str(file)]


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    folder = tmp_path_factory.mktemp("broker")
    certificates = Certificates(folder)
    credentials = folder / "credentials.toml"
    credentials.write_text(f'username = "{ME}"\npassword = "{PASSWORD}"\n')
    made = Broker(free_port(), free_port(), certificates, credentials)
    settings = (
        f"listener {made.secured} 127.0.0.1\nallow_anonymous false\n"
        f"password_file {password_file(folder, ME, PASSWORD)}\n"
        f"cafile {certificates.ca}\nrequire_certificate true\n"
        f"certfile {certificates.broker.certificate}\nkeyfile {certificates.broker.key}\n"
        f"listener {made.open} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
    )
    with mosquitto(folder, made.open, settings):
        yield made


def scene_with_keys(folder: Path, broker: Broker, name: str, more: str = "") -> Path:
    """A scene that names its files relative to itself, as they lie beside it."""

    def beside(path: Path) -> str:
        return os.path.relpath(path, folder)

    ours = broker.certificates
    mqtt = f"""
broker = "{broker.url}"
prefix = "{name}"
ca_file = "{beside(ours.ca)}"
client_certificate_file = "{beside(ours.client.certificate)}"
client_key_file = "{beside(ours.client.key)}"
credentials_file = "{beside(broker.credentials)}"
{more}
"""
    return scene_file(folder, scene_text(sensors=FAST, mqtt=mqtt))


@pytest.mark.parametrize(("version", "properties"), [("5", True), ("3.1.1", False)])
def test_a_session_publishes_through_tls(
    broker: Broker, tmp_path: Path, version: str, properties: bool
) -> None:
    prefix = f"a/session/of/{version}"
    scene = scene_with_keys(tmp_path, broker, prefix, f'version = "{version}"')
    with MqttReceiver(broker.open, 5, f"{prefix}/#") as ears, running("run", scene) as session:
        batch = ears.wait_for(lambda m: m.topic == f"{prefix}/radar/plots")
        status = ears.wait_for(lambda m: m.topic == f"{prefix}/radar/status")
        assert f"  MQTT        {broker.url}" in session.introduction
        shown = plotfeed("show", f"{broker.url}/{prefix}/#", "--count", "3", *broker.keys())
        assert len(shown.stdout.splitlines()) == 3
        assert shown.stderr == ""
        session.process.kill()  # its last will says it, then
        ears.wait_for(lambda m: m.topic == status.topic and b"OFFLINE" in m.payload)
        truth = ears.wait_for(lambda m: m.topic == f"{prefix}/truth")
    assert (batch.qos, truth.qos, status.qos) == (0, 0, 1)
    assert pb.PlotBatch.FromString(batch.payload).sensor == "radar"
    assert json.loads(status.payload)["state"] == "ONLINE"
    assert bool(batch.user_properties) == properties == (batch.content_type is not None)


def test_qos_1_brings_every_message_however_fast_they_come(broker: Broker, tmp_path: Path) -> None:
    # Mosquitto takes 20 unacknowledged messages at a time; simulated time waits for nobody.
    scene = scene_with_keys(tmp_path, broker, "surely", "qos = 1")
    options = ("--speed", "max", "--duration", "12", "--json")
    with MqttReceiver(broker.open, 5, "surely/radar/+", "surely/radar/asterix/+") as ears:
        done = plotfeed("run", scene, *options)
        totals = json.loads(done.stdout)
        ears.wait_for(lambda m: b"OFFLINE" in m.payload)
        reports = [m for m in ears.heard if m.topic.rpartition("/")[2] not in ABOUT]
    assert (done.returncode, done.stderr) == (0, "")
    assert totals["undelivered"] == 0
    assert totals["messages"] == len(reports) > 800
    assert {m.qos for m in ears.heard} == {1}


def test_every_failure_is_one_line_that_names_the_broker_and_no_secret(
    broker: Broker, tmp_path: Path
) -> None:
    ours = broker.certificates
    flight = tmp_path / "flight.csv"
    flight.write_text("time,latitude_deg,longitude_deg,altitude_m\n1767268800,40,-3,9\n")
    inject = ("inject", flight, "--now", "--set", "altitude_reference=ellipsoid", "--broker")
    cases: list[tuple[list[str], str]] = [
        (broker.keys(password=WRONG), "not authori"),  # as 5 spells it, or 3.1.1
        (broker.keys(ca_file=ours.other_ca), "certificate is not good"),
        (broker.keys(ca_file=None), "certificate is not good"),
        (broker.keys(client_certificate_file=None, client_key_file=None), ""),
    ]
    by_turns = cycle((("show", broker.url), (*inject, broker.url)))
    begun = [(text, Started(*next(by_turns), *keys)) for keys, text in cases]
    scene = scene_with_keys(tmp_path, broker, "refused")
    scene.write_text(scene.read_text().replace("credentials.toml", "absent.toml"))
    done = plotfeed_here("run", scene)
    assert done.returncode == 2
    assert done.stderr.endswith("absent.toml: No such file or directory\n")
    scene = scene_with_keys(tmp_path, broker, "refused")
    scene.write_text(scene.read_text().replace("mqtts", "mqtt"))
    assert "need mqtts://" in plotfeed_here("run", scene).stderr
    for text, process in begun:
        _, err = process.communicate(PATIENCE_S)
        assert process.wait() == 1
        assert len(err.splitlines()) == 1
        assert err.startswith(f"plotfeed: MQTT broker {broker.url}: ")
        assert text in err
        assert WRONG not in err
        assert PASSWORD not in err
