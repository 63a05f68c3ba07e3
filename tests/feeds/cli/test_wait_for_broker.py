"""`--wait`: a broker that is not up yet is waited for, with a line, until it is."""

from __future__ import annotations

import signal
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import Started, plotfeed_here, started
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.testing import MqttReceiver


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


EVERY = (run, demo, inject, replay, record, inject_live)


def waits(process: Started) -> str:
    """The line that says so, after what a flight's reading says."""
    while not (line := process.stderr.readline()).startswith("plotfeed: waits for"):
        assert line, process.communicate(PATIENCE_S)
    return line


def test_a_broker_that_comes_later_is_waited_for_by_every_command(tmp_path: Path) -> None:
    port = free_port()
    url = f"mqtt://127.0.0.1:{port}"
    with ExitStack() as begun:
        processes = []
        for words in EVERY:
            folder = tmp_path / words.__name__
            folder.mkdir()
            processes.append(begun.enter_context(started(*words(folder, url))))
        for process in processes:
            line = waits(process)
            assert line.startswith(f"plotfeed: waits for the MQTT broker {url} (")
            assert line.endswith("; stop: Ctrl-C\n")
            assert process.poll() is None
        with mosquitto(tmp_path, port), MqttReceiver(port, 5, "#") as client:
            for topic in ("plotfeed/radar/", "plotfeed/tower/", "plotfeed/telemetry/d"):
                client.wait_for(lambda m: m.topic.startswith(topic))  # noqa: B023 - at once
            wait_until(lambda: all(process.poll() is not None for process in processes))
        for words, process in zip(EVERY, processes, strict=True):
            out, err = process.communicate()
            assert "Traceback" not in err
            assert "waits for" not in err
            assert "listens to" in out or words is not inject_live
            if words not in (inject, inject_live):  # whose reports no session took in
                assert process.returncode == 0, err


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_who_waits_can_be_stopped(how: signal.Signals, tmp_path: Path) -> None:
    with ExitStack() as begun:
        for words in EVERY:
            folder = tmp_path / words.__name__
            folder.mkdir()
            url = f"mqtt://127.0.0.1:{free_port()}"
            process = begun.enter_context(started(*words(folder, url)))
            waits(process)
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
