"""Keys that steer a replay in a terminal, and what the command says of mistakes."""

from __future__ import annotations

import asyncio
import fcntl
import os
import pty
import select
import subprocess
import termios
import time
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from unittest.mock import Mock, call

import click
import pytest
from support.brokers import free_port
from support.command import PLOTFEED, plotfeed, plotfeed_here
from support.recordings import plots, written
from support.replays import SESSION, Memory, S, log_file, message
from support.udp_receiver import heard, place, receiver
from support.waiting import PATIENCE_S

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.cli.options import udp_destination
from plotfeed.feeds.cli.replay import press
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.replaying import routes
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.replaying.replayer import AT_ONCE, Replayer
from plotfeed.feeds.replaying.routes import ReplayMqtt
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.files import JsonLinesWriter
from plotfeed.testing import MqttReceiver


def test_keys_steer_it_in_a_terminal(tmp_path: Path, broker: int) -> None:
    recorded = [message(i * S, "plotfeed/radar/plots", bytes([i])) for i in range(200)]
    path = log_file(tmp_path, recorded)
    url = f"mqtt://127.0.0.1:{broker}"
    ours, theirs = pty.openpty()
    with MqttReceiver(broker, 5, "plotfeed/radar/plots") as ears:
        process = subprocess.Popen(
            [*PLOTFEED, "replay", str(path), "--broker", url],
            stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(theirs, termios.TIOCSCTTY, 0),  # noqa: PLW1509
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


def test_a_replay_that_sends_nothing_fails_and_says_so(tmp_path: Path) -> None:
    path = log_file(tmp_path, [message(0, "plotfeed/radar/status", b"{}")])
    to = ("--udp", f"127.0.0.1:{free_port()}")
    for chosen in (("--stage", "telemetry"), ("--start", "3600"), ()):
        done = plotfeed_here("replay", path, *to, *chosen, "--speed", "max")
        assert done.returncode == 1
        told = f"plotfeed: nothing of {path} was sent: no message is of what was asked for\n"
        assert done.stderr.endswith(told)


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


def test_keys_do_what_is_told_of_them_and_others_nothing() -> None:
    asked = Mock(Replayer, speed=Fraction(3))
    press(asked, b"x\x1b[A\x1b[D y\x1b[C\xff+-=q\x1b")
    speeds = [call.set_speed(speed) for speed in (6, Fraction(3, 2), 6)]
    told = [call.skip(-10), call.toggle(), call.skip(10), *speeds, call.stop()]
    assert asked.mock_calls == told


def test_keys_of_a_destination_stand_behind_its_address() -> None:
    found = udp_destination("239.1.2.3:8600?ttl=4&interface=127.0.0.1")
    assert (found.destination, found.ttl, found.interface) == ("239.1.2.3:8600", 4, "127.0.0.1")
    assert udp_destination("127.0.0.1:1") == UdpDestination(destination="127.0.0.1:1")


MISTAKES = {
    ("--udp", "localhost:1"): "--udp: expected ADDRESS:PORT such as",
    ("--udp", "239.1.2.3:1?ttl=300"): "--udp: ttl: ",
    ("--udp", "239.1.2.3:1?ttl"): "--udp ttl: expected KEY=VALUE",
    ("--udp", "recorded?colour=red"): "--udp: colour: no such key",
    ("--udp", "127.0.0.1:1?interface=lo"): "--udp: interface: only for multicast",
    ("--topic", "a"): "topic: expected OLD=NEW",
    ("--stamps", "later"): "stamps: expected keep, now, or seconds",
    ("--start", "noon"): "expected seconds from the beginning",
    ("--link", "no-such-file.toml"): "no-such-file.toml: No such file",
    ("--broker", "http://x"): "mqtt://",
    ("--speed", "0"): "--speed: expected 0.001 to 10000, or max",
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


def test_a_mistake_is_one_line_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, link, odd = log_file(tmp_path, SESSION), tmp_path / "link.toml", tmp_path / "odd"
    for options, says in MISTAKES.items():
        said = refused(path, *options)
        assert says in said
        assert len(said.splitlines()) == 1
    for text, wanted in {
        "latency_ms = -1": "link.toml: latency_ms: input should be greater than or equal to 0",
        "latncy_ms = 1": "link.toml: latncy_ms: no such key; did you mean latency_ms?",
        "latency_ms =": "link.toml: not TOML",
    }.items():
        link.write_text(text)
        assert wanted in refused(path, "--link", f"plotfeed={link}")
    odd.write_bytes(b"hello")
    assert f"{odd}: " in refused(odd, "--udp", "127.0.0.1:9")
    monkeypatch.setattr(routes, "CONNECT_S", 0.5)
    assert "MQTT broker" in refused(path, "--broker", f"mqtt://127.0.0.1:{free_port()}")


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

        def publish(self, outgoing: Sequence[Message]) -> None:
            self.taken += len(outgoing)
            for delivery in outgoing:
                delivery.settle(delivered=True)

        async def drain(self, timeout_s: float = 1.0) -> None:
            assert timeout_s <= 1

    async with asyncio.timeout(PATIENCE_S):
        full, replayer = Full(), Replayer(ReplaySettings(fastest=True, laps=None))
        asyncio.get_running_loop().call_later(0.05, replayer.stop)
        await replayer.run(Memory(SESSION), [full])
    assert 0 < full.taken <= AT_ONCE


def test_what_is_whole_of_a_damaged_file_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "feed.jsonl"
    path.write_bytes(written(JsonLinesWriter, plots(3)) + b"{broken\n")
    with receiver() as ears:
        done = plotfeed("replay", path, "--udp", place(ears), "--speed", "max")
        assert heard(ears) == [r.payload for r in plots(3)]
    assert done.returncode == 0
    assert f"{path}: octet" in done.stderr


def test_nothing_can_be_asked_of_a_replay_that_is_not_there() -> None:
    control = Replayer()
    for ask in (control.pause, control.resume, control.toggle):
        ask()
    control.seek(5)
    control.skip(1)
    control.set_speed(control.speed)
    assert control.position == (0, 0)
    assert not control.is_paused
