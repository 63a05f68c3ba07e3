"""Replays over MQTT: from the command line, as a client that owes us nothing hears them."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto, own_broker
from support.command import plotfeed, running, started
from support.recordings import plots
from support.replays import MS, RECORDED, SESSION, TYPE, log_file, message
from support.scene_files import scene_file, scene_text
from support.udp_receiver import heard, place, receiver
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference
from plotfeed.replay.pcap import PcapWriter
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import MqttMessage, MqttReceiver


def is_last(message: MqttMessage) -> bool:
    return message.payload == b"last"


@pytest.mark.parametrize(
    ("start", "speed"), [(mosquitto, "2"), (own_broker, "max")], ids=["paced", "fastest"]
)
def test_the_same_messages_come_on_the_same_topics(tmp_path: Path, start: Any, speed: str) -> None:
    path, port = log_file(tmp_path, SESSION), free_port()
    url = f"mqtt://127.0.0.1:{port}"
    with start(tmp_path, port):
        with MqttReceiver(port, 5, "#") as ears:
            done = plotfeed("replay", path, "--broker", url, "--json", "--speed", speed)
            assert done.returncode == 0, done.stderr
            ears.wait_for(is_last)
        with MqttReceiver(port, 5, "#") as later:
            assert later.wait_for(lambda m: m.retained).topic == "plotfeed/radar/status"
    assert {m.topic for m in ears.heard} == {"plotfeed/radar/plots", "plotfeed/radar/status"}
    got = {m.payload: m for m in ears.heard if m.topic.endswith("plots")}
    sent = [m for m in SESSION if m.topic.endswith("plots")]
    for qos in (0, 1):  # what is acknowledged may come after what is not
        wanted = [m.payload for m in sent if m.qos == qos]
        assert [payload for payload in got if payload in wanted] == wanted
    for recorded in sent:
        found = got[recorded.payload]
        assert found.content_type == TYPE
        assert found.user_properties == dict(recorded.properties)
    summary = json.loads(done.stdout)
    assert (summary["messages"], summary["undelivered"], summary["laps"]) == (41, 0, 1)


def test_topics_links_and_times_are_as_asked(tmp_path: Path, broker: int) -> None:
    path = log_file(tmp_path, SESSION)
    (tmp_path / "link.toml").write_text("latency_ms = 20\nduplicate = 1.0\n")
    with MqttReceiver(broker, 5, "#") as ears:
        url = f"mqtt://127.0.0.1:{broker}"
        options = ["--broker", url, "--topic", "plotfeed=again", "--stamps", "now", "--json"]
        done = plotfeed("replay", path, *options, "--link", tmp_path / "link.toml")
        assert done.returncode == 0, done.stderr
        wait_until(lambda: len(ears.on("again/radar/plots")) >= 80)
    summary = json.loads(done.stdout)
    # And the status, which goes over no link.
    assert (summary["duplicated"], summary["messages"]) == (40, 81)
    assert len(ears.on("again/radar/plots")) == 80
    times = {m.user_properties.get("time") for m in ears.heard if m.user_properties}
    assert all(t is not None and t > "2026-01-01T12:00:01" for t in times)
    assert "times left alone" in done.stderr or summary["times_left_alone"]


def test_a_capture_goes_to_udp_and_to_a_broker_at_once(tmp_path: Path, broker: int) -> None:
    recorded = [message(i * MS, "udp/10.0.0.1/8600", r.payload) for i, r in enumerate(plots(20))]
    path = tmp_path / "feed.pcap"
    with path.open("wb") as file:
        writer = PcapWriter(file)
        assert [writer.write(each) for each in recorded] == [None] * 20
        writer.close()
    with receiver() as udp_ears, MqttReceiver(broker, 5, "radar") as ears:
        destinations = ["--udp", place(udp_ears), "--broker", f"mqtt://127.0.0.1:{broker}"]
        rule = ["--topic", "udp/10.0.0.1/8600=radar"]
        done = plotfeed("replay", path, *destinations, *rule, "--speed", "max")
        assert done.returncode == 0, done.stderr
        last = recorded[-1].payload
        ears.wait_for(lambda m: m.payload == last)
        assert heard(udp_ears) == [r.payload for r in recorded]
        assert ears.on("radar") == [r.payload for r in recorded]


def test_a_replay_without_end_ends_when_it_is_interrupted(tmp_path: Path, broker: int) -> None:
    path = log_file(tmp_path, SESSION)
    url = f"mqtt://127.0.0.1:{broker}"
    with (
        MqttReceiver(broker, 5, "plotfeed/radar/plots") as ears,
        started("replay", path, "--broker", url, "--json", "--loop") as process,
    ):
        ears.wait_for(is_last)
        ears.wait_for(is_last, since=len(ears.heard))
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(PATIENCE_S)
    assert process.returncode == 130
    assert json.loads(out)["laps"] >= 2


def test_telemetry_flies_again_in_an_emulator(tmp_path: Path) -> None:
    def sample(i: int) -> Recorded:
        report = PositionReport(
            t_utc_ns=RECORDED + i * 100 * MS,
            latitude_deg=40.46,
            longitude_deg=-3.73,
            altitude_m=800.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
        )
        topic, payload = "plotfeed/telemetry/ghost", report.to_protobuf()
        return message(i * 100 * MS, topic, payload, stage=Stage.TELEMETRY)

    path = log_file(tmp_path, [sample(i) for i in range(20)])
    scene = scene_file(tmp_path, scene_text(drones=""))
    with running("run", scene, "--duration", "60") as session:
        port = session.port("MQTT")
        with MqttReceiver(port, 5, "plotfeed/truth", "plotfeed/errors") as ears:
            url = f"mqtt://127.0.0.1:{port}"
            done = plotfeed("replay", path, "--broker", url, "--stage", "telemetry")
            assert done.returncode == 0, done.stderr
            ears.wait_for(lambda m: b"ghost" in m.payload)
            assert ears.on("plotfeed/errors") == []
