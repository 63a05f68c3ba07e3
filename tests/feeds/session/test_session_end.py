"""The end of a session in a process of its own, by signals, whatever its broker does then."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import threading
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import pytest
from support import command
from support.brokers import deaf_server, free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import MqttReceiver

SENSORS = ("slow", "quick")
SLOW = radar("slow", period_s=0.5, sectors=8, more="[sensor.link]\nlatency_ms = 600_000.0\n")
QUICK = radar("quick", period_s=0.5, sectors=8)
# What a broker does, and which signal its session has then.
CASES = {"living": signal.SIGINT, "stopped": signal.SIGTERM, "gone": signal.SIGINT}


@dataclass(frozen=True)
class Ended:
    """What is known of a session afterwards."""

    code: int
    out: str
    err: str
    record: list[Recorded]
    retained: dict[str, str]  # Last states that the broker knows, where it lives

    def of(self, stage: Stage) -> list[Recorded]:
        return [message for message in self.record if message.stage is stage]

    def ledger(self) -> list[pb.Sent]:
        payloads = [m.payload for m in self.of(Stage.AFTER) if m.topic.endswith("/truth")]
        return [sent for p in payloads for entry in entries_in(p) for sent in entry.messages]


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ended]:
    """All cases at once: what takes time is to wait."""
    found: dict[str, Ended] = {}

    def end(broker: str, folder: Path) -> None:
        found[broker] = end_over(broker, folder)

    folders = {broker: tmp_path_factory.mktemp(broker) for broker in CASES}
    threads = [threading.Thread(target=end, args=each) for each in folders.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found.keys() == CASES.keys()
    return found


def end_over(broker: str, folder: Path) -> Ended:
    """A session that is told to end while its broker lives, stands still or is gone."""
    port, metrics, how = free_port(), free_port(), CASES[broker]
    scene, record = (
        scene_file(folder, scene_text(sensors=SLOW + QUICK, mqtt="qos = 1")),
        folder / "x.mcap",
    )
    words = ["run", scene, "--record", record, "--metrics", metrics]
    with ExitStack() as stack:
        process = stack.enter_context(own_broker(folder, port))
        broker_url = f"mqtt://127.0.0.1:{port}"
        session = stack.enter_context(command.running(*words, "--broker", broker_url))
        with MqttReceiver(port, 5, "plotfeed/quick/plots") as ears:
            for _ in range(3):
                ears.wait_for(lambda _: True, len(ears.heard))
        harm(process, broker, stack)
        wanted = scan_of_quick(metrics) + 2  # it works on, whether or not anybody hears of it
        wait_until(lambda: scan_of_quick(metrics) >= wanted)
        code, out, err = session.end(how)
        retained = states(port) if broker == "living" else {}
        with McapReader(record) as log:
            return Ended(code, out, err, list(log.messages()), retained)


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


def states(port: int) -> dict[str, str]:
    with MqttReceiver(port, 5, "plotfeed/+/status") as ears:
        for sensor in SENSORS:
            topic = f"plotfeed/{sensor}/status"
            ears.wait_for(lambda m, topic=topic: m.topic == topic)  # type: ignore[misc]
        return {m.topic.split("/")[1]: json.loads(m.payload)["state"] for m in ears.heard}


@pytest.mark.asyncio
async def test_a_session_that_is_told_to_stop_does_not_wait_for_its_broker(tmp_path: Path) -> None:
    """Nor does it complain of one that never answered."""
    scene, stop = load(scene_file(tmp_path, scene_text(sensors=QUICK))), asyncio.Event()
    with deaf_server() as port:
        asyncio.get_running_loop().call_later(0.1, stop.set)
        totals = await run(scene, broker=f"mqtt://127.0.0.1:{port}", stop=stop)
    assert totals.plots == 0


@pytest.mark.parametrize("broker", CASES)
def test_a_session_ends_cleanly_is_offline_and_has_a_complete_ledger(
    ended: dict[str, Ended], broker: str
) -> None:
    one = ended[broker]
    assert one.code == (130 if CASES[broker] is signal.SIGINT else 0)
    assert "Traceback" not in one.err
    assert all(line.startswith("plotfeed: ") for line in one.err.splitlines()), one.err
    told = [m for m in one.of(Stage.AFTER) if m.topic.endswith("/status")]
    last = {m.topic.split("/")[1]: json.loads(m.payload)["state"] for m in told}
    assert last == dict.fromkeys(SENSORS, "OFFLINE")
    assert one.retained == (last if broker == "living" else {})
    ledger = one.ledger()
    handed_over = Counter((m.topic, m.publish_time_ns) for m in one.of(Stage.BEFORE))
    assert Counter((s.topic, s.due_utc_ns) for s in ledger) == handed_over
    fates = {name: {s.fate for s in ledger if f"/{name}/" in s.topic} for name in SENSORS}
    assert fates["slow"] == {pb.ENDED}
    assert fates["quick"] == ({pb.SENT} if broker == "living" else {pb.SENT, pb.UNDELIVERED})
    counts = Counter(s.fate for s in ledger)
    assert f"on the way at the end {counts[pb.ENDED]}" in one.out
    assert (f"undelivered {counts[pb.UNDELIVERED]}" in one.out) == (broker != "living")
