"""The end of a session in a process of its own, by signals, whatever its broker does then."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from urllib.request import urlopen

import pytest
from support import command
from support.brokers import deaf_server, free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import MqttReceiver

SLOW = radar("slow", period_s=0.5, sectors=8, more="[sensor.link]\nlatency_ms = 600_000.0\n")
QUICK = radar("quick", period_s=0.5, sectors=8)
SIGNALS = (signal.SIGTERM, signal.SIGINT)
BROKERS = ("living", "stopped", "gone")


@dataclass(frozen=True)
class Ended:
    """What is known of a session afterwards."""

    code: int
    out: str
    err: str
    took_s: float  # Two are promised; on a machine that others use, `Running.end` has more patience
    record: list[Recorded]
    retained: dict[str, str]  # Last states that the broker knows, where it lives

    def of(self, stage: Stage) -> list[Recorded]:
        return [message for message in self.record if message.stage is stage]

    def ledger(self) -> list[pb.Sent]:
        payloads = [m.payload for m in self.of(Stage.AFTER) if m.topic.endswith("/truth")]
        return [sent for p in payloads for entry in entries_in(p) for sent in entry.messages]


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[signal.Signals, str], Ended]:
    """All cases at once: what takes time is to wait."""
    found: dict[tuple[signal.Signals, str], Ended] = {}
    threads = [
        threading.Thread(target=end_two, args=(broker, tmp_path_factory.mktemp(broker), found))
        for broker in BROKERS
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found.keys() == {*product(SIGNALS, BROKERS)}
    return found


def end_two(broker: str, folder: Path, found: dict[tuple[signal.Signals, str], Ended]) -> None:
    """A session for each signal, over one broker."""
    port = free_port()
    with ExitStack() as stack:
        process = stack.enter_context(own_broker(folder, port))
        sessions, metrics = {}, {}
        for how in SIGNALS:
            sensors, prefix = SLOW + QUICK, f'prefix = "{how.name}"\nqos = 1'
            scene = folder / f"{how.name}.toml"
            scene.write_text(scene_text(sensors=sensors, mqtt=prefix))
            metrics[how] = free_port()
            options = ("--record", scene.with_suffix(".mcap"), "--metrics", metrics[how])
            sessions[how] = stack.enter_context(
                command.running("run", scene, *options, "--broker", f"mqtt://127.0.0.1:{port}")
            )
        for how in SIGNALS:
            wait_for_work(port, how.name)
        harm(process, broker, stack)
        for how in SIGNALS:
            wait_for_scans(metrics[how], 2)
        for how, session in sessions.items():
            begun_s = time.monotonic()
            code, out, err = session.end(how)
            took_s = time.monotonic() - begun_s
            retained = dict(states(port, how.name)) if broker == "living" else {}
            with McapReader(folder / f"{how.name}.mcap") as log:
                record = list(log.messages())
            found[how, broker] = Ended(code, out, err, took_s, record, retained)


def wait_for_work(port: int, prefix: str) -> None:
    with MqttReceiver(port, 5, f"{prefix}/quick/plots") as ears:
        for _ in range(3):
            ears.wait_for(lambda _: True, len(ears.heard))


def wait_for_scans(metrics: int, more: int) -> None:
    """A session works on, whether or not anybody hears of it."""
    wanted = scan_of_quick(metrics) + more
    wait_until(lambda: scan_of_quick(metrics) >= wanted)


def scan_of_quick(metrics: int) -> float:
    with urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=PATIENCE_S) as answer:
        text = answer.read().decode()
    (scan,) = re.findall(r'^plotfeed_sensor_scan\{sensor="quick"\} (\S+)$', text, re.MULTILINE)
    return float(scan)


def harm(process: subprocess.Popen[bytes], broker: str, stack: ExitStack) -> None:
    if broker == "stopped":
        process.send_signal(signal.SIGSTOP)
        stack.callback(process.send_signal, signal.SIGCONT)
    elif broker == "gone":
        process.kill()
        process.wait()


def states(port: int, prefix: str) -> Iterator[tuple[str, str]]:
    with MqttReceiver(port, 5, f"{prefix}/+/status") as ears:
        for sensor in ("slow", "quick"):
            topic = f"{prefix}/{sensor}/status"
            status = ears.wait_for(lambda m, topic=topic: m.topic == topic)  # type: ignore[misc]
            yield sensor, json.loads(status.payload)["state"]


@pytest.mark.asyncio
async def test_a_session_that_is_told_to_stop_does_not_wait_for_its_broker(tmp_path: Path) -> None:
    """Nor does it complain of one that never answered."""
    scene = load(scene_file(tmp_path, scene_text(sensors=QUICK)))

    async def stopped(port: int) -> SessionCounters:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(0.1, stop.set)
        return await run(scene, broker=f"mqtt://127.0.0.1:{port}", stop=stop)

    with deaf_server() as port:
        assert (await stopped(port)).plots == 0


every_case = pytest.mark.parametrize(
    ("how", "broker"), [*product(SIGNALS, BROKERS)], ids=lambda x: getattr(x, "name", x)
)


@every_case
def test_a_session_ends_soon_and_cleanly(
    ended: dict[tuple[signal.Signals, str], Ended], how: signal.Signals, broker: str
) -> None:
    one = ended[how, broker]
    print(f"{one.took_s:.2f} s from {how.name} to the exit")
    assert one.code == (130 if how is signal.SIGINT else 0)
    assert "Traceback" not in one.err
    assert all(line.startswith("plotfeed: ") for line in one.err.splitlines()), one.err


@every_case
def test_every_sensor_is_offline_at_last(
    ended: dict[tuple[signal.Signals, str], Ended], how: signal.Signals, broker: str
) -> None:
    one = ended[how, broker]
    told = {m.topic: json.loads(m.payload)["state"] for m in one.of(Stage.AFTER) if is_status(m)}
    assert told == {f"{how.name}/{sensor}/status": "OFFLINE" for sensor in ("slow", "quick")}
    assert set(one.retained.values()) <= {"OFFLINE"}
    assert len(one.retained) == (2 if broker == "living" else 0)


def is_status(message: Recorded) -> bool:
    return message.topic.endswith("/status")


@every_case
def test_the_ledger_is_complete(
    ended: dict[tuple[signal.Signals, str], Ended], how: signal.Signals, broker: str
) -> None:
    one = ended[how, broker]
    ledger = one.ledger()
    handed_over = Counter((m.topic, m.publish_time_ns) for m in one.of(Stage.BEFORE))
    assert Counter((s.topic, s.due_utc_ns) for s in ledger) == handed_over
    fates = {
        sensor: {s.fate for s in ledger if f"/{sensor}/" in s.topic} for sensor in ("slow", "quick")
    }
    assert fates["slow"] == {pb.ENDED}
    expected = {pb.SENT} if broker == "living" else {pb.SENT, pb.UNDELIVERED}
    assert fates["quick"] == expected
    counts = Counter(s.fate for s in ledger)
    assert f"on the way at the end {counts[pb.ENDED]}" in one.out
    assert (f"undelivered {counts[pb.UNDELIVERED]}" in one.out) == (broker != "living")
