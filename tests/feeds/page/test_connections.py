from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from support.chromium import looking, until
from support.command import running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.page.connections import connections
from plotfeed.feeds.scene.scene import example, load
from plotfeed.feeds.session.sensor_description import SensorDescriber

if TYPE_CHECKING:
    from playwright.sync_api import Browser

URLS = {"MQTT 5": "mqtt://127.0.0.1:1884 (port 1884 is taken)"}
UDP = """
[[udp]]
destination = "239.255.0.1:8600"
interface = "lo"

[[udp]]
destination = "127.0.0.1:8601"
sensors = ["other"]
"""


def test_topics_are_those_that_the_sensors_describe() -> None:
    scene = example("field-day")
    told = connections(scene, URLS)
    assert told["brokers"] == [
        {"protocol": "MQTT 5", "url": "mqtt://127.0.0.1:1884", "needs_password": False}
    ]
    describer = SensorDescriber(scene)
    for sensor in scene.sensor:
        outputs = [o.topic for o in describer.description(sensor).outputs]
        assert [t["topic"] for t in told["sensors"][sensor.id]["topics"]] == outputs != []
    assert "truth" not in json.dumps(told)
    assert "control" not in json.dumps(told)


def test_a_sensor_is_told_where_its_own_datagrams_go(tmp_path: Path) -> None:
    text = scene_text(sensors=radar("one") + radar("other")) + UDP
    scene = load(scene_file(tmp_path, text))
    told = connections(scene, URLS)["sensors"]
    assert [to["destination"] for to in told["one"]["udp"]] == ["239.255.0.1:8600"]
    assert [to["destination"] for to in told["other"]["udp"]] == [
        "239.255.0.1:8600",
        "127.0.0.1:8601",
    ]
    told = connections(scene, URLS, sends_udp=False)["sensors"]
    assert told["other"]["udp"] == []


def test_what_is_copied_from_the_page_receives_the_sensors_messages(
    browser: Browser, tmp_path: Path
) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=radar("north")))
    with (
        running("run", scene, "--page", "127.0.0.1:0", folder=tmp_path) as run,
        looking(browser, f"http://127.0.0.1:{run.port('page')}/") as page,
    ):
        page.get_by_role("button", name="Connect here").click()
        until(page, "document.querySelectorAll('#connect-snippets li').length >= 4")
        where = page.locator("#connect-where").inner_text()
        assert f"mqtt://127.0.0.1:{run.port('MQTT 5')}" in where
        assert "plotfeed/north/plots" in where
        for protocol in ("MQTT 3.1.1", "MQTT 5"):
            line = page.locator("pre", has_text="mosquitto_sub").get_by_text(
                f"-p {run.port(protocol)}"
            )
            words = shlex.split(line.inner_text())
            done = subprocess.run(
                [*words, "-C", "2"], capture_output=True, text=True, timeout=60, check=True
            )
            assert done.stdout.startswith("plotfeed/north/")
            assert len(done.stdout.splitlines()) == 2
        for title in ("Python, paho", "Python, aiomqtt"):
            code = page.get_by_label(title, exact=True).inner_text()
            assert first_line(code).startswith("plotfeed/north/")


def first_line(code: str) -> str:
    """What a program prints first, which has no end of its own."""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        return process.stdout.readline()
    finally:
        process.kill()
        process.communicate()
