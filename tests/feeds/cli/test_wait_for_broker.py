"""`--wait`: a broker that is not up yet is waited for, with a line, until it is."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import Started, plotfeed_here, started
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.testing import MqttReceiver

HOW = ("--set", "altitude_reference=ellipsoid", "--speed", 100, "--drone", "d")
SIMULATED = ("--broker", "none", "--speed", "max", "--duration", 2)


@contextmanager
def who_wait(folder: Path, flight: Path, url: str) -> Iterator[dict[str, Started]]:
    """Every command that needs a broker, each of which has said that it waits for that one."""
    scene, recording = scene_file(folder, scene_text(sensors=radar())), folder / "session.mcap"
    assert plotfeed_here("run", scene, *SIMULATED, "--record", recording).returncode == 0
    to: tuple[object, ...] = ("--broker", url)
    live = f"sbs1:tcpin:127.0.0.1:{free_port()}"
    commands: dict[str, tuple[object, ...]] = {
        "run": ("run", scene, *to, "--duration", 1),
        "demo": ("demo", *to, "--duration", 1, "--page", free_port()),
        "inject": ("inject", flight, *HOW, *to),
        "replay": ("replay", recording, *to, "--speed", "max"),
        "record": ("record", f"{url}/x/#", folder / "new.mcap", "--duration", 0.2),
        "inject live": ("inject", live, *to, "--duration", 0.2),
    }
    with ExitStack() as begun:
        found = {
            name: begun.enter_context(started(*words, "--wait")) for name, words in commands.items()
        }
        for process in found.values():
            while not (line := process.stderr.readline()).startswith("plotfeed: waits for"):
                assert line, process.communicate(PATIENCE_S)
            assert line.startswith(f"plotfeed: waits for the MQTT broker {url} (")
            assert line.endswith("; stop: Ctrl-C\n")
        yield found


def test_a_broker_that_comes_later_is_waited_for_by_every_command(
    tmp_path: Path, flight: Path
) -> None:
    port = free_port()
    with who_wait(tmp_path, flight, f"mqtt://127.0.0.1:{port}") as processes:
        assert all(process.poll() is None for process in processes.values())
        with mosquitto(tmp_path, port), MqttReceiver(port, 5, "#") as client:
            for topic in ("plotfeed/radar/", "plotfeed/tower/", "plotfeed/telemetry/d"):
                client.wait_for(lambda m: m.topic.startswith(topic))  # noqa: B023 - at once
            wait_until(lambda: all(one.poll() is not None for one in processes.values()))
        for name, process in processes.items():
            out, err = process.communicate()
            assert "Traceback" not in err
            assert "waits for" not in err
            assert "listens to" in out or name != "inject live"
            if not name.startswith("inject"):  # whose reports no session took in
                assert process.returncode == 0, err


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_who_waits_can_be_stopped(how: signal.Signals, tmp_path: Path, flight: Path) -> None:
    with who_wait(tmp_path, flight, f"mqtt://127.0.0.1:{free_port()}") as processes:
        for process in processes.values():
            process.send_signal(how)
            _, err = process.communicate(PATIENCE_S)
            assert "Traceback" not in err
            if how == signal.SIGINT:
                assert process.wait() == 130


def test_without_it_nobody_waits(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=radar()))
    done = plotfeed_here("run", scene, "--broker", f"mqtt://127.0.0.1:{free_port()}")
    assert done.returncode == 1
    assert done.stderr.startswith("plotfeed: MQTT broker mqtt://127.0.0.1:")
