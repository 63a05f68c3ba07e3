"""The page and a whole run: sensors and the clock changed, and begun anew.

What the page does is measured on what the broker delivers.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.chromium import until
from support.live_page import SECTORS, SPEED, START_NS, Live, S, end_ns, live, sectors_within
from support.tools import needed
from support.waiting import PATIENCE_S

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.sensors.polar_radar_keys import ActiveRadarKeys
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MS = 1_000_000


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the run is."""
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def run(browser: Browser, place: Path) -> Iterator[Live]:
    """A run that all tests here use, those that begin it anew last."""
    with live(browser, place) as run:
        yield run


def test_what_is_copied_from_the_page_receives_the_sensors_messages(run: Live) -> None:
    page, port = run.page, run.process.port("MQTT")
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


def test_what_is_asked_of_a_sensor_is_what_its_messages_meet_until_it_is_taken_back(
    run: Live,
) -> None:
    page = run.page

    def ask(**fields: str) -> dict[str, Any]:
        for label, value in fields.items():
            page.get_by_label(label.replace("_", " "), exact=True).fill(value)
        return run.settings_after(lambda: run.press("Apply"))[1]["in_force"]

    def choose(state: str) -> tuple[int, dict[str, Any]]:
        radio = page.get_by_role("radio", name=state, exact=True)
        since, told = run.settings_after(radio.check)
        return since, told["in_force"]

    _, usual = run.settings_after(lambda: run.press("As in the scene"))
    assert ask(Latency="400")["link"] == {"latency_ms": 400.0}
    run.wait(lambda: len(run.sent({"latency_ms": 400.0})) >= 20)
    for message in run.sent({"latency_ms": 400.0}):
        assert message.link_due_utc_ns - message.due_utc_ns == 400 * MS
        assert message.sent_utc_ns >= message.link_due_utc_ns
    loss = {"kind": "gilbert-elliott", "mean_loss": 0.4, "mean_burst": 4.0}
    asked = {"latency_ms": 400.0, "loss": loss}
    assert ask(Loss="40", Mean_burst="4")["link"] == asked
    run.wait(lambda: {m.fate for m in run.sent(asked)} >= {pb.LOST, pb.SENT})
    lost = {x.number for x in run.sent(asked) if x.fate == pb.LOST}
    assert lost
    _, told = run.settings_after(lambda: run.press("As in the scene"))
    assert (told["controlled"], told["in_force"]) == ({}, usual["in_force"])
    _, degraded = choose("Degraded")
    assert degraded["pfa"] == pytest.approx(10 * usual["in_force"]["pfa"])
    assert degraded["loss_db"] == ActiveRadarKeys.model_fields["loss_db"].default + 6.0
    since, off = choose("Off")
    assert off["enabled"] is False
    off_ns = round(page.evaluate("plotfeed.picture.nowMs(performance.now())") * MS)
    run.wait(lambda: len(run.batches("gate", since)) > SECTORS)
    assert max(map(end_ns, run.ledger())) <= off_ns + AHEAD_NS + S
    run.wait(lambda: not run.on("plotfeed/radar/status")[-1][1].get("enabled"))
    since, _ = choose("On")
    run.wait(lambda: len(run.batches(since=since)) > 5)


def test_nothing_comes_in_a_pause_a_step_is_all_that_lies_in_it_and_time_runs_as_asked(
    run: Live,
) -> None:
    def set_speed(speed: int) -> None:
        run.page.get_by_label("Speed").select_option(str(speed))
        until(run.page, f"plotfeed.picture.news.session.clock.speed === {speed}")

    set_speed(1)  # so that no machine is so slow that it misses a scan
    run.press("Pause")
    run.button("Go on").wait_for()
    now_ns = run.standing()
    run.settle()
    since = run.count
    run.page.wait_for_timeout(1000)
    assert run.count == since
    for _ in range(2):
        since, before_ns = run.count, now_ns
        run.press("Step 1 s")
        run.wait(lambda: run.standing() > before_ns + S - MS)  # noqa: B023 - at once
        now_ns = run.standing()
        assert now_ns - before_ns == pytest.approx(S, abs=1000)
        run.settle()
        expected = sectors_within(before_ns, now_ns)
        for sensor in ("radar", "gate"):
            for messages in (run.batches, run.ledger):
                assert [(x.scan, x.sector) for x in messages(sensor, since)] == expected
    set_speed(SPEED)
    since = run.count
    run.press("Go on")
    run.wait(lambda: run.batches(since=since))
    first = run.batches(since=since)[0]
    assert (first.scan, first.sector) == sectors_within(now_ns, now_ns + S)[0]
    run.wait(lambda: run.on("plotfeed/session")[-1][1].get("speed") == SPEED)


def begun(run: Live, since: int) -> tuple[int, dict[str, Any]]:
    """Where the next session says that it runs, and what."""

    def said() -> list[tuple[int, dict[str, Any]]]:
        news = run.on("plotfeed/session", since)
        return [(at, session) for at, session in news if session["state"] == "RUNNING"]

    run.wait(said)
    return said()[0]


def beginning(run: Live) -> dict[tuple[int, int], bytes]:
    """The first of the radar's messages after a restart, by scan and sector."""
    since = run.count
    run.press("Restart")
    at, session = begun(run, since)
    assert session["start_utc_ns"] == START_NS
    run.wait(lambda: len(run.batches(since=at)) >= 40)
    batches = run.batches(since=at)[:40]
    places = [(batch.scan, batch.sector) for batch in batches]
    # In the scene's own order, from its beginning; a busy machine may miss some.
    assert places == sorted(places)
    assert set(places) <= set(sectors_within(START_NS, START_NS + 60 * S))
    return {(batch.scan, batch.sector): batch.SerializeToString() for batch in batches}


def test_a_restart_begins_the_scene_anew_with_the_same_octets_and_another_has_its_own_topics(
    run: Live,
) -> None:
    first = beginning(run)
    run.press("Pause")
    run.standing()  # a session that stands is restarted too, and runs
    again = beginning(run)
    both = first.keys() & again.keys()  # all, unless the machine missed scans
    assert len(both) > 5
    assert {place: first[place] for place in both} == {place: again[place] for place in both}
    scene = run.page.get_by_label("Scene", exact=True)
    assert scene.locator("option").all_inner_texts() == [*summaries(), "other", "scene"]
    scene.select_option("other")
    since = run.count
    run.press("Load")
    at, session = begun(run, since)
    assert session["sensors"] == ["north"]
    run.page.get_by_role("heading", name="north: settings").wait_for()
    run.wait(lambda: len(run.batches("north", at)) >= 5 and run.ledger("north", at))
    of_north = {f"plotfeed/north/{kind}" for kind in ("plots", "status", "settings", "description")}
    topics = {m.topic for m in run.client.heard[at:]}
    assert topics <= of_north | {"plotfeed/session", "plotfeed/truth"}
    assert run.on("plotfeed/radar/status")[-1][1]["state"] == "OFFLINE"
    assert not run.ledger(since=at)
