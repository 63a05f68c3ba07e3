"""`--wait`: a broker that is not up yet is waited for, with a line, until it is."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import plotfeed_here, started
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.testing import MqttReceiver

Words = Callable[[Path, str], list[object]]


def flight(folder: Path) -> Path:
    path = folder / "flight.csv"
    rows = [f"{1767268800 + i},40,-3,9" for i in range(5)]
    path.write_text("\n".join(["time,latitude_deg,longitude_deg,altitude_m", *rows, ""]))
    return path


def recording(folder: Path) -> Path:
    path, scene = folder / "session.mcap", scene_file(folder, scene_text(sensors=radar()))
    how = ("--broker", "none", "--speed", "max", "--duration", "2", "--record", path)
    assert plotfeed_here("run", scene, *how).returncode == 0
    return path


def run(folder: Path, url: str) -> list[object]:
    scene = scene_file(folder, scene_text(sensors=radar()))
    return ["run", "--wait", scene, "--broker", url, "--duration", 1]


def demo(_folder: Path, url: str) -> list[object]:
    return ["demo", "--wait", "--broker", url, "--duration", 1, "--page", free_port()]


def inject(folder: Path, url: str) -> list[object]:
    how = ("--set", "altitude_reference=ellipsoid", "--speed", 100, "--drone", "d")
    return ["inject", flight(folder), *how, "--broker", url, "--wait"]


def replay(folder: Path, url: str) -> list[object]:
    return ["replay", recording(folder), "--broker", url, "--wait", "--speed", "max"]


def record(folder: Path, url: str) -> list[object]:
    return ["record", f"{url}/x/#", folder / "new.mcap", "--wait", "--duration", 0.2]


def inject_live(_folder: Path, url: str) -> list[object]:
    source = f"sbs1:tcpin:127.0.0.1:{free_port()}"
    return ["inject", source, "--broker", url, "--wait", "--duration", 0.2]


every_command = pytest.mark.parametrize("words", [run, demo, inject, replay, record, inject_live])


@every_command
def test_a_broker_that_comes_later_is_waited_for(words: Words, tmp_path: Path) -> None:
    port = free_port()
    url = f"mqtt://127.0.0.1:{port}"
    with started(*words(tmp_path, url)) as process:
        line = process.stderr.readline()
        while not line.startswith("plotfeed: waits for"):  # of the flight's reading
            assert line, process.communicate(PATIENCE_S)
            line = process.stderr.readline()
        assert line.startswith(f"plotfeed: waits for the MQTT broker {url} (")
        assert line.endswith("; stop: Ctrl-C\n")
        assert process.poll() is None
        with mosquitto(tmp_path, port), MqttReceiver(port, 5, "#") as client:
            if words not in (record, inject_live):
                client.wait_for(lambda m: m.topic.startswith("plotfeed/"))
            wait_until(lambda: process.poll() is not None)
        out, err = process.communicate()
    assert "Traceback" not in err
    assert "waits for" not in err
    if words is inject_live:
        assert "listens to" in out
    else:
        assert process.returncode in ((0, 1) if words is inject else (0,)), err


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
@every_command
def test_who_waits_can_be_stopped(words: Words, how: signal.Signals, tmp_path: Path) -> None:
    with started(*words(tmp_path, f"mqtt://127.0.0.1:{free_port()}")) as process:
        while "waits for" not in (line := process.stderr.readline()):
            assert line
        process.send_signal(how)
        _, err = process.communicate(PATIENCE_S)
    assert "Traceback" not in err
    if how == signal.SIGINT:
        assert process.wait() == 130


def test_without_it_nobody_waits(tmp_path: Path) -> None:
    words = [word for word in run(tmp_path, f"mqtt://127.0.0.1:{free_port()}") if word != "--wait"]
    done = plotfeed_here(*words)
    assert done.returncode == 1
    assert done.stderr.startswith("plotfeed: MQTT broker mqtt://127.0.0.1:")
