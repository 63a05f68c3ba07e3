"""What the display shows, read back from its pixels and words, how it is worked and laid out."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.chromium import THEME, broken_rules, drawn, looking, until, until_shown
from support.every_kind import FAR_SENSORS
from support.made_up_session import MOST_AT_ONCE_S, MadeUpSession
from support.page_server import Served, wait_for_command
from support.page_updates import read_frame

from plotfeed import testing
from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

# Of the dark theme, as the style sheet has them: what is under plots, the first two sensors.
SEA = np.array([0x0A, 0x16, 0x1F])
SENSOR_COLOURS = np.array([[0x1A, 0xC2, 0xA3], [0xDC, 0x69, 0x6E]])
CLEAR_OF_OTHERS_PX = 12  # Marks of plots this far apart do not lie over each other
VIEW = "({ ...plotfeed.display.view })"
WORDS = "plotfeed.display.words.map((w) => w[4])"
PRESENT = "plotfeed.picture.drones !== null || plotfeed.picture.droneNames.length > 0"


def display(page: Page) -> Locator:
    return page.get_by_role("application")


def truth(page: Page) -> None:
    page.get_by_role("button", name="Truth").click()


def test_every_plot_that_was_delivered_is_shown_within_a_pixel(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    for layer in ("Cover", "Sweep", "Labels", "Tracks"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_label("Fade").select_option("30")
    drawn(page)
    shown, view = page.evaluate(
        """() => {
          const { picture: { plots }, display: { view } } = plotfeed, shown = [];
          const context = document.getElementById("screen").getContext("2d");
          for (let row = plots.begin; row < plots.end; row++) {
            const at = plots.at(row);
            if (plots.flags[at]) continue;
            const x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
            const { data } = context.getImageData(Math.round(x), Math.round(y), 1, 1);
            shown.push([plots.sensor[at], x, y, data[0], data[1], data[2]]);
          }
          return [shown, { ...view }];
        }"""
    )
    told = read_frame(served.view.snapshot(stage.now_ns).public)
    names = ("flags", "sensor", "east_m", "north_m")
    flags, sensors, east_m, north_m = (told.column(SectionKind.PLOTS, name) for name in names)
    expected_x = view["width"] / 2 + (east_m - view["east"]) / view["scale"]
    expected_y = view["height"] / 2 - (north_m - view["north"]) / view["scale"]
    expected = np.stack([sensors, expected_x, expected_y], axis=-1)[flags == 0]
    assert len(shown) > 50
    np.testing.assert_allclose(np.array(shown)[:, :3], expected, atol=1)
    # Where a plot is that no other mark or ring touches, its sensor's colour lies over the ground,
    # however faded.
    seen = np.array(shown)[:, 3:] - SEA
    colour = np.array([SENSOR_COLOURS[sensor] for sensor, *_ in shown]) - SEA
    share = (seen * colour).sum(axis=1) / (colour**2).sum(axis=1)
    off = np.abs(seen - share[:, None] * colour).max(axis=1)
    assert (share > 0.1).mean() > 0.97
    places = np.array(shown)[:, 1:3]
    apart = np.hypot(*(places[:, None] - places).T) + np.diag(np.full(len(shown), np.inf))
    alone = apart.min(axis=0) > CLEAR_OF_OTHERS_PX
    assert alone.sum() > 10
    assert np.median(off[alone]) < 6  # some lie over a ring or a spoke


@pytest.mark.usefixtures("goes_on")
def test_the_truth_is_hidden_until_it_is_asked_for_and_wherever_it_would_be_seen(
    page: Page,
) -> None:
    """In marks, the legend, trails, heights and the table."""
    page.get_by_label("Trails").select_option("60")
    kinds = "new Set([...plotfeed.trails.names].map((name) => name.split(' ')[0]))"
    until(page, f"[...{kinds}].join() === 'track'")
    assert page.get_by_role("button", name="Truth").get_attribute("aria-pressed") == "false"
    assert not page.evaluate(PRESENT)
    assert "false alarm" not in page.get_by_label("Marks").inner_text()
    page.get_by_label("Fade").select_option("60")
    display(page).press("h")
    heights = "document.getElementById('heights-text').textContent"
    until(page, rf"/^radar: [1-9]\d* plots with a height$/.test({heights})")
    truth(page)
    until(page, "plotfeed.picture.drones?.rows === 16")
    until(page, "plotfeed.picture.plots.drone.some((d) => d === -1)")
    assert "false alarm" in page.get_by_label("Marks").inner_text()
    until(page, f"{kinds}.has('drone')")
    until(page, rf"/, 1\d drones/.test({heights})")
    truth(page)
    until(page, f"!({PRESENT}) && !{kinds}.has('drone')")
    assert not page.evaluate("plotfeed.picture.plots.drone.some((d) => d >= -1 && d !== 0)")
    page.get_by_role("button", name="microphones").click()
    until(page, f"{heights}.startsWith('microphones: 0 plots')")


def test_a_leap_shows_another_time_and_leaves_the_display_where_it_is(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    display(page).press("+")
    display(page).press("n")
    page.get_by_text("Plot of").wait_for()
    view = page.evaluate(VIEW)
    before_ms = page.evaluate("plotfeed.picture.nowMs(0)")
    stage.now_ns -= NS // 2
    served.view.clear()
    until(page, "ms => plotfeed.picture.nowMs(0) < ms - 400", before_ms)
    assert page.evaluate("plotfeed.picture.plots.end") == 0
    assert page.evaluate(VIEW) == view
    page.get_by_text("Nothing selected").wait_for()


def test_the_page_is_worked_by_keys_alone_but_not_while_something_is_typed(
    page: Page, stage: MadeUpSession
) -> None:
    display(page).focus()
    before = page.evaluate(VIEW)
    display(page).press("+")
    assert page.evaluate(VIEW)["scale"] == pytest.approx(before["scale"] / 1.25)
    display(page).press("ArrowRight")
    assert page.evaluate(VIEW)["east"] > before["east"]
    display(page).press("ArrowUp")
    assert page.evaluate(VIEW)["north"] > before["north"]
    display(page).press("0")
    assert page.evaluate(VIEW)["scale"] == pytest.approx(before["scale"])
    display(page).press("n")
    page.get_by_role("heading", name="Plot of").wait_for()
    first = page.evaluate("plotfeed.display.selected.row")
    display(page).press("p")
    assert page.evaluate("plotfeed.display.selected.row") < first
    display(page).press("Escape")
    page.get_by_text("Nothing selected").wait_for()
    display(page).press(".")
    wait_for_command(page, stage, {"clock": {"step_s": 1}})
    page.get_by_role("button", name="Record").focus()
    page.keyboard.press("t")
    until(page, "plotfeed.picture.drones !== null")
    page.keyboard.press("t")
    until(page, f"!({PRESENT})")
    page.get_by_label("Pfa", exact=True).fill("")
    page.keyboard.type("t + 0")
    assert page.get_by_label("Pfa", exact=True).input_value() == "t + 0"
    assert not page.evaluate(PRESENT)
    view = page.evaluate(VIEW)
    assert view["scale"] == pytest.approx(before["scale"])
    page.get_by_role("radio", name="Off").focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(VIEW) == view
    page.locator("body").click(position={"x": 2, "y": 2})
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press(" ")
    wait_for_command(page, stage, {"clock": {"paused": False}})
    assert not [c for c in stage.commands if "record" in c]


# The place of the newest plot that nothing lies over, nor a card once it has grown.
NEWEST = """() => {
  const { picture: { plots }, display: { view } } = plotfeed;
  const box = document.getElementById("display"), { left, top } = box.getBoundingClientRect();
  const clear = (x, y) => [-190, 0, 190].every((dy) =>
    box.contains(document.elementFromPoint(left + x, top + y + dy)));
  for (let row = plots.end - 1; row >= plots.begin; row--) {
    const at = plots.at(row), x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    if (!plots.flags[at] && clear(x, y)) return { x, y };
  }
}"""


def test_what_is_under_the_pointer_is_told_and_kept_by_a_press_with_the_truth_if_asked(
    page: Page,
) -> None:
    page.get_by_label("Fade").select_option("60")
    page.get_by_role("checkbox", name="Tracks").uncheck()
    place = page.evaluate(NEWEST)
    display(page).hover(position=place)
    hover, card = page.locator("#hover"), page.locator("#card")
    hover.get_by_text("Plot of").wait_for()
    assert "true" not in hover.inner_text()
    display(page).click(position=place)
    card.get_by_text("Latency").wait_for()
    at = page.evaluate("plotfeed.picture.plots.at(plotfeed.display.selected.row)")
    range_m = page.evaluate("at => plotfeed.picture.plots.range_m[at]", at)
    for told in (hover, card):
        assert f"{range_m:.1f} m" in told.inner_text()
    assert "true" not in card.inner_text()
    truth(page)
    until(page, "document.getElementById('hover').hidden")
    until(page, "plotfeed.picture.plots.drone.some((d) => d > 0)")
    display(page).click(position=place)
    until(page, "/true|gone|flying/.test(document.getElementById('card').innerText)")
    # The place of the pointer is right in every way that it is told.
    display(page).hover(position={"x": 400, "y": 300})
    east, north = page.evaluate(
        "[plotfeed.display.view.eastAt(400), plotfeed.display.view.northAt(300)]"
    )
    geodetic, enu, site, sensor = page.locator("#cursor").inner_text().split("·")
    expected = ecef_to_geodetic(testing.SITE.to_ecef(np.array([east, north, 0.0])))
    told_deg = [float(part.strip().rstrip("°")) for part in geodetic.split(",")]
    assert told_deg == pytest.approx([float(x) for x in expected[:2]], abs=1e-5)
    assert f"E {east:.0f} m, N {north:.0f} m" in enu
    assert f"{np.hypot(east, north) / 1000:.2f} km" in site
    assert sensor.strip().startswith("radar")


def test_the_ruler_measures_between_two_places(page: Page) -> None:
    page.get_by_role("checkbox", name="Tracks").uncheck()
    page.get_by_label("Fade").select_option("2")
    display(page).press("r")
    page.get_by_role("button", name="Ruler", pressed=True).wait_for()
    page.evaluate("plotfeed.display.hit = () => null")  # else it takes marks that are there
    for x, y in ((200, 250), (500, 400)):
        display(page).click(position={"x": x, "y": y})
    drawn(page)
    metres = page.evaluate("plotfeed.display.view.scale") * np.hypot(300, 150)
    words = page.evaluate("document.getElementById('ruler-text').textContent")
    assert f"{np.degrees(np.arctan2(300, -150)):.1f}°" in words
    assert float(words.split()[1]) * 1000 == pytest.approx(metres, rel=0.01)
    page.get_by_text("Nothing selected").wait_for()
    display(page).press("Escape")
    page.get_by_role("button", name="Ruler", pressed=False).wait_for()


def column(page: Page, number: int) -> list[str]:
    """What the cells of a column of the table say."""
    cells = page.locator(f"#table-body td:nth-child({number})").all_inner_texts()
    return [text.strip() for text in cells]


def test_the_table_is_sorted_filtered_and_chosen_from_and_a_drone_is_followed(
    page: Page, served: Served
) -> None:
    page.get_by_label("Fade").select_option("60")
    display(page).press("b")
    kind = page.get_by_label("Kind")
    rows = "document.getElementById('table-body').rows.length"
    until(page, f"{rows} > 10")
    for falls in (False, True):
        page.get_by_role("button", name="Range, m").click()
        ranges = [float(text) for text in column(page, 3) if text != "–"]
        assert ranges == sorted(ranges, reverse=falls)
        assert page.locator("th[aria-sort]").inner_text() == "Range, m"
    page.get_by_label("Filter").fill("gate")
    until(page, "document.getElementById('table-count').textContent.includes(', of ')")
    assert set(column(page, 2)) <= {"gate"}
    page.get_by_label("Filter").fill("")
    page.get_by_role("table", name="What is shown, in rows").locator("tbody button").first.click()
    page.get_by_role("heading", name="Plot of").wait_for()
    kind.select_option("tracks")
    until(page, f"{rows} === 16")
    page.evaluate("plotfeed.display.select({ kind: 'track', id: 5 })")
    page.get_by_role("heading", name="Track 5").wait_for()
    assert "m/s" in page.locator("#card").inner_text()
    assert kind.locator("[value=drones]").is_disabled()
    why = "radar: range: 482 km away at its nearest, it sees to 18 km"
    served.view.unseen({"drone-003": why})
    truth(page)
    until(page, "plotfeed.picture.drones !== null")
    kind.select_option("drones")
    until(page, f"{rows} === 16")
    page.get_by_label("Filter").fill("no sensor sees")
    until(page, f"{rows} === 1")
    row = page.locator("#table-body tr")
    assert "drone-003" in row.inner_text()
    assert f"flying, no sensor sees it: {why}" in row.inner_text()
    row.get_by_role("button").click()
    page.get_by_role("heading", name="Drone drone-003").wait_for()
    assert why in page.locator("#card").inner_text()
    follow = page.get_by_role("button", name="Follow")
    follow.click()
    assert follow.get_attribute("aria-pressed") == "true"
    until(
        page,
        """() => {
          const { picture: { drones }, display: { view } } = plotfeed, i = drones.drone.indexOf(3);
          return Math.hypot(drones.east_m[i] - view.east, drones.north_m[i] - view.north) < 60;
        }""",
    )
    truth(page)
    until(page, "document.getElementById('table-of').value === 'plots'")


# Of places, metres east and north of the site.
COLOURS = """(places) => {
  const context = document.getElementById("screen").getContext("2d"), { view } = plotfeed.display;
  return places.map(([east, north]) => {
    const [x, y] = [view.x(east), view.y(north)].map(Math.round);
    return [...context.getImageData(x, y, 1, 1).data.slice(0, 3)];
  });
}"""


def test_maps_of_the_scene_and_of_ones_own_and_the_grid_lie_where_they_are(
    page: Page, served: Served
) -> None:
    def choose(content: object) -> None:
        text = content if isinstance(content, str) else json.dumps(content)
        file = {"name": "mine.geojson", "mimeType": "application/json", "buffer": text.encode()}
        page.get_by_label("Own map").set_input_files(file)  # type: ignore[arg-type]

    until(page, f"{WORDS}.includes('090°')")
    page.get_by_label("Grid").select_option("squares")
    until(page, f"{WORDS}.some((w) => w.endsWith(' E')) && !{WORDS}.includes('090°')")
    page.locator("#scale").get_by_text("squares ").wait_for()
    page.get_by_label("Grid").select_option("none")
    until(page, f"!{WORDS}.some((w) => w.endsWith(' E') || w.endsWith('°'))")
    square = [-3000, 1000, -1000, 1000, -1000, 3000, -3000, 3000]
    shapes = {"lines": [[-4000, 0, 4000, 0]], "areas": [square], "points": [[500, 500, "Tower"]]}
    basemap = Basemap("application/json", json.dumps(shapes).encode())
    scene = testing.scene([testing.radar(id="lonely", range_max_m=5000.0)], seed=1)
    served.view.scene(scene, basemap)
    page.get_by_role("heading", name="lonely: settings").wait_for()
    assert page.evaluate("plotfeed.picture.plots.end") == 0
    until(page, "plotfeed.display.isFitted")
    for layer in ("Cover", "Sweep"):
        page.get_by_role("checkbox", name=layer).uncheck()
    display(page).press("ArrowUp")
    within, beside = [-1900, 2300], [-3300, 2300]
    until(page, f"(place) => ({COLOURS})([place])[0][0] > 20", within)
    assert page.evaluate(COLOURS, [beside])[0][0] < 20
    near = {"type": "Point", "coordinates": [-3.73, 40.45]}  # The site
    choose({"type": "Feature", "geometry": near, "properties": {"name": "Here"}})
    page.get_by_text("Map: mine.geojson").wait_for()
    until(page, f"{WORDS}.includes('Here')")
    left, top, right, bottom = page.evaluate(
        "plotfeed.display.placed.find((p) => p[4] === 'Here').slice(0, 4)"
    )
    x, y = page.evaluate("[plotfeed.display.view.x(0), plotfeed.display.view.y(0)]")
    assert left - 120 < x < right + 120
    assert top - 60 < y < bottom + 60
    choose("no JSON")
    page.get_by_text("mine.geojson: expected GeoJSON").wait_for()
    choose({"type": "Point", "coordinates": [400, 95]})
    page.get_by_text("expected longitudes and latitudes").wait_for()


LENS = FAR_SENSORS["camera"] | {"id": "camera", "pan_deg": 60.0, "horizontal_fov_deg": 14.0}
LENS |= {"range_max_m": 2000.0}
JAMMER = {"east_m": -900.0, "north_m": 700.0, "above_site_m": 50.0, "eirp_w": 10.0}
JAMMER |= {"frequency_hz": 9.4e9, "bandwidth_hz": 4e7}


def show(page: Page, served: Served, *sensors: dict[str, Any]) -> None:
    """Another scene, of which nothing but the cover of sensors is drawn."""
    scene = testing.scene([*sensors], seed=1)
    generation = page.evaluate("plotfeed.picture.news.generation")
    served.view.scene(scene)
    until(page, f"plotfeed.picture.news.generation > {generation} && plotfeed.display.isFitted")
    drawn(page)


def covered(page: Page, step_deg: float) -> list[float]:
    """Directions in which anything is drawn over the bare ground, halfway between steps."""
    drawn(page)
    azimuths = np.radians(np.arange(0.5, 360.0, step_deg))
    places = 1500.0 * np.stack([np.sin(azimuths), np.cos(azimuths)], axis=-1)
    is_bare = (np.array(page.evaluate(COLOURS, places.tolist())) == SEA).all(axis=1)
    return (np.flatnonzero(~is_bare) * step_deg).tolist()


def test_lenses_beams_and_jammers_are_drawn_where_they_are_and_sensors_named(
    page: Page, served: Served
) -> None:
    for layer in ("Sweep", "Labels", "Map"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_label("Grid").select_option("none")
    show(page, served, LENS)
    assert covered(page, 5) == [55, 60, 65]
    show(page, served, LENS | {"mount": {}})  # of which nothing is drawn by itself
    assert not covered(page, 5)
    look: dict[str, Any] = {"tilt_deg": 3.0, "span_deg": 14.0, "sees": True, "cued_by": "rf"}
    for pan_deg in (60.0, 120.0):
        at = look | {"pan_deg": pan_deg, "from_deg": pan_deg - 7.0, "aim_deg": pan_deg}
        served.view.pointing({"camera": at})
        until(page, f"plotfeed.picture.news.pointing.camera?.pan_deg === {pan_deg}")
        assert covered(page, 5) == [pan_deg - 5, pan_deg, pan_deg + 5]
        assert f"Points to {pan_deg:.1f}°" in page.locator("#sensor-words").inner_text()
    assert "plots of rf" in page.locator("#sensor-words").inner_text()
    beams = {"width_deg": 4.0, "search_deg": [10.0, 14.0], "tracks_deg": [200.0]}
    served.view.pointing({"camera": beams})
    until(page, "plotfeed.picture.news.pointing.camera?.search_deg?.length === 2")
    assert covered(page, 2) == [8, 10, 12, 14, 198, 200]
    radar = testing.radar(range_max_m=3000.0)
    show(page, served, radar)
    page.get_by_role("checkbox", name="Labels").check()
    words = f"{WORDS}.filter((w) => w.includes('jammer')).join()"
    for jamming, told in (({"jamming": {"east": JAMMER}}, "jammer east: radar"), ({}, "")):
        (sensor,) = testing.scene([radar | jamming], seed=1).sensor
        served.view.settings(sensor, 0)
        until(page, f"{words} === '{told}'")
        ((red, _, _),) = page.evaluate(COLOURS, [[JAMMER["east_m"], JAMMER["north_m"]]])
        assert (red > 200) == bool(told)
    # Sensors that stand together are all named, and no words lie over others.
    places = [[10.0 * i, 0.0, 5.0] for i in range(9)]
    radars = [testing.radar(id=f"radar-{i}", position_enu_m=at) for i, at in enumerate(places)]
    show(page, served, *radars)
    until(page, f"{WORDS}.filter((w) => w.startsWith('radar-')).length === 9")
    assert not page.evaluate(WORDS_OVER_WORDS)


def reports(times_ns: list[int], track: int, **more: Any) -> list[ToldTrack]:
    """Of a track that flies east, one a time."""
    place = {"longitude_deg": testing.SITE.longitude_deg, "height_m": testing.SITE.height_m}
    place["latitude_deg"] = testing.SITE.latitude_deg + 0.01 * (track - 90)
    told = {"name": str(track), "velocity_enu_m_s": (20.0, 0.0, 0.0), **place, **more}
    return [ToldTrack(t_utc_ns=t_utc_ns, **told) for t_utc_ns in times_ns]


def test_a_track_that_is_not_updated_is_drawn_as_such_with_its_age_until_it_is_heard_of_again(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    ago_s, now_ns = 20, stage.now_ns
    often = [now_ns - s * NS for s in (4, 3, 2, 1)]
    for told in (
        reports([t_ns - ago_s * NS for t_ns in often], 91),
        reports(often, 92),
        reports(often, 94),
        reports([now_ns], 94, ended=True),
        reports(often, 89, name="<b>9th of the north-western gate"),
        reports(often, 93, coasted=True),
    ):
        served.view.tracks(told)
    until(page, "plotfeed.picture.tracks.has(93)")
    page.get_by_role("button", name="Table").click()
    page.get_by_label("Kind").select_option("tracks")
    page.get_by_label("Filter").fill("9")
    until(page, "document.getElementById('table-body').rows.length >= 4")
    states = dict(zip(column(page, 1), column(page, 7), strict=True))
    assert states["91"] == "not updated, was confirmed"
    assert states["92"] == states["<b>9th of the north-western gate"] == "confirmed"
    assert states["93"] == "coasted"
    assert "94" not in states
    for word in (f"T91 {ago_s + 1} s", "T92", "<b>9th of the north-"):
        until(page, f"{WORDS}.includes('{word}')")
    page.evaluate("plotfeed.display.select({ kind: 'track', id: 91 })")
    page.get_by_role("heading", name="Track 91").wait_for()
    assert f"{ago_s + 1}.0 s ago" in page.locator("#card").inner_text()
    # 20 m/s for 21 s would be 420 m: it is where it was told last, north of the site.
    assert "0.0°" in page.locator("#card").inner_text()
    served.view.tracks(reports([now_ns], 91))
    until(page, f"{WORDS}.includes('T91') && !{WORDS}.some((w) => w.startsWith('T91 '))")


def test_what_is_looked_at_is_in_the_address_and_kept_on_reload_and_so_is_the_theme(
    page: Page, browser: Browser, served: Served
) -> None:
    page.get_by_role("checkbox", name="Show gate").uncheck()
    page.get_by_role("checkbox", name="Labels").uncheck()
    page.get_by_label("Fade").select_option("30")
    page.get_by_label("Trails").select_option("60")
    page.locator("#sensors").get_by_role("button", name="microphones").click()
    truth(page)
    page.get_by_role("button", name="Zoom in").click()
    page.get_by_role("button", name="Light").click()
    view = page.evaluate(VIEW)
    until(page, "location.hash.includes('hide=gate') && location.hash.includes('trails=60')")
    asked = "new URLSearchParams(location.hash.slice(1))"
    until(page, f"{asked}.get('sensor') === 'microphones'")
    until(page, f"Math.abs({asked}.get('at').split(',')[2] - {view['scale']}) < 1e-3")
    assert "truth" not in page.evaluate("location.hash")

    def assert_same(page: Page) -> None:
        until_shown(page)
        kept = page.evaluate(VIEW)
        for name in ("east", "north", "scale"):
            assert kept[name] == pytest.approx(view[name], abs=0.06)
        assert page.evaluate("[...plotfeed.display.hidden]") == ["gate"]
        assert not page.get_by_role("checkbox", name="Labels").is_checked()
        assert page.get_by_label("Fade").input_value() == "30"
        assert page.get_by_label("Trails").input_value() == "60"
        page.get_by_role("heading", name="microphones: settings").wait_for()
        assert page.evaluate("plotfeed.display.truth") is False

    page.reload()
    assert_same(page)
    assert page.evaluate(THEME) == "light"
    with looking(browser, f"{served.url}{page.evaluate('location.hash')}") as other:
        assert_same(other)


def test_two_fingers_zoom_and_one_moves_the_display(browser: Browser, served: Served) -> None:
    with looking(browser, served.url, has_touch=True) as page:
        box = page.locator("#display").bounding_box()
        assert box
        session = page.context.new_cdp_session(page)

        def touch(kind: str, *east_px: float) -> None:
            """Fingers that far from the left of the display, at one height."""
            y = box["y"] + 300
            points = [{"x": box["x"] + x, "y": y, "id": i} for i, x in enumerate(east_px)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        middle = "[plotfeed.display.view.eastAt(400), plotfeed.display.view.northAt(300)]"
        before, at = page.evaluate(VIEW), page.evaluate(middle)
        touch("touchStart", 350)
        touch("touchStart", 350, 450)
        for px in range(10, 60, 10):
            touch("touchMove", 350 - px, 450 + px)
        touch("touchEnd")
        until(page, f"plotfeed.display.view.scale < {before['scale'] * 0.51}")
        assert page.evaluate(VIEW)["scale"] == pytest.approx(before["scale"] / 2, rel=1e-6)
        assert page.evaluate(middle) == pytest.approx(at, abs=before["scale"])
        before = page.evaluate(VIEW)
        touch("touchStart", 300)
        for px in range(20, 120, 20):
            touch("touchMove", 300 + px)
        touch("touchEnd")
        until(page, f"plotfeed.display.view.east < {before['east'] - 90 * before['scale']}")
        assert page.evaluate(VIEW)["scale"] == before["scale"]


SIZES = ((360, 740), (960, 640), (1280, 720), (1920, 1080), (2560, 1440))
# Of windows in which the picture has two thirds.
ON_A_DESK = ((1280, 720), (1920, 1080), (2560, 1440))
SCROLLS_BELOW_PX = 860  # A narrower window has everything one below the other, and the page scrolls
CUT_OFF = """() => {
  const found = [], without = ".hidden, .skip, svg, .file input";
  const shown = (e) => e.checkVisibility() && !e.closest(without);
  for (const element of document.querySelectorAll("body *")) {
    if (!shown(element) || element.tagName === "CANVAS") continue;
    const style = getComputedStyle(element), box = element.getBoundingClientRect();
    const words = [...element.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    const clips = (axis) => !["visible", "auto", "scroll"].includes(style[`overflow${axis}`]);
    if (words && element.scrollWidth > element.clientWidth + 1 && style.display !== "inline")
      found.push(["wider than its place", element.outerHTML.slice(0, 90)]);
    if (clips("Y") && !element.matches("main, body, .stage") &&
        element.scrollHeight > element.clientHeight + 1)
      found.push(["higher than its place", element.outerHTML.slice(0, 90)]);
    if (box.right > innerWidth + 1 || box.left < -1)
      found.push(["beside the window", element.outerHTML.slice(0, 90)]);
  }
  return found;
}"""
COVERED = """() => {
  const found = [], controls = [...document.querySelectorAll("button, select, input, summary")];
  const shown = controls.filter((c) => c.checkVisibility() && !c.closest("[inert]"));
  for (const control of shown) {
    control.scrollIntoView({ block: "center", behavior: "instant" });
    const { left, top, width, height } = control.getBoundingClientRect();
    const on = document.elementFromPoint(left + width / 2, top + height / 2);
    if (!on || !(control.contains(on) || on.contains(control)))
      found.push([control.outerHTML.slice(0, 90), on && on.outerHTML.slice(0, 60)]);
  }
  const boxes = shown.map((c) => [c, c.getBoundingClientRect()]);
  boxes.forEach(([a, p], i) => {
    for (const [b, q] of boxes.slice(i + 1))
      if (!a.contains(b) && !b.contains(a) && a.closest("[data-card], header") ===
          b.closest("[data-card], header") && p.left < q.right - 1 && q.left < p.right - 1 &&
          p.top < q.bottom - 1 && q.top < p.bottom - 1)
        found.push([a.outerHTML.slice(0, 90), b.outerHTML.slice(0, 90)]);
  });
  return found;
}"""
WORDS_OVER_WORDS = """() => {
  const placed = plotfeed.display.words, found = [];
  placed.forEach((a, i) => placed.slice(i + 1).forEach((b) => {
    if ((a[4] || b[4]) && a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3])
      found.push([a[4], b[4]]);
  }));
  return found.filter(([a, b]) => a && b);
}"""
PARTS = "header, main, aside, .strips, #display, button, input, select"
# What lies elsewhere than when it was asked first, but for cards over the picture, which grow.
MOVED = """(parts) => {
  const place = (element) => {
    const { left, top, width, height } = element.getBoundingClientRect();
    return [left, top, width, height].map(Math.round).join();
  };
  globalThis.before ??= [...document.querySelectorAll(parts)]
    .filter((e) => !e.closest(".selected, [data-card=legend]")).map((e) => [e, place(e)]);
  return globalThis.before.filter(([e, then]) => e.checkVisibility() && place(e) !== then)
    .map(([e, then]) => [e.outerHTML.slice(0, 90), then, place(e)]);
}"""
# Words of charts that are cut off, when all are drawn anew.
BESIDE_THE_CHART = """() => {
  const found = [], { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (words, x, y) {
    const left = this.textAlign === "right" ? x - this.measureText(words).width : x;
    if (this.canvas.id.endsWith("-strip") && (left < 0 || y > this.canvas.clientHeight))
      found.push([this.canvas.id, words, left, y]);
    fillText.call(this, words, x, y);
  };
  dispatchEvent(new Event("resize"));
  CanvasRenderingContext2D.prototype.fillText = fillText;
  return found;
}"""


@pytest.mark.usefixtures("goes_on")
def test_nothing_is_cut_off_or_covered_and_nothing_jumps_while_the_page_is_used(page: Page) -> None:
    page.get_by_label("Fade").select_option("60")
    page.set_viewport_size({"width": 1920, "height": 1080})
    drawn(page)
    assert not page.evaluate(MOVED, PARTS)
    truth(page)
    display(page).press("n")
    page.get_by_label("Pfa", exact=True).fill("7")
    page.get_by_role("button", name="Apply").click()
    page.locator("#answer[data-failed]").wait_for()
    until(page, "plotfeed.picture.seconds.length >= 2")
    drawn(page)
    assert not page.evaluate(MOVED, PARTS)
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("scrollTo(0, 0)")
        display(page).press("0")
        display(page).press("n")
        page.get_by_text("Plot of").wait_for()
        until(page, "plotfeed.picture.drones !== null && plotfeed.display.words.length > 20")
        drawn(page)
        at = f"at {width} x {height}"
        assert not page.evaluate(CUT_OFF), at
        assert not page.evaluate(WORDS_OVER_WORDS), at
        root = "document.documentElement"
        assert page.evaluate(f"{root}.scrollWidth") == width
        if width >= SCROLLS_BELOW_PX:
            assert page.evaluate(f"{root}.scrollHeight") == height
        assert not page.evaluate(COVERED), at
        if (width, height) in ON_A_DESK:
            box = page.locator("#display").bounding_box()
            assert box
            assert 3 * box["width"] * box["height"] >= 2 * width * height, at
    page.evaluate("for (const second of plotfeed.picture.seconds) second.lost = 1e6")
    assert not page.evaluate(BESIDE_THE_CHART)


def test_a_card_is_folded_and_opened_again_and_a_stranger_is_told_what_there_is_once(
    page: Page,
) -> None:
    words, tour = page.locator("#words"), page.get_by_role("group", name="Tour")
    for step in range(1, 8):
        assert words.inner_text().startswith(f"{step} of 7: ")
        assert page.locator(".toured").count() == 1
        page.locator("#tour-next").click()
    assert tour.is_hidden()
    assert "radar" in words.inner_text()
    totals, head = page.locator("#totals"), page.get_by_role("button", name="Totals")
    assert totals.is_visible()
    head.click()
    assert not totals.is_visible()
    page.reload()
    until_shown(page)
    assert tour.is_hidden()
    assert head.get_attribute("aria-expanded") == "false"
    assert not totals.is_visible()
    head.click()
    assert totals.is_visible()
    display(page).press("?")
    page.get_by_role("button", name="Show the tour").click()
    page.get_by_role("button", name="Skip the tour").click()
    assert tour.is_hidden()
    keys = page.get_by_role("table", name="Keys").inner_text()
    assert "zooms in" in keys
    assert "Space" in keys
    page.get_by_role("heading", name="Help").get_by_role("button").click()
    assert page.get_by_role("table", name="Keys").is_hidden()


@pytest.mark.usefixtures("goes_on")
def test_no_rule_of_accessibility_is_broken_with_all_that_can_be_opened(
    browser: Browser, served: Served
) -> None:
    with looking(browser, served.url, color_scheme="light", bypass_csp=True) as page:
        assert page.evaluate(THEME) == "light"
        for key in ("b", "h", "r", "t", "?", "n"):
            display(page).press(key)
        page.get_by_text("Plot of").wait_for()
        served.view.tell(refusal="telemetry/x: it was no telemetry")
        page.get_by_text("Last refused").wait_for()
        page.get_by_role("button", name="Connect here").first.click()
        page.get_by_role("button", name="Audience").click()
        page.get_by_role("button", name="The link goes bad").click()
        page.get_by_role("button", name="The link goes bad", pressed=True).wait_for()
        page.get_by_role("button", name="Hold").click()
        page.get_by_text("Looking back").first.wait_for()
        until(page, "document.getElementById('table-body').rows.length > 3")
        assert not broken_rules(page)


PLOTS = """({ plots }) => {
  const found = [];
  for (let row = plots.begin; row < plots.end; row++) {
    const at = plots.at(row);
    found.push([plots.shown_ms[at], plots.t_utc_ms[at], plots.sensor[at], plots.east_m[at] || 0]);
  }
  return found;
}"""
LOOKED_AT = "plotfeed.display.picture.nowMs(performance.now())"
LIVE = "plotfeed.picture.nowMs(performance.now())"


@pytest.mark.usefixtures("goes_on")
def test_one_looks_back_at_what_there_was_and_at_marks_while_the_session_goes_on(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    until(page, "plotfeed.past.latestMs - plotfeed.past.oldestMs > 1500")
    held_ms, then = page.evaluate(f"""() => {{
      document.getElementById("hold").click();
      return [plotfeed.display.picture.nowMs(0), ({PLOTS})(plotfeed.picture)];
    }}""")
    assert len(then) > 10
    newest = f"Math.max(...({PLOTS})(plotfeed.picture).map(([shown_ms]) => shown_ms))"
    until(page, f"{newest} > {held_ms} + 1000")
    shown = page.evaluate(f"({PLOTS})(plotfeed.display.picture)")
    assert [plot for plot in shown if plot in then] == then
    # A frame may bring what the session has worked out ahead, and no more of what came later.
    assert max(shown_ms for shown_ms, *_ in shown) <= held_ms + 1e3 * MOST_AT_ONCE_S
    assert page.evaluate(LOOKED_AT) == held_ms
    assert page.evaluate("plotfeed.display.picture.drones") is None
    page.get_by_role("button", name="Back to now").click()
    page.locator("#back-text").get_by_text("Now", exact=True).wait_for()
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")
    assert page.get_by_role("button", name="Back to now").is_disabled()
    # It goes on behind the live as far as was asked, with the truth of then if that is shown.
    truth(page)
    until(page, "plotfeed.picture.drones !== null")
    since_ms = page.evaluate(LIVE)
    until(page, f"{LIVE} > {since_ms} + 1500")
    page.get_by_label("Look back").fill("-1")
    page.get_by_text("Looking back").first.wait_for()
    before_ms = page.evaluate(LOOKED_AT)
    until(page, f"{LOOKED_AT} > {before_ms} + 300")
    assert page.evaluate(f"{LIVE} - {LOOKED_AT}") == pytest.approx(1000, abs=50)
    until(page, "plotfeed.display.picture.drones?.rows === 16")
    page.locator("#hold").click()
    truth(page)
    until(page, "plotfeed.picture.drones === null")
    hits = page.evaluate(
        """() => {
          const { display } = plotfeed, { view, picture } = display, { drones } = picture;
          return Array.from(drones.drone, (_, i) =>
            display.hit(view.x(drones.east_m[i]), view.y(drones.north_m[i]))?.kind);
        }"""
    )
    assert "drone" not in hits
    display(page).press("l")
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")
    # A story leaves a mark to which one goes back, a second before it.
    marks, story = page.get_by_label("Go to a mark"), page.get_by_role("button", name="Outage of r")
    assert marks.is_disabled()
    story.click()
    wait_for_command(page, stage, {"story": "outage"})
    for strip in ("plots", "latency", "loss", "pd", "late"):
        label = f"document.getElementById('{strip}-strip').getAttribute('aria-label')"
        until(page, f"{label}.includes('Outage of radar')")
    told_ms = page.evaluate("plotfeed.picture.news.marks.at(-1).t_utc_ms")
    served.call(stage.stand)
    until(page, "plotfeed.picture.pace === 0")
    marks.select_option(index=1)
    page.get_by_text("Looking back").first.wait_for()
    assert page.evaluate(LOOKED_AT) == pytest.approx(told_ms - 1000, abs=1)
    story.click()
    wait_for_command(page, stage, {"story": "outage", "reset": True})
    page.get_by_role("button", name="Undo").click()
    wait_for_command(page, stage, {"undo": True})
    served.view.scene(stage.scene)  # another scene has no past
    page.locator("#back-text").get_by_text("Now", exact=True).wait_for()
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")
