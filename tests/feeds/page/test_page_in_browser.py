"""The page as a whole: its network, its sizes, who can read it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from support import made_up_session
from support.chromium import axe, looking, new_context, requests, until
from support.made_up_session import MadeUpSession
from support.page_server import Served, on_stage

from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PREDICTED_AS_TOLD = """(() => {
  const sum = (numbers) => numbers.reduce((a, b) => a + b, 0);
  const shown = document.getElementById("pd-text").textContent;
  return Object.values(plotfeed.picture.news.details ?? {}).some(({ detections: of }) => {
    const [detected, expected] = [of.detected, of.expected].map((all) => sum(all) / sum(of.looks));
    return detected !== expected
      && shown === `${detected.toFixed(3)}, predicted ${expected.toFixed(3)}`;
  });
})()"""
"""Whether the strip tells what was detected beside what the looks' own odds come to."""


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


def test_a_link_with_its_token_works_from_another_site(
    browser: Browser, stage: MadeUpSession
) -> None:
    """As from a mail or a wiki: the cookie comes along when the browser is sent on."""
    token = "from-a-wiki-page-1"  # noqa: S105 - for this test alone
    with on_stage(stage, address=PageAddress("0.0.0.0", 0), tokens=Tokens(token)) as served:  # noqa: S104
        context = new_context(browser)
        page = context.new_page()
        link = f"http://127.0.0.1:{served.port}/?token={token}"
        page.route(
            "http://wiki.example/",
            lambda route: route.fulfill(
                content_type="text/html", body=f'<a href="{link}">the field day</a>'
            ),
        )
        page.goto("http://wiki.example/")
        page.get_by_role("link").click()
        until(page, "globalThis.plotfeed?.picture.plots.end > 0")
        assert token not in page.url
        context.close()


def test_a_lost_connection_is_said_and_comes_back_by_itself(
    browser: Browser, stage: MadeUpSession
) -> None:
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
    again = MadeUpSession(View(), made_up_session.scene(5))
    with on_stage(again, address=address) as served:
        page.locator("#veil").wait_for(state="hidden")
        until(page, "plotfeed.picture.drones?.rows === 5")  # the truth is asked again
        page.get_by_text("Connected").wait_for()
    context.close()


def test_a_page_whose_token_is_old_says_so(browser: Browser, stage: MadeUpSession) -> None:
    wide = PageAddress("0.0.0.0", 0)  # noqa: S104 - with a token
    with on_stage(stage, address=wide, tokens=Tokens("one")) as served:
        address = PageAddress(wide.host, served.port)
        context = new_context(browser)
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{served.port}/?token=one")
        until(page, "plotfeed.picture.plots.end > 0")
        assert "token" not in page.url
    with on_stage(stage, address=address, tokens=Tokens("other")):
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


def test_totals_rates_and_refusals_are_told(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    until(page, "document.getElementById('total-plots').textContent !== '0'")
    assert page.locator("#total-drones").inner_text() == "16"
    served.call(lambda: served.server._view.refusal("plotfeed/telemetry/x: missing: time_utc"))
    page.get_by_text("Last refused: plotfeed/telemetry/x: missing: time_utc").wait_for()
    words = "document.getElementById('latency-text').textContent"
    until(page, rf"/^asked 120, is 1[12]\d ± \d+ ms$/.test({words})")
    until(page, PREDICTED_AS_TOLD)
