"""Presenter and audience in two browsers: who sees what; pictures, maps and grids of their own."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.chromium import looking, until
from support.made_up_session import MadeUpSession
from support.page_server import Served, clock_button, wait_for_command

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NEAR = {"type": "Point", "coordinates": [-3.73, 40.45]}  # The site of the made-up session


FIGURES = {
    "gospa_m": 12.34,
    "ospa_m": 8.7,
    "completeness": 0.75,
    "spuriousness": 0.25,
    "position_error_m": 5.61,
    "latency_s": 0.042,
    "latency_p95_s": None,
}
AZIMUTH = {
    "sensor": "radar-3", "check": "azimuth", "unit": "deg", "claimed": 0.0, "found": 2.013,
    "z": 37.1, "of": 58, "wrong": True, "why_not": "",
}  # fmt: skip


def score(second: int, *feed: dict[str, Any]) -> dict[str, Any]:
    return {
        "time_utc": f"2026-01-01T12:00:{second:02}Z", "tracks_topic": "tracker/tracks",
        "cutoff_m": 50.0, "drones": 4, "tracks": 4,
        "reports": 100, "unreadable": 3, "problem": "a track of the future", "now": FIGURES,
        "window_s": second, "window": FIGURES, "feed_false_rate": 0.01, "feed": list(feed),
    }  # fmt: skip


@pytest.mark.usefixtures("goes_on")
def test_the_audience_sees_and_does_what_the_presenter_gives(
    browser: Browser, page: Page, served: Served, stage: MadeUpSession
) -> None:
    with looking(browser, f"{served.url}audience/") as other:
        truth = other.get_by_role("button", name="Truth")
        pause = clock_button(other, "Pause")
        assert truth.is_disabled()
        for name in ("Pause", "Step 1 s", "Restart", "Record", "Load", "Replay"):
            assert other.get_by_role("button", name=name).first.is_disabled(), name
        assert other.get_by_role("button", name="Connect here").is_enabled()
        assert other.evaluate("document.getElementById('sensor-form').inert")
        until(other, "document.getElementById('total-drones').textContent === '–'")
        other.get_by_text("has not given the audience the controls").first.wait_for()
        page.get_by_role("button", name="Cards").click()
        page.get_by_role("checkbox", name="Audience").check()
        page.keyboard.press("Escape")
        assert page.get_by_label("Its address").input_value() == f"{served.url}audience/"
        page.get_by_role("checkbox", name="It may use the controls").check()
        until(other, "!document.getElementById('pause').disabled")
        pause.click()
        wait_for_command(other, stage, {"clock": {"paused": True}})
        page.get_by_role("checkbox", name="It may see the truth").check()
        until(other, "!document.getElementById('truth').disabled")
        truth.click()
        until(other, "plotfeed.picture.drones !== null")
        page.get_by_role("checkbox", name="It may see the truth").uncheck()
        until(other, "plotfeed.picture.drones === null")
        until(other, "document.getElementById('truth').disabled")
        done = page.get_by_label("Actions, the newest first")
        for who, what in (
            ("presenter 1", "audience: controls"),
            ("audience 1", "clock: paused"),
            ("presenter 1", "audience: truth false"),
        ):
            done.get_by_text(f"{who} {what}").last.wait_for()


def test_the_picture_is_saved_as_it_is(page: Page) -> None:
    with page.expect_download() as saving:
        page.get_by_role("button", name="PNG").click()
    assert saving.value.suggested_filename.startswith("plotfeed-road-")
    data = Path(saving.value.path()).read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", data[16:24])
    canvas = "[document.getElementById('screen').width, document.getElementById('screen').height]"
    wide, high = page.evaluate(canvas)
    assert width == wide
    assert high < height < high + 100


def test_a_map_of_ones_own_lies_where_it_is_and_what_is_none_is_told(page: Page) -> None:
    named = {"type": "Feature", "geometry": NEAR, "properties": {"name": "Here"}}

    def choose(content: object) -> None:
        text = content if isinstance(content, str) else json.dumps(content)
        file = {"name": "mine.geojson", "mimeType": "application/json", "buffer": text.encode()}
        page.get_by_label("Own map").set_input_files(file)  # type: ignore[arg-type]

    page.get_by_role("button", name="Zoom in").click(click_count=3)
    choose(named)
    page.get_by_text("Map: mine.geojson").wait_for()
    until(page, "plotfeed.display.placed.some((p) => p[4] === 'Here')")
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
    choose({"type": "Topology"})
    page.get_by_text("expected a GeoJSON geometry").wait_for()


def test_the_grid_has_squares_in_place_of_rings(page: Page) -> None:
    words = "plotfeed.display.placed.map((p) => p[4])"
    until(page, f"{words}.includes('090°')")
    page.get_by_label("Grid").select_option("squares")
    until(page, f"{words}.some((w) => w.endsWith(' E')) && !{words}.includes('090°')")
    page.locator("#scale").get_by_text("squares ").wait_for()
    page.get_by_label("Grid").select_option("none")
    until(page, f"!{words}.some((w) => w.endsWith(' E') || w.endsWith('°'))")


def test_the_score_is_shown_with_the_truth_alone(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    card = page.locator('[data-card="score"]')
    served.call(lambda: stage.view.score(score(1)))
    frames = page.evaluate("plotfeed.picture.framesTaken")
    until(page, f"plotfeed.picture.framesTaken > {frames + 3}")
    assert not card.is_visible()
    page.get_by_role("button", name="Truth").click()
    until(page, "document.getElementById('score-body').checkVisibility()")
    words = card.inner_text()
    for told in ("12.3 m", "75 %", "25 %", "5.6 m", "0.04 s", "3 reports of tracks left out"):
        assert told in words
    assert "nothing to judge yet" in words
    served.call(lambda: stage.view.score(score(2, AZIMUTH)))
    told = "Feed differs from its claims: radar-3: azimuth 2.01 deg"
    until(page, f"document.getElementById('score-feed').textContent === '{told}'")
    unheard = dict.fromkeys(FIGURES)
    silent = {"reports": 0, "tracks": 0, "unreadable": 0, "now": unheard, "window": unheard}
    served.call(lambda: stage.view.score(score(3) | silent))
    until(page, "document.getElementById('score-values').hidden")
    words = card.inner_text()
    assert "No tracks have come on tracker/tracks" in words
    assert "GOSPA" not in words
    assert not page.locator("#score-strip").is_visible()
    page.get_by_role("button", name="Truth").click()
    until(page, "document.getElementById('score-body').hidden")
    assert "Shown with the truth" in card.inner_text()
    assert "radar-3" not in card.inner_text()
