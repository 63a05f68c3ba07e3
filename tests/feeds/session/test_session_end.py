"""The end of a session in a process of its own, by signals, whatever its broker does then."""

from __future__ import annotations

import asyncio
import json
import re
import signal
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from subprocess import Popen
from typing import Any
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

OFFLINE = {"slow": "OFFLINE", "quick": "OFFLINE"}
SLOW = radar("slow", period_s=0.5, sectors=8, more="[sensor.link]\nlatency_ms = 600_000.0\n")
QUICK = radar("quick", period_s=0.5, sectors=8)


def scan_of_quick(metrics: int) -> float:
    with urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=PATIENCE_S) as answer:
        text = answer.read().decode()
    (scan,) = re.findall(r'^plotfeed_sensor_scan\{sensor="quick"\} (\S+)$', text, re.MULTILINE)
    return float(scan)


def states(statuses: list[Any]) -> dict[str, str]:
    """The last of each sensor."""
    told = [m for m in statuses if m.topic.endswith("/status")]
    return {m.topic.split("/")[1]: json.loads(m.payload)["state"] for m in told}


def kill(broker: Popen[bytes]) -> None:
    broker.kill()
    broker.wait()


@pytest.mark.parametrize(
    ("harm", "how", "code"),
    [
        (None, signal.SIGINT, 130),
        (lambda broker: broker.send_signal(signal.SIGSTOP), signal.SIGTERM, 0),
        (kill, signal.SIGINT, 130),
    ],
    ids=["living", "stopped", "gone"],
)
def test_a_session_ends_cleanly_is_offline_and_has_a_complete_ledger(
    tmp_path: Path, harm: Callable[[Popen[bytes]], None] | None, how: signal.Signals, code: int
) -> None:
    port, metrics, record = free_port(), free_port(), tmp_path / "x.mcap"
    scene = scene_file(tmp_path, scene_text(sensors=SLOW + QUICK, mqtt="qos = 1"))
    words = ["run", scene, "--record", record, "--metrics", metrics]
    words += ["--broker", f"mqtt://127.0.0.1:{port}"]
    with ExitStack() as stack:
        broker = stack.enter_context(own_broker(tmp_path, port))
        session = stack.enter_context(command.running(*words))
        with MqttReceiver(port, 5, "plotfeed/quick/plots") as ears:
            for _ in range(3):
                ears.wait_for(lambda _: True, len(ears.heard))
        if harm is not None:
            harm(broker)
            stack.callback(broker.send_signal, signal.SIGCONT)
        wanted = scan_of_quick(metrics) + 2  # it works on, whether or not anybody hears of it
        wait_until(lambda: scan_of_quick(metrics) >= wanted)
        ended, out, err = session.end(how)
        if harm is None:
            with MqttReceiver(port, 5, "plotfeed/+/status") as late:
                wait_until(lambda: states(late.heard) == OFFLINE)
    assert ended == code
    assert "Traceback" not in err
    assert all(line.startswith("plotfeed: ") for line in err.splitlines()), err
    with McapReader(record) as log:
        messages: list[Recorded] = list(log.messages())
    left = [m for m in messages if m.stage is Stage.AFTER]
    assert states(left) == OFFLINE
    truth = [entry for m in left if m.topic.endswith("/truth") for entry in entries_in(m.payload)]
    ledger = [sent for entry in truth for sent in entry.messages]
    handed_over = Counter((m.topic, m.publish_time_ns) for m in messages if m.stage is Stage.BEFORE)
    assert Counter((s.topic, s.due_utc_ns) for s in ledger) == handed_over
    fates = {name: {s.fate for s in ledger if f"/{name}/" in s.topic} for name in OFFLINE}
    lost = set() if harm is None else {pb.UNDELIVERED}
    assert fates == {"slow": {pb.ENDED}, "quick": {pb.SENT, *lost}}
    counts = Counter(s.fate for s in ledger)
    assert f"on the way at the end {counts[pb.ENDED]}" in out
    assert (f"undelivered {counts[pb.UNDELIVERED]}" in out) == bool(lost)


@pytest.mark.asyncio
async def test_a_session_that_is_told_to_stop_does_not_wait_for_its_broker(tmp_path: Path) -> None:
    """Nor does it complain of one that never answered."""
    scene, stop = load(scene_file(tmp_path, scene_text(sensors=QUICK))), asyncio.Event()
    with deaf_server() as port:
        asyncio.get_running_loop().call_later(0.1, stop.set)
        totals = await run(scene, broker=f"mqtt://127.0.0.1:{port}", stop=stop)
    assert totals.plots == 0
