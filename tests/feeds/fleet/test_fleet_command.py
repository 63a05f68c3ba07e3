"""`plotfeed fleet` on Ray: same bytes, and none twice whatever becomes of its workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections import defaultdict
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import PLOTFEED, plotfeed
from support.fleet_process import fleet, skip_without_ray
from support.fleet_scenes import by_topic
from support.road import fly
from support.scene_files import DRONE, radar, scene_file, scene_text

from plotfeed.feeds.recording.session_again import SessionRecord
from plotfeed.feeds.scene.scene import load
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Stage

if find_spec("ray") is None:  # whose import takes long
    pytest.skip("could not import 'ray'", allow_module_level=True)

SENSORS = "".join(
    [
        radar("north", sectors=4, more="position_enu_m = [0.0, 800.0, 0.0]"),
        radar("south", sectors=4, more="position_enu_m = [0.0, -800.0, 0.0]"),
        radar("east", sectors=4, more="position_enu_m = [800.0, 0.0, 0.0]"),
    ]
)


def test_workers_of_ray_record_what_one_process_sends(tmp_path: Path) -> None:
    text = scene_text(sensors=SENSORS, start_utc="2026-01-01T12:00:00Z")
    scene, parts = scene_file(tmp_path, text), tmp_path / "parts"
    words = ["fleet", scene, "--workers", "2", "--broker", "none", "--speed", "max"]
    done = subprocess.run(
        [*PLOTFEED, *map(str, [*words, "--duration", "5", "--record", parts, "--json"])],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    skip_without_ray(done.stderr)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    loaded = load(scene)
    sent = fly(loaded, 5.0, loaded.scene.start_utc_ns or 0).messages
    found = defaultdict(list)
    for file in sorted(parts.glob("*.mcap")):
        assert SessionRecord.open(file).start_utc_ns == loaded.scene.start_utc_ns
        with file.open("rb") as opened:
            for message in McapReader(opened).messages():
                if message.stage is Stage.AFTER:
                    found[message.topic].append(message.payload)
    wanted = by_topic(sent, 0)
    assert {topic: found[topic] for topic in wanted} == wanted
    assert len(list(parts.glob("*.mcap"))) == 2
    assert json.loads(done.stdout)["counts"]["missed_scans"] == 0


def test_none_is_sent_twice_whatever_becomes_of_workers(tmp_path: Path) -> None:
    """One is frozen, given up and wakes; one is killed."""
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS, drones=DRONE))
    names = [sensor.id for sensor in load(scene).sensor]
    broker = f"mqtt://127.0.0.1:{port}"
    quiet = f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
    with (
        mosquitto(tmp_path, port, quiet),
        fleet(scene, port, "--workers", "2", "--lease", "3") as at_work,
    ):
        at_work.wait(lambda: at_work.sends(2, 0), "it never began")
        at_work.heard_of(names)
        frozen, killed = at_work.pids().values()
        os.kill(frozen, signal.SIGSTOP)
        at_work.wait(lambda: at_work.sends(2, 1), "nobody took over from who is frozen")
        at_work.heard_of(names)
        os.kill(frozen, signal.SIGCONT)
        at_work.wait(lambda: "is back" in at_work.errors(), "who was frozen never understood")
        if killed not in at_work.pids().values():  # it was too slow, and is a spare now
            (killed, *_) = at_work.pids().values()
        os.kill(killed, signal.SIGKILL)
        at_work.wait(lambda: "died" in at_work.errors(), "nobody saw that one was killed")
        at_work.wait(lambda: at_work.sends(2, 2), "nobody took over from who was killed")
        at_work.heard_of(names)
        told = plotfeed("fleet", "status", scene, "--broker", broker, "--json")
        assert told.returncode == 0, told.stderr
        assert len(json.loads(told.stdout)["parts"]) == 2
        assert "take-overs" in plotfeed("fleet", "status", scene, "--broker", broker).stdout
        gaps = at_work.health()["gaps"]
        code, duration_s = at_work.end()
        assert code == 0, at_work.errors()
        assert "Traceback" not in at_work.errors()
    verdict = at_work.verdict(duration_s + 10)
    assert (verdict.twice, verdict.foreign_topics, verdict.disordered) == (0, set(), 0)
    assert verdict.heard > 50
    assert {gap["why"].partition(" ")[2] for gap in gaps} >= {"died"}
    last = {m.topic: m for m in at_work.client.heard if m.topic.endswith("/status")}
    assert {json.loads(last[f"plotfeed/{name}/status"].payload)["state"] for name in names} == {
        "OFFLINE"
    }


def test_there_is_no_fleet_where_none_says_so(tmp_path: Path) -> None:
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS))
    with mosquitto(tmp_path, port):
        done = plotfeed("fleet", "status", scene, "--broker", f"mqtt://127.0.0.1:{port}")
    assert done.returncode == 1
    assert "no fleet says on plotfeed/fleet that it runs" in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "a fleet needs a broker"),
        (["--broker", "none", "--ray", "127.0.0.1:1"], "Ray at 127.0.0.1:1 does not answer"),
        (["extra"], "expected SCENE, or status SCENE"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(tmp_path: Path, words: list[str], says: str) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS))
    done = plotfeed("fleet", scene, *words)
    assert done.returncode in (1, 2)
    assert says in done.stderr
