"""The page and whole runs: restarted, another scene, recorded, shown, gone and come back.

What it does and shows is measured on what the broker delivers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.brokers import free_port
from support.chromium import looking, new_context, requests, until
from support.live_page import (
    MS,
    SECTORS,
    START_NS,
    Live,
    S,
    end_ns,
    heard,
    live,
    scene_of_two,
    sectors_within,
)
from support.scene_files import scene_file

from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Stage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SEA = np.array([0x0A, 0x16, 0x1F])
"""Of the dark theme, as the style sheet has it: what is under plots."""
STOP = re.compile(r"^Stop \d")
"""The button of a recording that runs, with its seconds."""


@pytest.fixture
def run(browser: Browser, tmp_path: Path) -> Iterator[Live]:
    with live(browser, tmp_path) as run:
        yield run


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


def test_another_scene_has_its_own_topics_alone(run: Live, tmp_path: Path) -> None:
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
    assert {x.sensor for x in map(pb.Ledger.FromString, truths(run, at))} == {"north"}


def truths(run: Live, since: int) -> list[bytes]:
    return [m.payload for m in run.broker.client.heard[since:] if m.topic == "plotfeed/truth"]


def test_a_recording_holds_what_the_broker_delivered_meanwhile(run: Live, tmp_path: Path) -> None:
    run.press("Record")
    since = run.broker.count
    run.wait(lambda: len(run.broker.batches(since=since)) > 600)
    running = stop_recording(run, tmp_path)
    # While time runs, message after message, without a gap.
    for topic, payloads in running.items():
        heard = run.broker.client.on(topic)
        first = heard.index(payloads[0])
        assert heard[first : first + len(payloads)] == payloads
    assert len(running["plotfeed/radar/plots"]) > 500

    # From one stand of time to another, exactly those.
    run.set_speed(1)
    run.freeze()
    run.press("Record")
    run.page.get_by_role("button", name=STOP).wait_for()
    since = run.broker.count
    run.step()
    stepped = stop_recording(run, tmp_path)
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


def test_the_display_shows_each_plot_of_the_ledger_within_a_pixel(
    run: Live, tmp_path: Path
) -> None:
    scene = load(scene_file(tmp_path, scene_of_two()))
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
    run.page.wait_for_timeout(1000)  # marks are drawn again at least that often
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


def test_the_page_comes_back_by_itself_when_the_run_does(browser: Browser, tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    context = new_context(browser)
    page = context.new_page()
    with heard(tmp_path, page=address) as (run, broker):
        page.goto(f"http://{address}/")
        until(page, "plotfeed.picture.plots.end > 0")
        run.process.kill()
        page.locator("#veil").get_by_text("Connection lost").wait_for()
        broker.client.wait_until_cut_off()
    with heard(tmp_path, page=address) as (_, broker):
        page.locator("#veil").wait_for(state="hidden")
        page.get_by_text("Connected").wait_for()
        until(page, "plotfeed.picture.plots.end > 0")
        again = Live(page, broker)
        again.ask(Latency="250")
        again.wait(lambda: len(broker.sent({"latency_ms": 250.0})) >= 10)
    context.close()


def test_what_one_browser_changes_the_other_shows_and_the_broker_tells(
    browser: Browser, run: Live
) -> None:
    with looking(browser, run.page.url) as page:
        other = Live(page, run.broker)
        run.ask(Latency="333", Loss="10")
        page.locator("#latency-now").get_by_text("333 ms").wait_for()
        page.locator("#loss-now").get_by_text("10 %").wait_for()
        other.ask(Jitter="20")
        run.page.locator("#jitter-now").get_by_text("20 ms").wait_for()
        random = {"kind": "random", "probability": 0.1}
        asked = {"latency_ms": 333.0, "jitter_ms": 20.0, "loss": random}
        run.wait(lambda: len(run.broker.sent(asked)) >= 10)
        other.choose("Off")
        run.page.locator("#sensors tr").first.get_by_text("off").wait_for()
        run.choose("On")
        page.locator("#sensors tr").first.get_by_text("on", exact=True).wait_for()
        run.press("Pause")
        page.get_by_role("button", name="Go on").wait_for()
        other.press("Go on")
        run.page.get_by_role("button", name="Pause").first.wait_for()


def test_no_request_of_the_page_leaves_the_machine(browser: Browser, tmp_path: Path) -> None:
    context = new_context(browser)
    page = context.new_page()
    asked = requests(context, page)
    with heard(tmp_path) as (process, broker):
        host = f"127.0.0.1:{process.port('page')}"
        page.goto(f"http://{host}/")
        until(page, "plotfeed.picture.plots.end > 0")
        run = Live(page, broker)
        for name in ("Truth", "Light", "Zoom in", "Show all sensors", "Pause", "Step 1 s", "Go on"):
            run.press(name)
        run.ask(Latency="10")
        run.press("Restart")
        page.get_by_label("Scene", exact=True).select_option("other")
        run.press("Load")
        page.get_by_role("heading", name="north: settings").wait_for()
        until(page, "plotfeed.picture.plots.end > 0")
        context.close()
    assert f"ws://{host}/feed" in asked
    assert len(asked) > 10
    assert not [url for url in asked if not url.startswith((f"http://{host}/", f"ws://{host}/"))]
