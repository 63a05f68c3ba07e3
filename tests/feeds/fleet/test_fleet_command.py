"""`plotfeed fleet` and `run --part`: processes that are killed and frozen, and what is refused."""

from __future__ import annotations

import json
import os
import signal
import time
from collections import defaultdict
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto, quiet_mosquitto
from support.command import plotfeed_here
from support.fleets import by_topic, fleet
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.recording.recorder import SessionRecord
from plotfeed.feeds.scene.scene import load
from plotfeed.proto.utc import NS, iso_utc, whole_second_ns
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import MqttReceiver, fly

PLACES = {"north": [0.0, 800.0, 0.0], "south": [0.0, -800.0, 0.0], "east": [800.0, 0.0, 0.0]}
SENSORS = "".join(
    radar(name, sectors=4, more=f"position_enu_m = {place}") for name, place in PLACES.items()
)
START = ("--start", "2026-01-01T12:00:00Z")
BROKER = "mqtt://127.0.0.1:1"
# Tables that a scene has besides.
FILES = {
    "SCENE": "",
    "WEBSOCKET": '\n[[websocket]]\ncarries = "plots"\nport = 8765\n',
    "SOURCE": '\n[[telemetry.source]]\nfrom = "mavlink:udpin:127.0.0.1:14550"\n',
}


def soon() -> tuple[str, str]:
    """When a fleet is to begin whose processes are up by then."""
    return "--start", iso_utc(whole_second_ns(time.time_ns() + 2 * NS))


def test_parts_record_in_simulated_time_what_one_process_sends(tmp_path: Path) -> None:
    text = scene_text(sensors=SENSORS, start_utc="2026-01-01T12:00:00Z")
    scene = scene_file(tmp_path, text)
    found = defaultdict(list)
    for k in (1, 2):
        file = tmp_path / f"{k}.mcap"
        words = ["--part", f"{k}/2", "--broker", "none", "--speed", "max", "--duration", "5"]
        done = plotfeed_here("run", scene, *words, "--record", file, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["missed_scans"] == 0
        assert SessionRecord.open(file).start_utc_ns == load(scene).scene.start_utc_ns
        with file.open("rb") as opened:
            for message in McapReader(opened).messages():
                if message.stage is Stage.AFTER:
                    found[message.topic].append(message.payload)
    loaded = load(scene)
    wanted = by_topic(fly(loaded, 5.0, loaded.scene.start_utc_ns or 0).messages, 0)
    assert {topic: found[topic] for topic in wanted} == wanted


def test_none_is_sent_twice_whatever_becomes_of_processes(tmp_path: Path) -> None:
    """One is frozen while another stands by, and wakes; one is killed. Nobody else dies."""
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS, drones=DRONE))
    names = [sensor.id for sensor in load(scene).sensor]
    broker = f"mqtt://127.0.0.1:{port}"
    with (
        quiet_mosquitto(tmp_path, port),
        fleet(scene, port, "--workers", "2", "--spares", "1", "--json", *soon()) as at_work,
    ):
        at_work.wait(lambda: at_work.sends(2), "it never began")
        at_work.wait(lambda: at_work.errors().count("stands by") >= 2, "nobody stands by")
        at_work.heard_of(names)
        frozen = at_work.pid(1)
        os.kill(frozen, signal.SIGSTOP)
        at_work.wait(lambda: at_work.pid(1) != frozen, "nobody took over from who is frozen")
        at_work.wait(lambda: at_work.sends(2, 3), "who took over does not send")
        at_work.heard_of(names)
        os.kill(frozen, signal.SIGCONT)
        at_work.wait(lambda: "has taken it over" in at_work.errors(), "it never understood")
        killed = at_work.pid(2)
        os.kill(killed, signal.SIGKILL)
        at_work.wait(lambda: at_work.pid(2) != killed, "nobody took over from who was killed")
        at_work.wait(lambda: at_work.sends(2, 4), "who took over from it does not send")
        at_work.heard_of(names)
        told = plotfeed_here("fleet", "status", scene, "--broker", broker, "--json")
        assert told.returncode == 0, told.stderr
        assert [row["state"] for row in json.loads(told.stdout)["parts"]] == ["RUNNING"] * 2
        assert json.loads(told.stdout)["takeovers"] >= 2
        assert "take-overs" in plotfeed_here("fleet", "status", scene, "--broker", broker).stdout
        assert at_work.end(signal.SIGINT) == INTERRUPTED, at_work.errors()  # as of Ctrl-C
        assert "Traceback" not in at_work.errors()
        assert [row["state"] for row in at_work.said()["parts"]] == ["ENDED"] * 2
        assert at_work.said()["counts"]["messages"] > 0
        for part in (1, 2):
            wait_until(lambda part=part: at_work.states(f"plotfeed/fleet/{part}")[-1] == "ENDED")  # type: ignore[misc]
        wait_until(
            lambda: {at_work.states(f"plotfeed/{name}/status")[-1] for name in names} == {"OFFLINE"}
        )
        verdict = at_work.verdict()
    assert (verdict.twice, verdict.foreign_topics, verdict.disordered) == (0, set(), 0)
    assert not verdict.missing
    assert verdict.heard > 50
    deaths = [at_work.states(f"plotfeed/fleet/{part}/session").count("DIED") for part in (1, 2)]
    assert deaths == [1, 1]


def test_a_part_is_started_again_by_whoever_started_it_and_goes_on_without(tmp_path: Path) -> None:
    """Nobody stands by; what its will says, it takes back itself."""
    port, died = free_port(), "plotfeed/fleet/1/session"
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS, drones=DRONE))
    with mosquitto(tmp_path, port), fleet(scene, port, "--workers", "1", *soon()) as at_work:
        at_work.wait(lambda: at_work.sends(1), "it never began")
        said = at_work.statuses()[1]["number"]
        # Has told by then that it was late, if it was.
        at_work.wait(lambda: at_work.statuses()[1]["number"] > said + 2, "it says nothing")
        os.kill(at_work.pid(1), signal.SIGKILL)
        at_work.wait(lambda: at_work.states(died)[:2] == ["RUNNING", "DIED"], "no will came")
        at_work.wait(lambda: at_work.sends(1, 2), "it was not started again")
        at_work.wait(lambda: at_work.states(died)[-1] == "RUNNING", "it is still said to be dead")
        at_work.process.kill()
        at_work.process.wait()
        since = len(at_work.client.heard)
        wait_until(lambda: any("/asterix" in m.topic for m in at_work.client.heard[since + 20 :]))
        os.kill(at_work.pid(1), signal.SIGTERM)
        wait_until(lambda: at_work.states("plotfeed/fleet/1")[-1] == "ENDED")
        verdict = at_work.verdict()
    assert (verdict.twice, verdict.foreign_topics, verdict.disordered) == (0, set(), 0)
    assert not verdict.missing


def test_there_is_no_fleet_where_none_says_so(tmp_path: Path) -> None:
    port = free_port()
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS))
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as client:
        for level in ("1", "2", "1/gaps", "1/session", "x"):
            client.publish(f"plotfeed/fleet/{level}", b'{"part": [{}]}', retain=True)
        client.wait_for(lambda m: m.topic == "plotfeed/fleet/x")
        done = plotfeed_here("fleet", "status", scene, "--broker", f"mqtt://127.0.0.1:{port}")
    assert done.returncode == 1
    assert "no part of a fleet says on plotfeed/fleet/# that it runs" in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["fleet", "SCENE"], "need a broker: --broker"),
        (["fleet", "status", "SCENE", "--broker", "none"], "need a broker: --broker"),
        (["run", "SCENE", "--part", "9/9", "--broker", BROKER, *START], "3 parts at most, not 9"),
        (["fleet", "SCENE", "--broker", BROKER, "--start", "soon"], "--start: expected a time as"),
        (["fleet", "SCENE", "extra"], "expected SCENE, status SCENE, or stop SCENE"),
        (["fleet", "stop", "SCENE"], "stop ends what Ray runs: --ray HOST:PORT"),
        (["fleet", "SCENE", "--broker", BROKER, "--ray", "127.0.0.1:1"], "127.0.0.1:1 does not"),
        (["run", "SCENE", "--part", "0/3"], "--part: expected K/N"),
        (["run", "SCENE", "--part", "4/3"], "--part: expected K/N"),
        (["run", "SCENE", "--part", "1/3"], "need a broker that all of them reach"),
        (["run", "SCENE", "--part", "1/3", "--broker", BROKER], "--part needs --start TIME"),
        (["run", "SCENE", *START], "--start is for parts of a scene"),
        (["run", "SCENE", "--part", "1/3", "--page", "1"], "--page is of a whole session"),
        (["run", "SCENE", "--part", "1/3", "--broker", BROKER, "--speed", "2"], "in real time"),
        (["fleet", "WEBSOCKET", "--broker", BROKER], "websocket"),
        (["fleet", "SOURCE", "--broker", BROKER], "telemetry"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(tmp_path: Path, words: list[str], says: str) -> None:
    (more,) = (FILES[word] for word in words if word in FILES)
    scene = scene_file(tmp_path, scene_text(sensors=SENSORS) + more)
    done = plotfeed_here(*(scene if word in FILES else word for word in words))
    assert done.returncode in (1, 2)
    assert says in done.stderr
    assert "Traceback" not in done.stderr
