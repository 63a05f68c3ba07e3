from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import page_stage
import pytest
import road
from chromium import axe, looking, new_context, requests, until
from mqtt_client import PATIENCE_S
from page_frames import read_frame
from page_server import Served, on_stage
from page_stage import Stage

from plotfeed.feeds.page.access import PageAddress
from plotfeed.feeds.page.basemap import Basemap
from plotfeed.feeds.page.frames import LAYOUTS, Kind
from plotfeed.feeds.page.view import View
from plotfeed.feeds.places import frame_at
from plotfeed.models.frames import aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NS = road.NS
SEA = np.array([0x0A, 0x16, 0x1F])
SENSOR_COLOURS = np.array([[0x4F, 0xE0, 0xA6], [0xFF, 0xB1, 0x4A]])
"""Of the dark theme, as the style sheet has them: what is under plots, the first two sensors."""
SIZES = ((1280, 720), (1440, 900), (1920, 1080), (2560, 1440))


@pytest.fixture
def stage() -> Stage:
    stage = Stage(View(), page_stage.scene(16))
    for _ in range(40):
        stage.advance(stage.now_ns + NS // 10)
    return stage


@pytest.fixture
def served(stage: Stage) -> Iterator[Served]:
    with on_stage(stage) as served:
        yield served


@pytest.fixture
def page(browser: Browser, served: Served) -> Iterator[Page]:
    with looking(browser, served.url) as page:
        yield page


def freeze(page: Page, stage: Stage) -> None:
    """Let time stand still, and the page know it."""
    page.get_by_role("button", name="Pause").first.click()
    until(page, "plotfeed.picture.pace === 0")
    until(page, "ms => plotfeed.picture.nowMs(0) >= ms - 0.01", stage.now_ns / 1e6)


def wait_for_command(page: Page, stage: Stage, expected: dict[str, Any]) -> None:
    for _ in range(int(PATIENCE_S * 20)):
        if expected in stage.commands:
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"{expected} never came; there were {stage.commands}")


def test_the_browser_reads_frames_as_they_were_written(page: Page) -> None:
    page.evaluate(
        """() => {
          const { feed, reader } = plotfeed, take = feed.onFrame;
          globalThis.caught = [];
          feed.onFrame = (buffer) => {
            const sections = reader.read(buffer).sections.filter((s) => s.columns);
            const octets = Array.from(new Uint8Array(buffer), (o) => String.fromCharCode(o));
            const plain = (c) => Object.entries(c).map(([n, v]) => [n, Array.from(v, String)]);
            globalThis.caught.push([btoa(octets.join("")), sections.map((s) =>
              [s.kind, s.rows, s.first, plain(s.columns)])]);
            take(buffer);
          };
        }"""
    )
    page.get_by_role("button", name="Truth").click()
    until(page, "new Set(caught.flatMap((c) => c[1].map((s) => s[0]))).size >= 4")
    seen = set()
    for octets, sections in page.evaluate("caught"):
        written = [s for s in read_frame(base64.b64decode(octets)).sections if s.columns]
        assert [(s.kind, s.rows, s.first) for s in written] == [tuple(s[:3]) for s in sections]
        for section, (kind, _, _, columns) in zip(written, sections, strict=True):
            seen.add(kind)
            for name, values in columns:
                read = np.array(values, dtype=np.float64)
                np.testing.assert_array_equal(read, section.columns[name].astype(np.float64))
    assert seen >= {Kind.PLOTS, Kind.PLOT_TRUTHS, Kind.DRONES, Kind.TRACKS} <= LAYOUTS.keys()


def delivered_plots(stage: Stage) -> dict[str, list[tuple[float, float, float]]]:
    """Time, milliseconds, east and north of plots with a place, as the messages say, by sensor."""
    frames = {s.id: frame_at(stage.scene.scene.site, s.position_enu_m) for s in stage.scene.sensor}
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in frames}
    for message in stage.messages:
        if not message.topic.endswith("/plots"):
            continue
        batch = pb.PlotBatch.FromString(message.payload)
        for plot in batch.plots:
            if plot.HasField("range_m"):
                local_m = aer_to_enu(plot.azimuth_deg, plot.elevation_deg, plot.range_m)
                enu_m = road.SITE.from_ecef(frames[batch.sensor].to_ecef(local_m))
                found[batch.sensor].append((plot.time_utc_ns / 1e6, enu_m[0], enu_m[1]))
    return found


def test_every_plot_that_was_delivered_is_shown_within_a_pixel(page: Page, stage: Stage) -> None:
    for layer in ("Cover", "Sweep", "Labels", "Tracks"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_label("Fade").select_option("30")
    freeze(page, stage)
    page.wait_for_timeout(600)  # marks are drawn again at least that often
    shown, view, ids, pixels = page.evaluate(
        """() => {
          const { picture: { plots, news }, display: { view } } = plotfeed, shown = [];
          const canvas = document.getElementById("screen"), context = canvas.getContext("2d");
          const { data, width } = context.getImageData(0, 0, canvas.width, canvas.height);
          const pixels = [];
          for (let row = plots.begin; row < plots.end; row++) {
            const at = plots.at(row);
            if (plots.flags[at]) continue;
            const x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
            shown.push([plots.sensor[at], plots.t_utc_ms[at], x, y]);
            const i = 4 * (Math.round(y) * width + Math.round(x));
            pixels.push([data[i], data[i + 1], data[i + 2]]);
          }
          return [shown, { ...view }, news.scene.sensors.map((s) => s.id), pixels];
        }"""
    )
    lost = read_frame(b"".join(stage.view.snapshot(stage.now_ns)[:2]))  # type: ignore[union-attr]
    expected = delivered_plots(stage)
    assert len(shown) + len(lost.column(Kind.LOST_PLOTS, "flags")) == sum(
        map(len, expected.values())
    )
    assert len(shown) > 50
    for sensor, t_ms, x, y in shown:
        times_ms, east_m, north_m = np.array(expected[ids[sensor]]).T
        expected_x = view["width"] / 2 + (east_m - view["east"]) / view["scale"]
        expected_y = view["height"] / 2 - (north_m - view["north"]) / view["scale"]
        off = np.hypot(expected_x - x, expected_y - y)[np.abs(times_ms - t_ms) < 0.01]
        assert off.min() < 1
    # Where a plot is, its sensor's colour lies over the ground, however faded.
    drawn = np.array(pixels) - SEA
    colour = np.array([SENSOR_COLOURS[sensor] for sensor, *_ in shown]) - SEA
    share = (drawn * colour).sum(axis=1) / (colour**2).sum(axis=1)
    off = np.abs(drawn - share[:, None] * colour).max(axis=1)
    assert (share > 0.1).mean() > 0.97
    assert np.quantile(off, 0.8) < 6  # the others lie over a ring, or over each other


def test_the_truth_is_hidden_until_it_is_asked_for(page: Page) -> None:
    truth = page.get_by_role("button", name="Truth")
    assert truth.get_attribute("aria-pressed") == "false"
    until(page, "plotfeed.picture.framesTaken > 5")
    known = "plotfeed.picture.drones !== null || plotfeed.picture.droneNames.length > 0"
    assert not page.evaluate(known)
    assert "false alarm" not in page.get_by_label("Marks").inner_text()
    truth.click()
    until(page, "plotfeed.picture.drones?.rows === 16")
    until(page, "plotfeed.picture.plots.drone.some((d) => d === -1)")
    assert "false alarm" in page.get_by_label("Marks").inner_text()
    truth.click()
    until(page, f"!({known})")
    assert not page.evaluate("plotfeed.picture.plots.drone.some((d) => d >= -1 && d !== 0)")


FORM_COMMANDS = [
    ({"Latency": "250"}, {"link": {"latency_ms": 250}}),
    ({"Jitter": "12.5"}, {"link": {"jitter_ms": 12.5}}),
    ({"Loss": "2"}, {"link": {"loss": {"kind": "random", "probability": 0.02}}}),
    (
        {"Loss": "2", "Mean burst": "4"},
        {"link": {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.02, "mean_burst": 4}}},
    ),
    ({"Loss": "0"}, {"link": {"loss": None}}),
    ({"Pfa": "1e-4"}, {"pfa": 1e-4}),
    ({"Pfa": "1e-7", "Latency": "0"}, {"pfa": 1e-7, "link": {"latency_ms": 0}}),
]


def test_what_is_filled_in_is_asked_of_the_sensor_and_then_in_force(
    page: Page, stage: Stage
) -> None:
    for fields, expected in FORM_COMMANDS:
        for label, value in fields.items():
            page.get_by_label(label, exact=True).fill(value)
        page.get_by_role("button", name="Apply").click()
        wait_for_command(page, stage, {"sensor": "radar", "set": expected})
        page.get_by_text("In force.").wait_for()
        if "Latency" in fields:
            page.locator("#latency-now").get_by_text(f"{fields['Latency']} ms").wait_for()
        page.get_by_role("button", name="As in the scene").click()
        wait_for_command(page, stage, {"sensor": "radar", "reset": True})
        page.locator("#latency-now").get_by_text("120 ms").wait_for()
        stage.commands.clear()


def test_what_is_filled_in_while_an_answer_is_on_its_way_is_kept(page: Page, stage: Stage) -> None:
    page.evaluate(
        """() => {
          const { feed } = plotfeed, ask = feed.ask.bind(feed), held = [];
          globalThis.held = held;
          feed.ask = async (command) => {
            const answer = await ask(command);
            await new Promise((arrives) => held.push(arrives));
            return answer;
          };
        }"""
    )
    answer = page.locator("#answer")
    latency, loss = (page.get_by_label(name, exact=True) for name in ("Latency", "Loss"))

    def press(name: str) -> None:
        page.get_by_role("button", name=name).click()
        until(page, "held.length === 1")

    def let_the_answer_arrive() -> None:
        answer.evaluate("(element) => { element.textContent = ''; }")
        page.evaluate("held.pop()()")
        answer.get_by_text("In force.").wait_for()

    latency.fill("250")
    loss.fill("1")
    press("Apply")
    loss.fill("2")
    let_the_answer_arrive()
    press("Apply")
    let_the_answer_arrive()
    of_loss = {"link": {"loss": {"kind": "random", "probability": 0.02}}}
    assert stage.commands[-1] == {"sensor": "radar", "set": of_loss}
    press("As in the scene")
    loss.fill("3")
    let_the_answer_arrive()
    assert (latency.input_value(), loss.input_value()) == ("120", "3")


def test_a_field_that_somebody_is_in_changes_when_he_leaves_it(page: Page) -> None:
    latency = page.get_by_label("Latency", exact=True)
    latency.focus()
    page.evaluate("plotfeed.feed.ask({ sensor: 'radar', set: { link: { latency_ms: 77 } } })")
    page.locator("#latency-now").get_by_text("77 ms").wait_for()
    assert latency.input_value() == "120"
    latency.blur()
    assert latency.input_value() == "77"


def test_each_button_says_what_it_says(page: Page, stage: Stage) -> None:
    for name, expected in [
        ("Pause", {"clock": {"paused": True}}),
        ("Step 1 s", {"clock": {"step_s": 1}}),
        ("Go on", {"clock": {"paused": False}}),
        ("Restart", {"session": {"restart": True}}),
        ("Record", {"record": {"start": True}}),
        ("Stop 0:00.0", {"record": {"stop": True}}),
        ("Load", {"session": {"scene": "road"}}),
        ("Replay", {"replay": {"load": "morning.mcap"}}),
        ("As in the scene", {"sensor": "radar", "reset": True}),
    ]:
        page.get_by_role("button", name=name, exact=True).first.click()
        wait_for_command(page, stage, expected)
        page.wait_for_timeout(150)
    page.get_by_label("Speed").select_option("10")
    wait_for_command(page, stage, {"clock": {"speed": 10}})


def test_a_sensor_is_switched_off_degraded_and_on_again(page: Page, stage: Stage) -> None:
    own = stage.scene.sensor[0]
    page.get_by_role("radio", name="Degraded").check()
    worse = {"enabled": True, "pfa": 1e-4, "loss_db": 10}
    wait_for_command(page, stage, {"sensor": "radar", "set": worse})
    state = page.locator("#sensors tr").first.locator("td").last
    state.get_by_text("degraded").wait_for()
    page.get_by_role("radio", name="Off").check()
    wait_for_command(page, stage, {"sensor": "radar", "set": {"enabled": False}})
    state.get_by_text("off").wait_for()
    page.get_by_role("radio", name="On", exact=True).check()
    as_before = {"enabled": True, "pfa": 1e-5, "loss_db": 4}
    wait_for_command(page, stage, {"sensor": "radar", "set": as_before})
    state.get_by_text("on").wait_for()
    assert stage.sensors["radar"].pfa == own.pfa  # type: ignore[union-attr]


def test_another_sensor_is_chosen_hidden_and_asked(page: Page, stage: Stage) -> None:
    page.get_by_role("button", name="gate").click()
    page.get_by_role("heading", name="gate: settings").wait_for()
    assert page.get_by_label("Loss", exact=True).input_value() == "5"
    assert page.get_by_label("Mean burst").input_value() == "3"
    page.get_by_label("Latency", exact=True).fill("80")
    page.get_by_label("Latency", exact=True).press("Enter")
    wait_for_command(page, stage, {"sensor": "gate", "set": {"link": {"latency_ms": 80}}})
    page.get_by_role("checkbox", name="Show gate").uncheck()
    assert page.evaluate("[...plotfeed.display.hidden]") == ["gate"]
    until(page, "'gate' in (plotfeed.picture.news.details ?? {})")


def test_a_recording_is_scrubbed(page: Page, stage: Stage) -> None:
    page.get_by_role("button", name="Replay", exact=True).click()
    position = page.get_by_label("Position in the recording")
    until(page, "!document.getElementById('position').disabled")
    position.fill("12.5")
    wait_for_command(page, stage, {"replay": {"position_s": 12.5}})
    page.locator("#replay-pause").click()
    wait_for_command(page, stage, {"replay": {"paused": True}})
    page.get_by_text("0:12.5 / 1:30.0").wait_for()
    page.get_by_role("button", name="10 s ahead").click()
    page.get_by_text("0:22.5 / 1:30.0").wait_for()
    page.get_by_role("button", name="10 s back").click()
    page.get_by_text("0:12.5 / 1:30.0").wait_for()
    page.locator("#replay-stop").click()
    wait_for_command(page, stage, {"replay": {"stop": True}})
    page.get_by_text("no replay").wait_for()


def test_a_leap_shows_another_time_and_leaves_the_display_where_it_is(
    page: Page, stage: Stage, served: Served
) -> None:
    page.get_by_role("application").press("+")
    page.get_by_role("application").press("n")
    page.get_by_text("Plot of").wait_for()
    view = page.evaluate("({ ...plotfeed.display.view })")
    freeze(page, stage)
    before_ms = page.evaluate("plotfeed.picture.nowMs(0)")

    def leap() -> None:
        assert stage.view is not None
        stage.view.clear()
        stage.now_ns -= NS // 2

    served.call(leap)
    until(page, "ms => plotfeed.picture.nowMs(0) < ms - 400", before_ms)
    assert page.evaluate("plotfeed.picture.plots.end") == 0
    assert page.evaluate("({ ...plotfeed.display.view })") == view
    page.get_by_text("Nothing selected").wait_for()


def test_a_replay_lets_no_sensor_be_changed_and_says_why(page: Page, served: Served) -> None:
    view, why = served.server._view, "A replay is not changed."
    refuses = dict.fromkeys(("sensor", "record", "step"), why)
    served.call(lambda: view.session({"refuses": refuses, "notes": ["Times are recorded."]}))
    page.get_by_text(f"Times are recorded. {why}").wait_for()
    assert page.evaluate("document.getElementById('sensor-form').inert")
    assert page.get_by_role("button", name="Record").is_disabled()
    assert page.get_by_role("button", name="Pause").first.is_enabled()
    served.call(lambda: view.session({"refuses": {}, "notes": []}))
    until(page, "!document.getElementById('sensor-form').inert")


def test_what_is_refused_says_why(page: Page) -> None:
    page.get_by_label("Pfa", exact=True).fill("2")
    page.get_by_role("button", name="Apply").click()
    page.locator("#answer[data-failed]").get_by_text("pfa").wait_for()
    assert page.get_by_label("Pfa", exact=True).input_value() == "2"  # to be mended


def test_the_page_says_what_a_clock_does_not_allow(page: Page, served: Served) -> None:
    why = "Real time cannot be held."
    refuses = dict.fromkeys(("pause", "step", "speed"), why)
    view = served.server._view
    served.call(lambda: view.session({"refuses": refuses}))
    page.get_by_text(why).wait_for()
    for name in ("Pause", "Step 1 s"):
        assert page.get_by_role("button", name=name).first.is_disabled()
    assert page.get_by_label("Speed").is_disabled()
    assert page.get_by_role("button", name="Restart").is_enabled()


def test_two_browsers_see_the_same_and_what_either_changes(
    browser: Browser, page: Page, served: Served
) -> None:
    with looking(browser, served.url) as other:
        page.get_by_label("Latency", exact=True).fill("333")
        page.get_by_role("button", name="Apply").click()
        other.locator("#latency-now").get_by_text("333 ms").wait_for()
        assert other.get_by_label("Latency", exact=True).input_value() == "333"
        page.get_by_role("button", name="Truth").click()
        until(page, "plotfeed.picture.drones !== null")
        assert other.evaluate("plotfeed.picture.drones") is None
        ends = [p.evaluate("[plotfeed.picture.news.scene.name]") for p in (page, other)]
        assert ends[0] == ends[1]


def test_a_field_that_is_being_filled_in_is_left_alone(page: Page, served: Served) -> None:
    page.get_by_label("Latency", exact=True).fill("77")
    view = served.server._view
    served.call(lambda: view.settings("radar", {"link": {"latency_ms": 500}}))
    page.locator("#latency-now").get_by_text("500 ms").wait_for()
    assert page.get_by_label("Latency", exact=True).input_value() == "77"
    assert page.get_by_label("Jitter").input_value() == "0"


def test_a_lost_connection_is_said_and_comes_back_by_itself(browser: Browser, stage: Stage) -> None:
    with on_stage(stage) as served:
        address = PageAddress("127.0.0.1", served.port)
        context = new_context(browser)
        page = context.new_page()
        page.goto(served.url)
        until(page, "plotfeed.picture.plots.end > 0")
        page.get_by_role("button", name="Truth").click()
        until(page, "plotfeed.picture.drones !== null")
        assert page.locator("#veil").is_hidden()
    page.locator("#veil").get_by_text("Connection lost").wait_for()
    assert "lost" in page.locator("#connection").inner_text()
    asked = page.evaluate("plotfeed.feed.ask({ clock: { paused: true } })")
    assert asked["ok"] is False
    again = Stage(View(), page_stage.scene(5))
    with on_stage(again, address=address) as served:
        page.locator("#veil").wait_for(state="hidden")
        until(page, "plotfeed.picture.drones?.rows === 5")  # the truth is asked again
        page.get_by_text("Connected").wait_for()
    context.close()


def test_a_page_whose_token_is_old_says_so(browser: Browser, stage: Stage) -> None:
    wide = PageAddress("0.0.0.0", 0)  # noqa: S104 - with a token
    with on_stage(stage, address=wide, token="one") as served:  # noqa: S106
        address = PageAddress(wide.host, served.port)
        context = new_context(browser)
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{served.port}/?token=one")
        until(page, "plotfeed.picture.plots.end > 0")
        assert "token" not in page.url
    with on_stage(stage, address=address, token="other"):  # noqa: S106
        page.locator("#veil").get_by_text("The address has changed").wait_for()
    context.close()


def test_no_request_leaves_for_anybody_else(browser: Browser, served: Served) -> None:
    context = new_context(browser)
    page = context.new_page()
    asked = requests(context, page)
    page.goto(served.url)
    until(page, "plotfeed.picture.plots.end > 0")
    page.get_by_role("button", name="Truth").click()
    page.get_by_role("button", name="Light").click()
    page.get_by_role("button", name="Zoom in").click()
    until(page, "plotfeed.picture.framesTaken > 10")
    context.close()
    host = f"127.0.0.1:{served.port}"
    assert len(asked) > 10
    assert f"ws://{host}/feed" in asked
    assert not [url for url in asked if not url.startswith((f"http://{host}/", f"ws://{host}/"))]


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_no_rule_of_accessibility_is_broken(browser: Browser, served: Served, scheme: str) -> None:
    with looking(browser, served.url, color_scheme=scheme, bypass_csp=True) as page:
        assert page.evaluate("document.documentElement.dataset.theme") == scheme
        page.get_by_role("button", name="Truth").click()
        page.get_by_role("application").press("n")
        page.get_by_text("Plot of").wait_for()
        served.call(lambda: served.server._view.refusal("telemetry/x: it was no telemetry"))
        page.get_by_text("Last refused").wait_for()
        assert not [(v["impact"], v["id"], v["nodes"][0]["html"]) for v in axe(page)]


@pytest.mark.parametrize("size", SIZES)
def test_everything_has_its_place_at_every_size_and_nothing_jumps(
    browser: Browser, served: Served, size: tuple[int, int]
) -> None:
    viewport = {"width": size[0], "height": size[1]}
    with looking(browser, served.url, viewport=viewport) as page:
        page.evaluate(
            """() => {
              globalThis.jumps = [];
              new PerformanceObserver((list) => {
                for (const e of list.getEntries())
                  globalThis.jumps.push([e.value, e.sources.map((s) => s.node?.id ?? "")]);
              }).observe({ type: "layout-shift", buffered: true });
            }"""
        )
        page.get_by_role("button", name="Truth").click()
        page.get_by_role("application").press("n")
        page.get_by_label("Pfa", exact=True).fill("7")
        page.get_by_role("button", name="Apply").click()
        page.locator("#answer[data-failed]").wait_for()
        until(page, "plotfeed.picture.seconds.length >= 2")
        assert sum(value for value, _ in page.evaluate("jumps")) < 0.02, page.evaluate("jumps")
        scrolls = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
        assert page.evaluate(scrolls) == [size[0], size[1]]
        for part in ("#display", "header", "aside", ".strips", "#truth", "#theme", "#plots-strip"):
            box = page.locator(part).bounding_box()
            assert box
            assert box["width"] > 20
            assert box["height"] > 20
            assert box["x"] + box["width"] <= size[0] + 0.5
            assert box["y"] + box["height"] <= size[1] + 0.5


def test_the_display_is_worked_by_keys_alone(page: Page, stage: Stage) -> None:
    display = page.get_by_role("application")
    display.focus()
    view = "({ ...plotfeed.display.view })"
    before = page.evaluate(view)
    display.press("+")
    assert page.evaluate(view)["scale"] == pytest.approx(before["scale"] / 1.25)
    display.press("ArrowRight")
    assert page.evaluate(view)["east"] > before["east"]
    display.press("ArrowUp")
    assert page.evaluate(view)["north"] > before["north"]
    display.press("0")
    assert page.evaluate(view)["scale"] == pytest.approx(before["scale"])
    display.press("n")
    page.get_by_role("heading", name="Plot of").wait_for()
    first = page.evaluate("plotfeed.display.selected.row")
    display.press("p")
    assert page.evaluate("plotfeed.display.selected.row") < first
    display.press("Escape")
    page.get_by_text("Nothing selected").wait_for()
    display.press("t")
    until(page, "plotfeed.picture.drones !== null")
    display.press("Space")
    wait_for_command(page, stage, {"clock": {"paused": True}})
    display.press(".")
    wait_for_command(page, stage, {"clock": {"step_s": 1}})


def test_a_click_on_a_plot_shows_its_values_and_with_the_truth_the_true_ones(
    page: Page, stage: Stage
) -> None:
    page.get_by_label("Fade").select_option("60")
    page.get_by_role("checkbox", name="Tracks").uncheck()
    freeze(page, stage)
    place = page.evaluate(
        """() => {
          const { picture: { plots }, display: { view } } = plotfeed;
          for (let row = plots.end - 1; row >= plots.begin; row--) {
            const at = plots.at(row), x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
            if (!plots.flags[at]) return { x, y, range: plots.range_m[at], row };
          }
        }"""
    )
    page.get_by_role("application").click(position={"x": place["x"], "y": place["y"]})
    card = page.locator("#card")
    card.get_by_text("Latency").wait_for()
    row = page.evaluate("plotfeed.display.selected.row")
    range_m = page.evaluate(
        "row => plotfeed.picture.plots.range_m[plotfeed.picture.plots.at(row)]", row
    )
    assert f"{range_m:.1f} m" in card.inner_text()
    assert "true" not in card.inner_text()
    page.get_by_role("button", name="Truth").click()
    until(page, "plotfeed.picture.plots.drone.some((d) => d > 0)")
    page.get_by_role("application").click(position={"x": place["x"], "y": place["y"]})
    until(page, "/true|gone|flying/.test(document.getElementById('card').innerText)")


def test_a_drone_is_followed(page: Page) -> None:
    page.get_by_role("button", name="Truth").click()
    until(page, "plotfeed.picture.drones !== null")
    follow = page.get_by_role("button", name="Follow")
    assert follow.is_disabled()
    page.evaluate("plotfeed.display.select({ kind: 'drone', drone: 3 })")
    page.get_by_role("heading", name="Drone drone-003").wait_for()
    follow.click()
    assert follow.get_attribute("aria-pressed") == "true"
    until(
        page,
        """() => {
          const { picture: { drones }, display: { view } } = plotfeed, i = drones.drone.indexOf(3);
          return Math.hypot(drones.east_m[i] - view.east, drones.north_m[i] - view.north) < 60;
        }""",
    )


def test_totals_rates_and_refusals_are_told(page: Page, stage: Stage, served: Served) -> None:
    until(page, "document.getElementById('total-plots').textContent !== '0'")
    assert page.locator("#total-drones").inner_text() == "16"
    served.call(lambda: served.server._view.refusal("plotfeed/telemetry/x: missing: time_utc"))
    page.get_by_text("Last refused: plotfeed/telemetry/x: missing: time_utc").wait_for()
    until(page, "/^asked 120, is 1[12]/.test(document.getElementById('latency-text').textContent)")
    until(page, "/predicted 0|predicted 1/.test(document.getElementById('pd-text').textContent)")


def test_another_scene_replaces_the_first_and_its_map_lies_where_it_is(
    page: Page, served: Served
) -> None:
    square = [-3000, 1000, -1000, 1000, -1000, 3000, -3000, 3000]
    shapes = {"lines": [[-4000, 0, 4000, 0]], "areas": [square], "points": [[500, 500, "Tower"]]}
    basemap = Basemap("application/json", json.dumps(shapes).encode())
    scene = road.scene([road.radar(id="lonely", range_max_m=5000.0)], seed=1)
    served.call(lambda: served.server._view.scene(scene, basemap))
    page.get_by_role("heading", name="lonely: settings").wait_for()
    assert page.evaluate("plotfeed.picture.plots.end") == 0
    for layer in ("Cover", "Sweep", "Labels"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_role("application").press("ArrowUp")
    median_red = """([east, north]) => {
      const canvas = document.getElementById("screen"), { view } = plotfeed.display;
      const at = [view.x(east) - 4, view.y(north) - 4].map(Math.round);
      const { data } = canvas.getContext("2d").getImageData(at[0], at[1], 9, 9);
      return [...data].filter((_, i) => i % 4 === 0).sort((a, b) => a - b)[40];
    }"""
    until(page, f"(place) => ({median_red})(place) > 20", [-1900, 2300])
    assert page.evaluate(median_red, [-3300, 2300]) < 20


def test_tracks_under_test_are_shown_and_can_be_selected(page: Page) -> None:
    until(page, "plotfeed.picture.tracks.size === 16")
    page.evaluate("plotfeed.display.select({ kind: 'track', id: 5 })")
    page.get_by_role("heading", name="Track 5").wait_for()
    assert "m/s" in page.locator("#card").inner_text()


def test_the_theme_is_remembered(page: Page) -> None:
    page.get_by_role("button", name="Light").click()
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    page.reload()
    page.get_by_role("button", name="Dark").wait_for()
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
