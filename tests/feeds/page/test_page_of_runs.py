"""The page of a run as a user starts it: how to listen, a session begun anew, the demonstration.

What the page does and says is held against what the broker delivers.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.chromium import looking, until
from support.command import Running, running
from support.page_beside_broker import Beside
from support.scene_files import radar, scene_file, scene_text
from support.tools import needed
from support.waiting import PATIENCE_S

from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import example
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttMessage, MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

START, START_NS = "2026-01-01T12:00:00.05Z", 1_767_268_800_050_000_000
TURN_NS, SECTORS = 2_000_000_000, 32
Run = tuple[Running, MqttReceiver, "Page"]


@pytest.fixture(scope="module")
def run(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """Of a radar, with another scene beside its own; the last test begins it anew."""
    folder = tmp_path_factory.mktemp("run")
    how: dict[str, Any] = {"more": 'report = ["plots"]', "period_s": 2.0, "sectors": SECTORS}
    scene = scene_file(folder, scene_text(start_utc=START, sensors=radar(**how)))
    other = scene_text(sensors=radar("north", **how), drones="")
    (folder / "other.toml").write_text(other)
    words = ("run", scene, "--page", "127.0.0.1:0", "--speed", 4)
    with (
        running(*words, folder=folder) as process,
        MqttReceiver(process.port("MQTT"), 5, "#") as client,
        looking(browser, f"http://127.0.0.1:{process.port('page')}/") as page,
    ):
        yield process, client, page


def test_what_is_copied_from_the_page_receives_the_sensors_messages(run: Run) -> None:
    process, _, page = run
    port = process.port("MQTT")
    page.get_by_role("button", name="Connect here").first.click()
    until(page, "document.querySelectorAll('#connect-snippets li').length >= 3")
    where = page.locator("#connect-where").inner_text()
    assert f"mqtt://127.0.0.1:{port}" in where
    assert "plotfeed/radar/plots" in where
    line = page.locator("pre", has_text="mosquitto_sub").get_by_text(f"-p {port}")
    command, *words = shlex.split(line.inner_text())
    words = [needed(command), *words, "-C", "2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert done.stdout.startswith("plotfeed/radar/")
    assert len(done.stdout.splitlines()) == 2
    for title in ("Python, paho", "Python, aiomqtt"):
        code = page.get_by_label(title, exact=True).inner_text()
        assert first_line(code).startswith("plotfeed/radar/")


def first_line(code: str) -> str:
    """What a program prints first, which has no end of its own."""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        return process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


def began(client: MqttReceiver, since: int) -> tuple[int, dict[str, Any]]:
    """Where the next session says that it runs, and what."""

    def says_so(message: MqttMessage) -> bool:
        is_of_session = message.topic == "plotfeed/session"
        return is_of_session and json.loads(message.payload)["state"] == "RUNNING"

    said = client.wait_for(says_so, since=since)
    return client.heard.index(said, since), json.loads(said.payload)


def beginning(run: Run) -> dict[int, bytes]:
    """The radar's messages of the first two turns after a restart, by the number of the sector."""
    _, client, page = run
    since = len(client.heard)
    page.get_by_role("button", name="Restart").click()
    at, session = began(client, since)
    assert session["start_utc_ns"] == START_NS
    first = START_NS * SECTORS // TURN_NS

    def number(message: MqttMessage) -> int:
        batch = pb.PlotBatch.FromString(message.payload)
        return batch.scan * SECTORS + batch.sector

    def is_later(message: MqttMessage) -> bool:
        return message.topic == "plotfeed/radar/plots" and number(message) > first + 2 * SECTORS

    client.wait_for(is_later, since=at)
    batches = [m for m in client.heard[at:] if m.topic == "plotfeed/radar/plots"]
    numbers = [number(message) for message in batches]
    assert numbers == sorted(numbers)  # in the scene's own order, from its beginning
    assert first <= numbers[0]
    return {number(m): m.payload for m in batches if number(m) <= first + 2 * SECTORS}


def test_a_restart_begins_the_scene_anew_with_the_same_octets_and_another_has_its_own_topics(
    run: Run,
) -> None:
    _, client, page = run
    first = beginning(run)
    page.get_by_role("button", name="Pause").click()
    until(page, "plotfeed.picture.pace === 0")  # what stands is restarted too, and runs
    again = beginning(run)
    both = first.keys() & again.keys()  # all, unless the machine missed scans
    assert len(both) > 5
    assert {sector: first[sector] for sector in both} == {sector: again[sector] for sector in both}
    scene = page.get_by_label("Scene", exact=True)
    assert scene.locator("option").all_inner_texts() == [*summaries(), "other", "scene"]
    scene.select_option("other")
    since = len(client.heard)
    page.get_by_role("button", name="Load").click()
    at, session = began(client, since)
    assert session["sensors"] == ["north"]
    page.get_by_role("heading", name="north: settings").wait_for()
    for topic in ("plotfeed/north/plots", "plotfeed/truth"):
        client.wait_for(lambda m: m.topic == topic, since=at)  # noqa: B023 - at once
    of_north = {f"plotfeed/north/{kind}" for kind in ("plots", "status", "settings", "description")}
    topics = {m.topic for m in client.heard[at:]}
    assert topics <= of_north | {"plotfeed/session", "plotfeed/truth"}
    assert json.loads(client.on("plotfeed/radar/status")[-1])["state"] == "OFFLINE"


OUTAGE = "Outage of the tower"
# No track is drawn as if it were told of.
SILENT = """() => {
  const { picture, display } = plotfeed, words = display.words.map((w) => w[4]);
  const ids = [...picture.tracks.keys()], aged = words.filter((w) => /^T[0-9]+ [0-9]+ s$/.test(w));
  return ids.length > 0 && aged.length > 0 && !words.some((w) => ids.some((id) => w === `T${id}`));
}"""


def test_the_page_of_the_demonstration_says_what_its_broker_carries(
    browser: Browser, tmp_path: Path
) -> None:
    demo = ("demo", "--page", "127.0.0.1:0")
    with running(*demo, folder=tmp_path) as run, MqttReceiver(run.port("MQTT"), 5, "#") as client:
        url = f"http://127.0.0.1:{run.port('page')}/"
        with looking(browser, url) as page:
            until(page, "plotfeed.picture.tracks.size > 5")
            beside = Beside(page, client, example("field-day"))
            page.wait_for_timeout(2500)
            beside.sample()
            story = page.get_by_role("button", name=OUTAGE, exact=True)
            story.click()
            assert "grow old" in page.locator("#stories").inner_text()
            until(page, SILENT)
            beside.sample()
            assert "link down" in page.locator("#sensors").inner_text()
            story.click()
            topic, so_far = beside.scene.page.tracks_topic, len(client.heard)
            client.wait_for(lambda message: message.topic == topic, since=so_far)
            page.wait_for_timeout(2500)
            beside.sample()
            found = beside.differences()
            assert found["differences"] == []
            assert found["plots_shown"] > 50
            assert found["tracks_compared"] > 15
