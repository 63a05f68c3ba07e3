"""What the display shows, read back from its pixels and from what it took."""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from support.chromium import drawn, until
from support.made_up_session import MadeUpSession
from support.page_server import Served, wait_for_command
from support.page_updates import read_frame

from plotfeed import testing
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.updates import LAYOUTS, SectionKind
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.models.frames import aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from playwright.sync_api import Page

SEA = np.array([0x0A, 0x16, 0x1F])
# Of the dark theme, as the style sheet has them: what is under plots, the first two sensors.
SENSOR_COLOURS = np.array([[0x1A, 0xC2, 0xA3], [0xDC, 0x69, 0x6E]])
CLEAR_OF_OTHERS_PX = 12  # Marks of plots this far apart do not lie over each other


@pytest.mark.usefixtures("goes_on")
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
    wanted = {SectionKind.PLOTS, SectionKind.PLOT_TRUTHS, SectionKind.DRONES, SectionKind.TRACKS}
    kinds = "new Set(caught.flatMap((c) => c[1].map((s) => s[0])))"
    until(page, f"(all) => all.every((kind) => {kinds}.has(kind))", [int(kind) for kind in wanted])
    seen = set()
    for octets, sections in page.evaluate("caught"):
        written = [s for s in read_frame(base64.b64decode(octets)).sections if s.columns]
        assert [(s.kind, s.rows, s.first) for s in written] == [tuple(s[:3]) for s in sections]
        for section, (kind, _, _, columns) in zip(written, sections, strict=True):
            seen.add(kind)
            for name, values in columns:
                read = np.array(values, dtype=np.float64)
                np.testing.assert_array_equal(read, section.columns[name].astype(np.float64))
    assert seen >= wanted <= LAYOUTS.keys()


def delivered_plots(stage: MadeUpSession) -> dict[str, list[tuple[float, float, float]]]:
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
                enu_m = testing.SITE.from_ecef(frames[batch.sensor].to_ecef(local_m))
                found[batch.sensor].append((plot.time_utc_ns / 1e6, enu_m[0], enu_m[1]))
    return found


def test_every_plot_that_was_delivered_is_shown_within_a_pixel(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    for layer in ("Cover", "Sweep", "Labels", "Tracks"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_label("Fade").select_option("30")
    drawn(page)
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
    view_now = served.server._view
    everything = served.call(lambda: view_now.snapshot(stage.now_ns))
    lost = read_frame(everything.public + everything.truth)
    expected = delivered_plots(stage)
    assert len(shown) + len(lost.column(SectionKind.LOST_PLOTS, "flags")) == sum(
        map(len, expected.values())
    )
    assert len(shown) > 50
    for sensor, t_ms, x, y in shown:
        times_ms, east_m, north_m = np.array(expected[ids[sensor]]).T
        expected_x = view["width"] / 2 + (east_m - view["east"]) / view["scale"]
        expected_y = view["height"] / 2 - (north_m - view["north"]) / view["scale"]
        off = np.hypot(expected_x - x, expected_y - y)[np.abs(times_ms - t_ms) < 0.01]
        assert off.min() < 1
    # Where a plot is that no other mark or ring touches, its sensor's colour lies over the ground,
    # however faded.
    seen = np.array(pixels) - SEA
    colour = np.array([SENSOR_COLOURS[sensor] for sensor, *_ in shown]) - SEA
    share = (seen * colour).sum(axis=1) / (colour**2).sum(axis=1)
    off = np.abs(seen - share[:, None] * colour).max(axis=1)
    assert (share > 0.1).mean() > 0.97
    places = np.array([(x, y) for *_, x, y in shown])
    apart = np.hypot(*(places[:, None] - places).T) + np.diag(np.full(len(shown), np.inf))
    alone = apart.min(axis=0) > CLEAR_OF_OTHERS_PX
    assert alone.sum() > 10
    assert np.median(off[alone]) < 6  # some lie over a ring or a spoke


@pytest.mark.usefixtures("goes_on")
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


def test_a_leap_shows_another_time_and_leaves_the_display_where_it_is(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    page.get_by_role("application").press("+")
    page.get_by_role("application").press("n")
    page.get_by_text("Plot of").wait_for()
    view = page.evaluate("({ ...plotfeed.display.view })")
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


def test_the_display_is_worked_by_keys_alone(page: Page, stage: MadeUpSession) -> None:
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
    wait_for_command(page, stage, {"clock": {"paused": False}})
    display.press(".")
    wait_for_command(page, stage, {"clock": {"step_s": 1}})


def test_a_click_on_a_plot_shows_its_values_and_with_the_truth_the_true_ones(page: Page) -> None:
    page.get_by_label("Fade").select_option("60")
    page.get_by_role("checkbox", name="Tracks").uncheck()
    place = page.evaluate(
        """() => {
          const { picture: { plots }, display: { view } } = plotfeed;
          const stage = document.getElementById("display").getBoundingClientRect();
          const boxes = [...document.querySelectorAll(".over, .foot")]
            .map((card) => card.getBoundingClientRect());
          const near = (x, y, box) => // as a card grows
            x + stage.x > box.x - 200 && x + stage.x < box.right + 200 &&
            y + stage.y > box.y - 200 && y + stage.y < box.bottom + 200;
          const clear = (x, y) => x > 0 && y > 0 && x < stage.width && y < stage.height &&
            !boxes.some((box) => near(x, y, box));
          for (let row = plots.end - 1; row >= plots.begin; row--) {
            const at = plots.at(row), x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
            if (!plots.flags[at] && clear(x, y)) return { x, y, range: plots.range_m[at], row };
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


def test_another_scene_replaces_the_first_and_its_map_lies_where_it_is(
    page: Page, served: Served
) -> None:
    square = [-3000, 1000, -1000, 1000, -1000, 3000, -3000, 3000]
    shapes = {"lines": [[-4000, 0, 4000, 0]], "areas": [square], "points": [[500, 500, "Tower"]]}
    basemap = Basemap("application/json", json.dumps(shapes).encode())
    scene = testing.scene([testing.radar(id="lonely", range_max_m=5000.0)], seed=1)
    served.call(lambda: served.server._view.scene(scene, basemap))
    page.get_by_role("heading", name="lonely: settings").wait_for()
    assert page.evaluate("plotfeed.picture.plots.end") == 0
    until(page, "plotfeed.display.isFitted")
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
