"""The clients and scenes in examples/, as they stand there."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.brokers import free_port
from support.command import Running, plotfeed_here, running
from support.tools import NODE_MODULES, needed, node_module
from support.waiting import PATIENCE_S, first_lines

from plotfeed.feeds.page.shown import tracks_to_show
from plotfeed.feeds.scene.scene import load
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.testing import MqttMessage, MqttReceiver

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENES = sorted((EXAMPLES / "scenes").glob("*.toml"))
LINE = re.compile(r"\d\d:\d\d:\d\d\.\d+ (\S+) +(-?\d+\.\d{6}) (-?\d+\.\d{6}) (-?\d+) m")
UDP = "127.0.0.1:8600"
ENOUGH = 12  # Lines of a client


@pytest.fixture(scope="module")
def radar_and_port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Running, int]]:
    """The scene of one radar, at work, with another UDP port that it sends to."""
    port = free_port()
    text = (EXAMPLES / "scenes" / "radar-udp.toml").read_text()
    assert UDP in text
    scene = tmp_path_factory.mktemp("scene") / "radar-udp.toml"
    scene.write_text(text.replace(UDP, f"127.0.0.1:{port}"))
    with running("run", scene) as session:
        yield session, port


def off_the_path_m(east_m: float, north_m: float) -> float:
    """Distance of a place from the straight line on which the scene's drone flies."""
    (first, last) = np.array([[2000.0, 1000.0], [-2000.0, 1500.0]])
    along = (last - first) / np.linalg.norm(last - first)
    off = np.array([east_m, north_m]) - first
    return float(abs(along[0] * off[1] - along[1] * off[0]))


def test_clients_put_plots_where_the_drone_flies(radar_and_port: tuple[Running, int]) -> None:
    session, udp = radar_and_port
    mqtt = str(session.port("MQTT"))
    node_module("mqtt")
    commands = [
        [sys.executable, EXAMPLES / "plots_paho.py", "127.0.0.1", mqtt],
        [sys.executable, EXAMPLES / "plots_aiomqtt.py", "127.0.0.1", mqtt],
        [sys.executable, EXAMPLES / "plots_udp.py", str(udp), "127.0.0.1", mqtt],
        [needed("node"), EXAMPLES / "plots.mjs", f"mqtt://127.0.0.1:{mqtt}"],
    ]
    site = LocalFrame(40.45, -3.73, 650.0)
    with ThreadPoolExecutor(len(commands)) as threads:
        found = partial(first_lines, count=ENOUGH, NODE_MODULES=str(NODE_MODULES))
        for lines in threads.map(found, commands):
            near = 0
            for line in lines:
                found = LINE.fullmatch(line)
                assert found, line
                assert found[1] == "radar"
                place_m = geodetic_to_ecef(*map(float, found.groups()[1:]))
                east_m, north_m, up_m = site.from_ecef(place_m)
                # 0.2 degrees of azimuth are 8 m at 2.2 km, 0.6 of elevation 23 m; 048 adds rounding
                near += off_the_path_m(east_m, north_m) < 40.0 and -20.0 < up_m < 220.0
            assert near >= 3  # the drone, once a second, among false alarms


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_a_scene_is_sound_and_runs(scene: Path) -> None:
    assert load(scene).scene.name == scene.stem
    assert plotfeed_here("check", scene).returncode == 0
    options = ("--broker", "none", "--speed", "max", "--duration", "10")
    done = plotfeed_here("run", scene, *options)
    assert done.returncode == 0, done.stderr
    assert re.search(r"plots [1-9]", done.stdout.splitlines()[-1])


def test_a_flight_comes_through_to_a_utm_system_as_a_track() -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "utm_end_to_end.py"), "40"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    first = re.search(r"track radar-1 begins at (\S+) (\S+) (\d+) m", done.stdout)
    assert first, done.stdout
    site = LocalFrame(40.45, -3.73, 650.0)
    east_m, north_m, up_m = site.from_ecef(geodetic_to_ecef(*map(float, first.groups())))
    assert -1000 < east_m < -700  # where the flight begins
    assert 600 < north_m < 900
    assert 0 < up_m < 200
    assert "refused" not in done.stdout


def test_stone_soup_tracks_the_drone_by_its_plots(tmp_path: Path) -> None:
    python = EXAMPLES.parent / ".venv-stonesoup" / "bin" / "python"
    has_both = "import stonesoup, pyarrow"
    if not python.exists() or subprocess.run([python, "-c", has_both], check=False).returncode:
        pytest.skip("Stone Soup is not installed, with pyarrow, in .venv-stonesoup")
    record, plots = tmp_path / "radar.mcap", tmp_path / "radar-plots.parquet"
    options = ("--broker", "none", "--speed", "max", "--duration", "30", "--record", record)
    assert plotfeed_here("run", SCENES[0].parent / "radar-udp.toml", *options).returncode == 0
    assert plotfeed_here("convert", record, plots).returncode == 0
    done = subprocess.run(
        [python, EXAMPLES / "stonesoup_tracks.py", plots],
        capture_output=True,
        text=True,
        check=True,
    )
    longest = re.match(r"(\d+) scans, at the end (-?\d+) (-?\d+) (-?\d+) m", done.stdout)
    assert longest, done.stdout
    scans, east_m, north_m, up_m = map(int, longest.groups())
    assert scans > 20
    assert off_the_path_m(east_m, north_m) < 40.0
    assert 60 < up_m < 120


TRACKERS = {"plain_tracker.py": sys.executable, "stonesoup_tracker.py": ""}


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_tracker_under_test_follows_the_drone(
    tracker: str, radar_and_port: tuple[Running, int]
) -> None:
    python = TRACKERS[tracker] or str(EXAMPLES.parent / ".venv-stonesoup" / "bin" / "python")
    needed = "import stonesoup, paho.mqtt, google.protobuf"
    if not Path(python).exists() or (
        not TRACKERS[tracker] and subprocess.run([python, "-c", needed], check=False).returncode
    ):
        pytest.skip("Stone Soup is not installed, with paho-mqtt and plotfeed, in .venv-stonesoup")
    port = radar_and_port[0].port("MQTT")
    topic, site = f"under-test/{tracker}", LocalFrame(40.45, -3.73, 650.0)

    def follows(heard: MqttMessage) -> bool:
        """A track near the path, as the page and the score read it."""
        told = tracks_to_show(heard.payload, None, time.time_ns(), site)
        places = [[each.latitude_deg, each.longitude_deg, each.height_m] for each in told]
        enu_m = site.from_ecef(geodetic_to_ecef(*np.reshape(places, (-1, 3)).T))
        return any(off_the_path_m(*place) < 60.0 for place in enu_m[:, :2].tolist())

    with MqttReceiver(port, 4, topic) as client:
        process = subprocess.Popen(
            [python, str(EXAMPLES / tracker), "127.0.0.1", str(port), "plotfeed", topic],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            client.wait_for(follows)
        finally:
            process.kill()
            _, errors = process.communicate()
    assert errors == ""


def test_every_example_is_told_of_on_its_page() -> None:
    page = (EXAMPLES / "README.md").read_text()
    there = {path.relative_to(EXAMPLES).as_posix() for path in (*EXAMPLES.glob("*.*"), *SCENES)}
    assert set(re.findall(r"\]\(([\w./-]+\.(?:py|mjs|toml|conf|json))\)", page)) == there - {
        "README.md"
    }
