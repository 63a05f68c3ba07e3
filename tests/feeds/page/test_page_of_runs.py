"""The page and a whole run: received, shown, recorded, replayed, restarted, of another scene.

What it does and shows is measured on what the broker delivers.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from support.chromium import drawn, until
from support.live_page import MS, SECTORS, START_NS, Live, S, end_ns, live, sectors_within, told
from support.tools import needed
from support.waiting import PATIENCE_S

from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Stage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Of the dark theme, as the style sheet has it: what is under plots.
SEA = np.array([0x0A, 0x16, 0x1F])
STOP = re.compile(r"^Stop \d")  # The button of a recording that runs, with its seconds


GLOW_S = 10.0


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the run is."""
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def shared(browser: Browser, place: Path) -> Iterator[Live]:
    with live(browser, place) as run:
        yield run


@pytest.fixture
def run(shared: Live) -> Iterator[Live]:
    """A run that all tests here use, those that begin it anew last."""
    yield shared
    shared.as_in_the_beginning()


def test_what_is_copied_from_the_page_receives_the_sensors_messages(run: Live) -> None:
    page = run.page
    page.get_by_role("button", name="Connect here").click()
    until(page, "document.querySelectorAll('#connect-snippets li').length >= 3")
    where = page.locator("#connect-where").inner_text()
    assert f"mqtt://127.0.0.1:{run.process.port('MQTT')}" in where
    assert "plotfeed/radar/plots" in where
    line = page.locator("pre", has_text="mosquitto_sub").get_by_text(
        f"-p {run.process.port('MQTT')}"
    )
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


DISPLAYED = """() => {
  const { picture: { plots, lost, droneNames }, display: { view } } = plotfeed, shown = [];
  const canvas = document.getElementById("screen"), context = canvas.getContext("2d");
  const { data, width } = context.getImageData(0, 0, canvas.width, canvas.height);
  const named = (drone) => drone === -1 ? "" : droneNames[drone] ?? "?";
  for (let row = plots.begin; row < plots.end; row++) {
    const at = plots.at(row), x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    const i = 4 * (Math.round(y) * width + Math.round(x));
    shown.push([plots.sensor[at], plots.t_utc_ms[at], x, y, named(plots.drone[at]),
      view.x(plots.true_east_m[at]), view.y(plots.true_north_m[at]), [...data.slice(i, i + 3)]]);
  }
  const gone = [];
  for (let row = lost.begin; row < lost.end; row++)
    gone.push([lost.sensor[lost.at(row)], lost.t_utc_ms[lost.at(row)]]);
  return [shown, gone, { ...view }];
}"""


def test_the_display_shows_each_plot_of_the_ledger_within_a_pixel(run: Live, place: Path) -> None:
    scene = load(place / "scene.toml")
    for layer in ("Cover", "Sweep", "Labels", "Tracks"):
        run.page.get_by_role("checkbox", name=layer).uncheck()
    run.page.get_by_label("Fade").select_option("60")
    run.press("Truth")
    run.ask(Loss="40")
    asked_ns = end_ns(run.broker.ledger()[-1]) + S
    sectors = 3 * SECTORS["radar"]  # in as many turns, if the machine misses none

    def still_shown_ns() -> int:
        """Since when everything is; it fades within 60 s."""
        return max(asked_ns, end_ns(run.broker.ledger()[-1]) - 50 * S)

    def sectors_shown() -> int:
        since_ns = still_shown_ns()
        return sum(end_ns(told) > since_ns for told in run.broker.ledger())

    run.wait(lambda: sectors_shown() > sectors)
    now_ns = run.freeze()
    since_ns = still_shown_ns()
    until(run.page, "ms => plotfeed.picture.nowMs(0) >= ms", now_ns / MS - 0.01)
    drawn(run.page)
    shown, gone, view = run.page.evaluate(DISPLAYED)
    shown = [row for row in shown if row[1] * MS > since_ns]
    expected, lost = plots_of_the_ledger(run, scene, view, since_ns)

    assert sorted(row[:2] for row in gone if row[1] * MS > since_ns) == sorted(lost)
    assert len(lost) > 10
    by_sensor_and_time = sorted(shown, key=lambda row: row[:2])
    expected.sort(key=lambda row: row[:2])
    assert len(expected) > 100
    assert [(*row[:2], row[4]) for row in by_sensor_and_time] == [
        (*row[:2], row[4]) for row in expected
    ]
    places = np.array([row[2:4] for row in by_sensor_and_time])
    assert np.hypot(*(places - [row[2:4] for row in expected]).T).max() < 1
    of_drones = [k for k, row in enumerate(expected) if row[4]]
    true = np.array([by_sensor_and_time[k][5:7] for k in of_drones])
    assert np.hypot(*(true - [expected[k][5:7] for k in of_drones]).T).max() < 1
    # Something is drawn where they are.
    pixels = np.array([row[7] for row in by_sensor_and_time])
    assert (np.abs(pixels - SEA).max(axis=1) > 10).mean() > 0.97


def plots_of_the_ledger(
    run: Live, scene: Scene, view: dict[str, float], since_ns: int
) -> tuple[list[list[Any]], list[list[Any]]]:
    """Rows as `DISPLAYED` has them of plots that were measured since then, and of lost ones."""
    shown: list[list[Any]] = []
    lost: list[list[Any]] = []
    site = scene.scene.site
    for number, sensor in enumerate(scene.sensor):
        frame = frame_at(site, sensor.position_enu_m)

        def place(plot: Any, frame: LocalFrame = frame) -> list[float]:
            local_m = aer_to_enu(plot.azimuth_deg, plot.elevation_deg, plot.range_m)
            east_m, north_m, _ = site_frame(site).from_ecef(frame.to_ecef(local_m))
            x = view["width"] / 2 + (east_m - view["east"]) / view["scale"]
            return [x, view["height"] / 2 - (north_m - view["north"]) / view["scale"]]

        batches = {(x.scan, x.sector): x.plots for x in run.broker.batches(sensor.id)}
        for entry in run.broker.ledger(sensor.id):
            if end_ns(entry) <= since_ns:
                continue
            came = entry.messages[0].delivered
            measured = batches[entry.scan, entry.sector] if came else entry.plots
            for plot, truth in zip(measured, entry.plots, strict=True):
                if truth.time_utc_ns <= since_ns:
                    continue
                row = [number, float(truth.time_utc_ns) / 1e6]  # to the last bit
                if came:
                    shown.append([*row, *place(plot), truth.drone, *place(truth)])
                else:
                    lost.append(row)
    return shown, lost


def test_a_recording_holds_what_the_broker_delivered_meanwhile(run: Live, place: Path) -> None:
    run.press("Record")
    since = run.broker.count
    run.wait(lambda: len(run.broker.batches(since=since)) > 600)
    running = stop_recording(run, place)
    # While time runs, message after message, without a gap.
    for topic, payloads in running.items():
        heard = run.broker.client.on(topic)
        first = heard.index(payloads[0])
        run.wait(lambda: len(run.broker.client.on(topic)) >= first + len(payloads))  # noqa: B023
        heard = run.broker.client.on(topic)
        assert heard[first : first + len(payloads)] == payloads
    assert len(running["plotfeed/radar/plots"]) > 500

    # From one stand of time to another, exactly those.
    run.set_speed(1)
    run.freeze()
    run.press("Record")
    run.page.get_by_role("button", name=STOP).wait_for()
    since = run.broker.count
    run.step()
    stepped = stop_recording(run, place)
    heard = run.broker.client.heard[since:]
    topics = {message.topic for message in heard}
    assert stepped == {t: [m.payload for m in heard if m.topic == t] for t in topics}
    kinds = {"radar/plots", "gate/plots", "truth"}
    assert topics >= {f"plotfeed/{kind}" for kind in kinds}


def stop_recording(run: Live, folder: Path) -> dict[str, list[bytes]]:
    """Payloads that left, by topic, as they stand in the file, which is taken out of the way.

    A file begins with the sensors' settings, which whoever came to the broker had before: those
    are the same, and left out.
    """
    run.page.get_by_role("button", name=STOP).click()
    run.page.get_by_role("button", name="Record", exact=True).wait_for()
    (path,) = folder.glob("*.mcap")
    found: dict[str, list[bytes]] = {}
    with McapReader(path) as log:
        assert not log.damage
        for message in log.messages(stages=[Stage.AFTER]):
            found.setdefault(message.topic, []).append(message.payload)
    path.unlink()
    for topic in [topic for topic in found if topic.endswith("/description")]:
        (payload,) = found.pop(topic)
        assert json.loads(payload) == run.broker.on(topic)[-1][1]
    for topic in [topic for topic in found if topic.endswith("/settings")]:
        (payload,) = found.pop(topic)
        assert json.loads(payload)["in_force"] == run.broker.on(topic)[-1][1]["in_force"]
    return found


SHOWN = """() => {
  const { picture: { plots } } = plotfeed, shown = [];
  for (let row = plots.begin; row < plots.end; row++)
    shown.push([plots.sensor[plots.at(row)], plots.t_utc_ms[plots.at(row)]]);
  return shown.sort((a, b) => a[1] - b[1]);
}"""


class Told(NamedTuple):
    """What a recording holds, with the times at which it left."""

    start_ns: int
    # Entries of sectors that were handed over since it began: of others there are no plots.
    ledger: list[tuple[int, pb.Ledger]]
    sectors: list[tuple[int, tuple[int, int]]]  # Scans and sectors of the radar of which plots left


def recorded(run: Live, folder: Path) -> Told:
    """What was recorded from the page, at a pace at which busy machines miss no scan."""
    run.set_speed(2)
    run.press("Record")
    since = run.broker.count
    run.wait(lambda: len(run.broker.batches(since=since)) > 400)
    run.page.get_by_role("button", name=STOP).click()
    (path,) = folder.glob("*.mcap")
    until(run.page, "(name) => plotfeed.picture.news.session.recordings.join() === name", path.name)
    with McapReader(path) as log:
        start_ns = log.summary().start_ns
        messages = list(log.messages())
    assert start_ns
    batches = [
        (m.log_time_ns, m.stage, pb.PlotBatch.FromString(m.payload))
        for m in messages
        if m.topic.endswith("/plots")
    ]
    handed_over = {(b.sensor, b.scan, b.sector) for _, stage, b in batches if stage == Stage.BEFORE}
    entries = [
        (m.log_time_ns, entry)
        for m in messages
        if m.topic == "plotfeed/truth" and m.stage == Stage.AFTER
        for entry in entries_in(m.payload)
    ]
    return Told(
        start_ns,
        [(at_ns, e) for at_ns, e in entries if (e.sensor, e.scan, e.sector) in handed_over],
        [
            (at_ns, (b.scan, b.sector))
            for at_ns, stage, b in batches
            if stage == Stage.AFTER and b.sensor == "radar"
        ],
    )


def test_a_recording_is_loaded_moved_along_and_left(run: Live, place: Path) -> None:
    start_ns, entries, sectors = recorded(run, place)
    page = run.page
    run.press("Replay")
    until(page, "plotfeed.picture.news.session.replay.position_s > 0.3")
    assert page.get_by_role("button", name="Record", exact=True).is_disabled()
    page.get_by_text("Times are those of the recording").wait_for()

    # In a pause, moved along: what has not faded there, and nothing is sent.
    page.locator("#replay-pause").click()
    page.locator("#replay-pause").get_by_text("Play").wait_for()
    run.settle()
    heard = run.broker.count
    second = 0.0
    for share in (0.7, 0.8, 0.5):
        second = round((entries[int(share * len(entries))][0] - start_ns) / S, 1)
        page.get_by_label("Position in the recording").fill(str(second))
        now_ms = (start_ns + second * S) / MS
        until(page, "ms => Math.abs(plotfeed.picture.nowMs(0) - ms) < 0.1", now_ms)
        wanted = [
            [int(entry.sensor == "gate"), float(plot.time_utc_ns) / MS]
            for at_ns, entry in entries
            if now_ms - 1000 * GLOW_S < at_ns / MS <= now_ms and entry.messages[0].delivered
            for plot in entry.plots
        ]
        assert len(wanted) > 20
        shown = page.evaluate(SHOWN)
        first_ms = now_ms - 1000 * GLOW_S
        assert [row for row in shown if row[1] > first_ms] == sorted(
            (row for row in wanted if row[1] > first_ms), key=lambda row: row[1]
        )
    assert run.broker.count == heard

    # Going on: the messages of there.
    page.locator("#replay-pause").click()
    run.wait(lambda: len(run.broker.batches(since=heard)) > 30)
    from_ns = start_ns + round(second * S)
    from_there = {sector for at_ns, sector in sectors if at_ns >= from_ns}
    assert not told(run.broker.batches(since=heard)) - from_there
    assert not run.broker.ledger(since=heard)

    page.locator("#replay-stop").click()
    page.get_by_text("no replay").wait_for()
    left = run.broker.count
    run.wait(lambda: run.broker.ledger(since=left))
    assert page.get_by_role("button", name="Record", exact=True).is_enabled()


def test_a_restart_begins_the_scene_anew_with_the_same_octets(run: Live) -> None:
    first = beginning(run)
    run.freeze()  # a session that stands is restarted too, and runs
    again = beginning(run)
    both = first.keys() & again.keys()  # all, unless the machine missed scans
    assert len(both) > 20
    assert {place: first[place] for place in both} == {place: again[place] for place in both}


def begun(run: Live, since: int) -> tuple[int, dict[str, Any]]:
    """Where the next session says that it runs, and what."""

    def said() -> list[tuple[int, dict[str, Any]]]:
        news = run.broker.on("plotfeed/session", since)
        return [(at, session) for at, session in news if session["state"] == "RUNNING"]

    run.wait(said)
    return said()[0]


def beginning(run: Live) -> dict[tuple[int, int], bytes]:
    """The first of the radar's messages after a restart, by scan and sector."""
    since = run.broker.count
    run.press("Restart")
    at, session = begun(run, since)
    assert session["start_utc_ns"] == START_NS
    run.wait(lambda: len(run.broker.batches(since=at)) >= 200)
    batches = run.broker.batches(since=at)[:200]
    places = [(batch.scan, batch.sector) for batch in batches]
    # In the scene's own order, from its beginning; a busy machine may miss some.
    assert places == sorted(places)
    assert set(places) <= set(sectors_within("radar", START_NS, START_NS + 60 * S))
    return {(batch.scan, batch.sector): batch.SerializeToString() for batch in batches}


def test_another_scene_has_its_own_topics_alone(shared: Live) -> None:
    run = shared  # which is of that scene from now on
    scene = run.page.get_by_label("Scene", exact=True)
    assert scene.locator("option").all_inner_texts() == [*summaries(), "other", "scene"]
    scene.select_option("other")
    since = run.broker.count
    run.press("Load")
    at, session = begun(run, since)
    assert session["sensors"] == ["north"]
    run.page.get_by_role("heading", name="north: settings").wait_for()
    run.wait(lambda: len(run.broker.batches("north", at)) >= 20 and bool(truths(run, at)))
    topics = {m.topic for m in run.broker.client.heard[at:]}
    of_north = {f"plotfeed/north/{kind}" for kind in ("plots", "status", "settings", "description")}
    assert topics <= of_north | {"plotfeed/session", "plotfeed/truth"}
    assert run.broker.on("plotfeed/radar/status")[-1][1]["state"] == "OFFLINE"
    assert {x.sensor for payload in truths(run, at) for x in entries_in(payload)} == {"north"}


def truths(run: Live, since: int) -> list[bytes]:
    return [m.payload for m in run.broker.client.heard[since:] if m.topic == "plotfeed/truth"]
