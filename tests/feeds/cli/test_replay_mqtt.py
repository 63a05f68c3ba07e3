"""Replays over MQTT: from the command line, as a client that owes us nothing hears them."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import select
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import pytest
from support.brokers import free_port, mosquitto, rumqttd
from support.command import PLOTFEED, plotfeed, running
from support.mqtt_client import Heard, listening
from support.recordings import plots
from support.replays import MS, RECORDED, Memory, S, message
from support.scene_files import scene_file, scene_text
from support.udp_receiver import heard, place, receiver
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.cli.replay import press
from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.replaying import destinations
from plotfeed.feeds.replaying.control import ReplayControl
from plotfeed.feeds.replaying.destinations import ReplayMqtt
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.replaying.replayer import AT_ONCE, replay
from plotfeed.feeds.telemetry.decode_reports import decode, encode_protobuf
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.mcap.mcap_writer import McapWriter
from plotfeed.replay.pcap.libpcap import PcapWriter
from plotfeed.replay.recorded import Recorded, Stage

TYPE = "application/x-protobuf; messageType=plotfeed.v1.PlotBatch"
SESSION = [
    message(0, "plotfeed/radar/status", b"{}", content_type="application/json", retain=True, qos=1),
    *(
        message(i * MS, "plotfeed/radar/plots", bytes([i]) * 30, content_type=TYPE, qos=i % 2,
                properties=(("time", iso_utc(RECORDED)), ("n", str(i))))
        for i in range(1, 40)
    ),
    message(41 * MS, "plotfeed/truth", b"secret"),
    message(42 * MS, "plotfeed/radar/plots", b"last", content_type=TYPE),
]  # fmt: skip


def log_file(folder: Path, recorded: Sequence[Recorded]) -> Path:
    path = folder / "session.mcap"
    with path.open("wb", buffering=0) as file:
        writer = McapWriter(file)
        for each in recorded:
            writer.write(each)
        writer.close()
    return path


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    port = free_port()
    with rumqttd(tmp_path, {"v5.1": ("127.0.0.1", port, "")}):
        yield port


@pytest.fixture(params=["mosquitto", "iotcore"])
def any_broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[int]:
    if request.param == "iotcore":
        yield request.getfixturevalue("broker")
        return
    port = free_port()
    with mosquitto(tmp_path, port):
        yield port


def is_last(message: Heard) -> bool:
    return message.payload == b"last"


@pytest.mark.parametrize("how", [["--speed", "2"], ["--fastest"]], ids=["paced", "fastest"])
def test_the_same_messages_come_on_the_same_topics(
    tmp_path: Path, any_broker: int, how: list[str]
) -> None:
    path = log_file(tmp_path, SESSION)
    with listening(any_broker, 5, "#") as ears:
        url = f"mqtt://127.0.0.1:{any_broker}"
        done = plotfeed("replay", path, "--broker", url, "--json", *how)
        assert done.returncode == 0, done.stderr
        ears.wait_for(is_last)
        got = [m for m in ears.heard if m.topic.endswith("plots")]
    sent = [m for m in SESSION if m.topic.endswith("plots")]
    assert "plotfeed/truth" not in {m.topic for m in ears.heard}
    assert "plotfeed/radar/status" in {m.topic for m in ears.heard}
    for qos in (0, 1):  # what is acknowledged may come after what is not
        wanted = [m.payload for m in sent if m.qos == qos]
        assert [m.payload for m in got if m.payload in wanted] == wanted
    by_payload = {m.payload: m for m in got}
    for recorded in sent:
        found = by_payload[recorded.payload]
        assert found.content_type == TYPE
        assert found.user_properties == dict(recorded.properties)
    with listening(any_broker, 5, "#") as later:
        assert later.wait_for(lambda m: m.retained).topic == "plotfeed/radar/status"
    summary = json.loads(done.stdout)
    assert summary["messages"] == 41
    assert summary["undelivered"] == 0
    assert summary["laps"] == 1


def test_topics_links_and_times_are_as_asked(tmp_path: Path, broker: int) -> None:
    path = log_file(tmp_path, SESSION)
    (tmp_path / "link.toml").write_text("latency_ms = 20\nduplicate = 1.0\n")
    with listening(broker, 5, "#") as ears:
        url = f"mqtt://127.0.0.1:{broker}"
        options = ["--broker", url, "--topic", "plotfeed=again", "--stamps", "now", "--json"]
        done = plotfeed("replay", path, *options, "--link", tmp_path / "link.toml")
        assert done.returncode == 0, done.stderr
        ears.wait_for(is_last)
        wait_until(lambda: len(ears.on("again/radar/plots")) >= 80)
    summary = json.loads(done.stdout)
    assert summary["duplicated"] == 40
    assert summary["messages"] == 81  # and the status, which goes over no link
    assert len(ears.on("again/radar/plots")) == 80
    times = {m.user_properties.get("time") for m in ears.heard if m.user_properties}
    assert all(t is not None and t > "2026-01-01T12:00:01" for t in times)
    assert "times left alone" in done.stderr or summary["times_left_alone"]


def test_telemetry_is_told_as_of_now(tmp_path: Path, broker: int) -> None:
    def sample(i: int) -> Recorded:
        report = PositionReport(
            t_utc_ns=RECORDED + i * 10 * MS,
            latitude_deg=40.0,
            longitude_deg=-3.0,
            altitude_m=700.0 + i,
            altitude_reference=AltitudeReference.ELLIPSOID,
        )
        topic, payload = "plotfeed/telemetry/d1", encode_protobuf(report)
        return message(i * 10 * MS, topic, payload, stage=Stage.TELEMETRY)

    path = log_file(tmp_path, [sample(i) for i in range(5)])
    with listening(broker, 5, "#") as ears:
        begun_ns = time.time_ns()
        url = f"mqtt://127.0.0.1:{broker}"
        done = plotfeed("replay", path, "--broker", url, "--stage", "telemetry")
        assert done.returncode == 0, done.stderr
        ears.wait_for(lambda m: decode(m.payload).altitude_m == 704)
    reports = [decode(m.payload) for m in ears.heard]
    assert all(begun_ns <= r.t_utc_ns <= time.time_ns() for r in reports)
    assert [r.t_utc_ns - reports[0].t_utc_ns for r in reports] == [i * 10 * MS for i in range(5)]


def test_a_capture_goes_to_udp_and_to_a_broker_at_once(tmp_path: Path, broker: int) -> None:
    recorded = [message(i * MS, "udp/10.0.0.1/8600", r.payload) for i, r in enumerate(plots(20))]
    path = tmp_path / "feed.pcap"
    with path.open("wb") as file:
        writer = PcapWriter(file)
        assert [writer.write(each) for each in recorded] == [None] * 20
        writer.close()
    with receiver() as udp_ears, listening(broker, 5, "radar") as ears:
        destinations = ["--udp", place(udp_ears), "--broker", f"mqtt://127.0.0.1:{broker}"]
        rule = ["--topic", "udp/10.0.0.1/8600=radar"]
        done = plotfeed("replay", path, *destinations, *rule, "--fastest")
        assert done.returncode == 0, done.stderr
        last = recorded[-1].payload
        ears.wait_for(lambda m: m.payload == last)
        assert heard(udp_ears) == [r.payload for r in recorded]
        assert ears.on("radar") == [r.payload for r in recorded]


def test_a_replay_without_end_ends_when_it_is_interrupted(tmp_path: Path, broker: int) -> None:
    path = log_file(tmp_path, SESSION)
    url = f"mqtt://127.0.0.1:{broker}"
    command = [*PLOTFEED, "replay", str(path), "--broker", url, "--json", "--loop"]
    with listening(broker, 5, "plotfeed/radar/plots") as ears:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            ears.wait_for(is_last)
            ears.wait_for(is_last, since=len(ears.heard))
        finally:
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert json.loads(out)["laps"] >= 2


def test_keys_steer_it_in_a_terminal(tmp_path: Path, broker: int) -> None:
    recorded = [message(i * S, "plotfeed/radar/plots", bytes([i])) for i in range(200)]
    path = log_file(tmp_path, recorded)
    url = f"mqtt://127.0.0.1:{broker}"
    ours, theirs = pty.openpty()
    with listening(broker, 5, "plotfeed/radar/plots") as ears:
        process = subprocess.Popen(
            [*PLOTFEED, "replay", str(path), "--broker", url],
            stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
            preexec_fn=lambda: _make_controlling(theirs),  # noqa: PLW1509
        )  # fmt: skip
        os.close(theirs)
        try:
            ears.wait_for(lambda m: m.payload == bytes([0]))
            os.write(ours, b"\x1b[C" * 5)  # 50 s on
            ears.wait_for(lambda m: m.payload[0] >= 50)
            os.write(ours, b"q")
            shown = _all_of(ours, process)
        finally:
            process.kill()
            process.wait(PATIENCE_S)
            os.close(ours)
    assert process.returncode == 0
    assert "space pauses" in shown
    assert "messages" in shown


def _make_controlling(terminal: int) -> None:
    import fcntl
    import termios

    fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)


def _all_of(terminal: int, process: subprocess.Popen[bytes]) -> str:
    """What is shown until the process ends."""
    shown, deadline = b"", time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if select.select([terminal], [], [], 0.05)[0]:
            try:
                more = os.read(terminal, 4096)
            except OSError:  # nobody has the other end any more
                break
            shown += more
        elif process.poll() is not None:
            break
    process.wait(PATIENCE_S)
    return shown.decode()


def test_other_keys_do_nothing() -> None:
    asked: list[str] = []

    class Noting(ReplayControl):
        def toggle(self) -> None:
            asked.append("toggle")

        def skip(self, seconds: float) -> None:
            asked.append(f"skip {seconds:g}")

        def stop(self) -> None:
            asked.append("stop")

    press(Noting(), b"x\x1b[A\x1b[D y\x1b[C\xff+-=q\x1b")
    assert asked == ["skip -10", "toggle", "skip 10", "stop"]


MISTAKES = {
    ("--udp", "localhost:1"): "--udp: expected ADDRESS:PORT such as",
    ("--topic", "a"): "topic: expected OLD=NEW",
    ("--stamps", "later"): "stamps: expected keep, now, or seconds",
    ("--start", "noon"): "expected seconds from the beginning",
    ("--link", "no-such-file.toml"): "no-such-file.toml: No such file",
    ("--latency-ms", "1e12"): "link: latency_ms: input should be less than or equal to",
    ("--broker", "http://x"): "mqtt://",
    ("--loss", "2"): "2.0 is not in the range",
    ("--speed", "0"): "0.0 is not in the range",
}


def refused(*arguments: object) -> str:
    """What the command says of arguments that are none; without a process, which takes long."""
    with pytest.raises((PlotfeedError, click.ClickException)) as caught:
        cli.main(["replay", *map(str, arguments)], standalone_mode=False)
    return (
        caught.value.message
        if isinstance(caught.value, click.ClickException)
        else str(caught.value)
    )


@pytest.mark.parametrize("options", MISTAKES, ids="=".join)
def test_a_mistake_is_one_line_that_names_it(tmp_path: Path, options: tuple[str, str]) -> None:
    said = refused(log_file(tmp_path, SESSION), *options)
    assert MISTAKES[options] in said
    assert len(said.splitlines()) == 1


def test_a_link_file_is_checked_key_by_key(tmp_path: Path) -> None:
    link = tmp_path / "link.toml"
    for text, wanted in {
        "latency_ms = -1": "link.toml: latency_ms: input should be greater than or equal to 0",
        "latncy_ms = 1": "link.toml: latncy_ms: no such key; did you mean latency_ms?",
        "latency_ms =": "link.toml: not TOML",
    }.items():
        link.write_text(text)
        assert wanted in refused(log_file(tmp_path, SESSION), "--link", f"plotfeed={link}")


def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path) -> None:
    odd = tmp_path / "odd"
    odd.write_bytes(b"hello")
    assert f"{odd}: " in refused(odd, "--udp", "127.0.0.1:9")


@pytest.mark.asyncio
async def test_a_broker_that_never_has_room_can_be_left() -> None:
    class Full(ReplayMqtt):
        def __init__(self) -> None:
            self.taken = 0

        @property
        def is_full(self) -> bool:
            return True

        async def room(self) -> None:
            await asyncio.Event().wait()

        def publish(self, *deliveries: Delivery) -> None:
            self.taken += len(deliveries)
            for delivery in deliveries:
                delivery.settle(delivered=True)

        async def drain(self, timeout_s: float = 1.0) -> None:
            assert timeout_s <= 1

    async with asyncio.timeout(PATIENCE_S):
        full, control = Full(), ReplayControl()
        asyncio.get_running_loop().call_later(0.05, control.stop)
        endless = ReplaySettings(fastest=True, laps=None)
        await replay(Memory(SESSION), [full], endless, control=control)
    assert 0 < full.taken <= AT_ONCE


def test_telemetry_flies_again_in_an_emulator(tmp_path: Path) -> None:
    def sample(i: int) -> Recorded:
        report = PositionReport(
            t_utc_ns=RECORDED + i * 100 * MS,
            latitude_deg=40.46,
            longitude_deg=-3.73,
            altitude_m=800.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
        )
        topic, payload = "plotfeed/telemetry/ghost", encode_protobuf(report)
        return message(i * 100 * MS, topic, payload, stage=Stage.TELEMETRY)

    path = log_file(tmp_path, [sample(i) for i in range(20)])
    scene = scene_file(tmp_path, scene_text(drones=""))
    with running("run", scene, "--duration", "60") as session:
        port = session.port("MQTT 5")
        with listening(port, 5, "plotfeed/truth", "plotfeed/errors") as ears:
            url = f"mqtt://127.0.0.1:{port}"
            done = plotfeed("replay", path, "--broker", url, "--stage", "telemetry")
            assert done.returncode == 0, done.stderr
            ears.wait_for(lambda m: b"ghost" in m.payload)
            assert ears.on("plotfeed/errors") == []


def test_no_broker_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(destinations, "CONNECT_S", 0.5)
    path = log_file(tmp_path, SESSION)
    assert "MQTT broker" in refused(path, "--broker", f"mqtt://127.0.0.1:{free_port()}")


def test_what_is_whole_of_a_damaged_file_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "feed.jsonl"
    from plotfeed.replay.json_lines import JsonLinesWriter

    with path.open("wb") as file:
        writer = JsonLinesWriter(file)
        for each in plots(3):
            writer.write(each)
        writer.close()
        file.write(b"{broken\n")
    with receiver() as ears:
        done = plotfeed("replay", path, "--udp", place(ears), "--fastest")
        assert heard(ears) == [r.payload for r in plots(3)]
    assert done.returncode == 0
    assert f"{path}: octet" in done.stderr


def test_nothing_can_be_asked_of_a_replay_that_is_not_there() -> None:
    control = ReplayControl()
    for ask in (control.pause, control.resume, control.toggle, lambda: control.seek(5),
                lambda: control.skip(1), lambda: control.set_speed(control.speed)):  # fmt: skip
        ask()
    assert control.position == (0, 0)
    assert not control.is_paused
