"""What there is beside the picture: hover card, table, ruler, trails, heights, keys."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.chromium import broken_rules, drawn, looking, until, until_shown
from support.made_up_session import MadeUpSession
from support.page_server import Served, wait_for_command

from plotfeed import testing
from plotfeed.models.frames import ecef_to_geodetic

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

# The place of a plot that nothing lies over.
NEWEST = """() => {
  const { picture: { plots }, display: { view } } = plotfeed;
  const box = document.getElementById("display");
  const { left, top } = box.getBoundingClientRect();
  for (let row = plots.end - 1; row >= plots.begin; row--) {
    const at = plots.at(row), x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    if (!plots.flags[at] && box.contains(document.elementFromPoint(left + x, top + y)))
      return { x, y };
  }
}"""


def display(page: Page) -> Locator:
    return page.get_by_role("application")


def test_what_is_under_the_pointer_is_told_without_the_truth(page: Page) -> None:
    page.get_by_label("Fade").select_option("60")
    page.get_by_role("checkbox", name="Tracks").uncheck()
    mark = page.evaluate(NEWEST)
    display(page).hover(position={"x": mark["x"], "y": mark["y"]})
    card = page.locator("#hover")
    card.get_by_text("Plot of").wait_for()
    assert "true" not in card.inner_text()
    assert "m" in card.inner_text()
    page.get_by_role("button", name="Truth").hover()
    until(page, "document.getElementById('hover').hidden")


def test_the_place_of_the_pointer_is_right_in_every_way_that_it_is_told(page: Page) -> None:
    display(page).hover(position={"x": 400, "y": 300})
    cursor = page.locator("#cursor")
    cursor.get_by_text("radar").wait_for()
    east, north = page.evaluate(
        "[plotfeed.display.view.eastAt(400), plotfeed.display.view.northAt(300)]"
    )
    geodetic, enu, site, sensor = cursor.inner_text().split("·")
    expected = ecef_to_geodetic(testing.SITE.to_ecef(np.array([east, north, 0.0])))
    told = [float(part.strip().rstrip("°")) for part in geodetic.split(",")]
    assert told == pytest.approx([float(x) for x in expected[:2]], abs=1e-5)
    assert f"E {east:.0f} m, N {north:.0f} m" in enu
    assert f"{np.hypot(east, north) / 1000:.2f} km" in site
    assert sensor.strip().startswith("radar")


def test_the_table_is_sorted_filtered_and_chosen_from(page: Page) -> None:
    page.get_by_label("Fade").select_option("60")
    display(page).press("b")
    table = page.get_by_role("table", name="What is shown, in rows")
    until(page, "document.getElementById('table-body').rows.length > 10")

    def column(number: int) -> list[str]:
        cells = table.locator(f"tbody tr td:nth-child({number})").all_inner_texts()
        return [text.strip() for text in cells]

    page.get_by_role("button", name="Range, m").click()
    ranges = [float(text) for text in column(3) if text != "–"]
    assert ranges == sorted(ranges)
    assert table.locator("th[aria-sort=ascending]").inner_text() == "Range, m"
    page.get_by_role("button", name="Range, m").click()
    found = [float(text) for text in column(3) if text != "–"]
    assert found == sorted(found, reverse=True)
    page.get_by_label("Filter").fill("gate")
    until(page, "document.getElementById('table-count').textContent.includes(', of ')")
    assert set(column(2)) <= {"gate"}
    page.get_by_label("Filter").fill("")
    table.locator("tbody button").first.click()
    page.get_by_role("heading", name="Plot of").wait_for()
    page.get_by_label("Kind").select_option("tracks")
    until(page, "document.getElementById('table-body').rows.length === 16")
    assert page.get_by_label("Kind").locator("[value=drones]").is_disabled()
    page.get_by_role("button", name="Truth").click()
    until(page, "plotfeed.picture.drones !== null")
    page.get_by_label("Kind").select_option("drones")
    until(page, "document.getElementById('table-body').rows.length === 16")
    page.get_by_role("button", name="Truth").click()
    until(page, "document.getElementById('table-of').value === 'plots'")


def test_a_drone_that_no_sensor_sees_is_listed_with_the_reason(
    page: Page, served: Served, stage: MadeUpSession
) -> None:
    why = "radar: range: 482 km away at its nearest, it sees to 18 km"
    served.call(lambda: stage.view.unseen({"drone-003": why}))
    page.get_by_role("button", name="Truth").click()
    display(page).press("b")
    page.get_by_label("Kind").select_option("drones")
    page.get_by_label("Filter").fill("no sensor sees")
    until(page, "document.getElementById('table-body').rows.length === 1")
    row = page.locator("#table-body tr")
    assert "drone-003" in row.inner_text()
    assert f"flying, no sensor sees it: {why}" in row.inner_text()
    row.get_by_role("button").click()
    page.get_by_role("heading", name="Drone drone-003").wait_for()
    assert why in page.locator("#card").inner_text()


def test_the_ruler_measures_between_two_places(page: Page) -> None:
    page.get_by_role("checkbox", name="Tracks").uncheck()
    page.get_by_label("Fade").select_option("2")
    display(page).press("r")
    page.get_by_role("button", name="Ruler", pressed=True).wait_for()
    hits = page.evaluate("[[200, 250], [500, 400]].map(([x, y]) => plotfeed.display.hit(x, y))")
    for x, y in ((200, 250), (500, 400)):
        display(page).click(position={"x": x, "y": y})
    drawn(page)
    if hits == [None, None]:  # else it takes the marks that are there
        scale = page.evaluate("plotfeed.display.view.scale")
        metres, azimuth = scale * np.hypot(300, 150), np.degrees(np.arctan2(300, -150))
        words = page.evaluate("document.getElementById('ruler-text').textContent")
        assert f"{azimuth:.1f}°" in words
        assert float(words.split()[1]) * 1000 == pytest.approx(metres, rel=0.01)
    page.get_by_text("Nothing selected").wait_for()
    display(page).press("Escape")
    page.get_by_role("button", name="Ruler", pressed=False).wait_for()


def test_keys_work_wherever_one_is_but_not_while_something_is_typed(
    page: Page, stage: MadeUpSession
) -> None:
    scale = page.evaluate("plotfeed.display.view.scale")
    page.get_by_role("button", name="Record").focus()
    page.keyboard.press("+")
    assert page.evaluate("plotfeed.display.view.scale") == pytest.approx(scale / 1.25)
    page.keyboard.press("t")
    until(page, "plotfeed.picture.drones !== null")
    page.keyboard.press("t")
    hidden = "plotfeed.picture.drones === null && plotfeed.picture.droneNames.length === 0"
    until(page, hidden)
    page.get_by_label("Pfa", exact=True).fill("")
    page.keyboard.type("t + 0")
    assert page.get_by_label("Pfa", exact=True).input_value() == "t + 0"
    assert page.evaluate(hidden)
    assert page.evaluate("plotfeed.display.view.scale") == pytest.approx(scale / 1.25)
    page.get_by_role("radio", name="Off").focus()
    east = page.evaluate("plotfeed.display.view.east")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("plotfeed.display.view.east") == east
    page.locator("body").click(position={"x": 2, "y": 2})
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press(" ")
    wait_for_command(page, stage, {"clock": {"paused": False}})
    assert not [c for c in stage.commands if "record" in c]


def test_what_is_looked_at_is_in_the_address_and_kept_on_reload(
    page: Page, browser: Browser, served: Served
) -> None:
    page.get_by_role("checkbox", name="Show gate").uncheck()
    page.get_by_role("checkbox", name="Labels").uncheck()
    page.get_by_label("Fade").select_option("30")
    page.get_by_label("Trails").select_option("60")
    page.get_by_role("button", name="microphones").click()
    page.get_by_role("button", name="Truth").click()
    page.get_by_role("button", name="Zoom in").click()
    view = page.evaluate("({ ...plotfeed.display.view })")
    until(page, "location.hash.includes('hide=gate') && location.hash.includes('trails=60')")
    asked = "new URLSearchParams(location.hash.slice(1))"
    until(page, f"{asked}.get('sensor') === 'microphones'")
    until(page, f"Math.abs({asked}.get('at').split(',')[2] - {view['scale']}) < 1e-3")
    assert "truth" not in page.evaluate("location.hash")

    def assert_same(page: Page) -> None:
        until_shown(page)
        kept = page.evaluate("({ ...plotfeed.display.view })")
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
    with looking(browser, f"{served.url}{page.evaluate('location.hash')}") as other:
        assert_same(other)


@pytest.mark.usefixtures("goes_on")
def test_trails_are_where_tracks_were_and_of_drones_only_with_the_truth(page: Page) -> None:
    page.get_by_label("Trails").select_option("60")
    kinds = "new Set([...plotfeed.trails.names].map((name) => name.split(' ')[0]))"
    until(page, f"[...{kinds}].join() === 'track'")
    page.get_by_role("button", name="Truth").click()
    until(page, f"{kinds}.has('drone')")
    page.get_by_role("button", name="Truth").click()
    until(page, f"!{kinds}.has('drone')")


def test_heights_are_shown_against_the_range_of_the_chosen_sensor(page: Page) -> None:
    page.get_by_label("Fade").select_option("60")
    display(page).press("h")
    text = "document.getElementById('heights-text').textContent"
    until(page, rf"/^radar: [1-9]\d* plots with a height$/.test({text})")
    page.get_by_role("button", name="Truth").click()
    until(page, r"/, 1\d drones/.test(document.getElementById('heights-text').textContent)")
    page.get_by_role("button", name="microphones").click()
    until(
        page,
        "document.getElementById('heights-text').textContent.startsWith('microphones: 0 plots')",
    )


@pytest.mark.usefixtures("goes_on")
def test_no_rule_of_accessibility_is_broken_by_what_can_be_opened(
    browser: Browser, served: Served
) -> None:
    with looking(browser, served.url, bypass_csp=True) as page:
        display(page).press("b")
        display(page).press("h")
        display(page).press("r")
        page.get_by_role("button", name="The link goes bad").click()
        page.get_by_role("button", name="The link goes bad", pressed=True).wait_for()
        page.get_by_role("button", name="Hold").click()
        page.get_by_text("Looking back").first.wait_for()
        until(page, "document.getElementById('table-body').rows.length > 3")
        assert not broken_rules(page)


@pytest.fixture
def touched(browser: Browser, served: Served) -> Iterator[tuple[Page, Any]]:
    with looking(browser, served.url, has_touch=True) as page:
        box = page.locator("#display").bounding_box()
        assert box
        session = page.context.new_cdp_session(page)

        def touch(kind: str, *points: tuple[float, float]) -> None:
            places = [
                {"x": box["x"] + x, "y": box["y"] + y, "id": i} for i, (x, y) in enumerate(points)
            ]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

        yield page, touch


def test_two_fingers_zoom_and_one_moves_the_display(touched: tuple[Page, Any]) -> None:
    page, touch = touched
    view = "({ ...plotfeed.display.view })"
    before = page.evaluate(view)
    at = page.evaluate("[plotfeed.display.view.eastAt(400), plotfeed.display.view.northAt(300)]")
    touch("touchStart", (350, 300))
    touch("touchStart", (350, 300), (450, 300))
    for k in range(1, 6):
        touch("touchMove", (350 - 10 * k, 300), (450 + 10 * k, 300))
    touch("touchEnd")
    until(page, f"plotfeed.display.view.scale < {before['scale'] * 0.51}")
    assert page.evaluate(view)["scale"] == pytest.approx(before["scale"] / 2, rel=1e-6)
    middle = page.evaluate(
        "[plotfeed.display.view.eastAt(400), plotfeed.display.view.northAt(300)]"
    )
    assert middle == pytest.approx(at, abs=before["scale"])
    before = page.evaluate(view)
    touch("touchStart", (300, 300))
    for k in range(1, 6):
        touch("touchMove", (300 + 20 * k, 300))
    touch("touchEnd")
    until(page, f"plotfeed.display.view.east < {before['east'] - 90 * before['scale']}")
    assert page.evaluate(view)["scale"] == before["scale"]


def test_the_card_of_a_fleet_opens_where_a_fleet_is_told_of(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    card = page.locator('[data-card="fleet"]')
    until(page, "plotfeed.picture.framesTaken > 1")
    assert not card.is_visible()
    row = {"sensors": ["a", "b", "c", "d"], "state": "RUNNING", "worker": "host:7", "claim": 2}
    told = {"part": "0-0", "age_s": 0.34, "lateness_p99_us": 1200.0} | row
    gaps = ["nothing of part 0-0: 0.50 s, since host:6 died"]
    news = {"parts": [told], "takeovers": 1, "gaps": 1, "last_gaps": gaps}
    served.call(lambda: stage.view.tell(fleet=news))
    until(page, "document.getElementById('fleet-rows').checkVisibility()")
    line = "0-0.2 RUNNING host:7: a, b and 2 more; heard 0.3 s ago, late by 1.20 ms (p99)"
    for said in ("Parts 1, take-overs 1", line, *gaps):
        assert said in card.inner_text()
