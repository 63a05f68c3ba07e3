"""The page as a whole: its network, its sizes, who can read it."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from support import made_up_session
from support.brokers import free_port
from support.chromium import (
    THEME,
    broken_rules,
    looking,
    new_context,
    requests,
    until,
    until_shown,
    wait_beside,
)
from support.made_up_session import MadeUpSession
from support.page_server import Served, clock_button, on_stage, wait_for_command

from plotfeed import testing
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Whether the strip tells what was detected beside what the looks' own odds come to.
PREDICTED_AS_TOLD = """(() => {
  const sum = (numbers) => numbers.reduce((a, b) => a + b, 0);
  const shown = document.getElementById("pd-text").textContent;
  return Object.values(plotfeed.picture.news.details ?? {}).some(({ detections: of }) => {
    const [detected, expected] = [of.detected, of.expected].map((all) => sum(all) / sum(of.looks));
    return detected !== expected
      && shown === `${detected.toFixed(3)}, predicted ${expected.toFixed(3)}`;
  });
})()"""


def test_two_browsers_see_the_same_and_what_either_changes(
    browser: Browser, page: Page, served: Served
) -> None:
    def ask(of: Page, name: str, value: str) -> None:
        of.get_by_label(name, exact=True).fill(value)
        of.get_by_role("button", name="Apply").click()

    with looking(browser, served.url) as other:
        ask(page, "Latency", "333")
        other.locator("#latency-now").get_by_text("333 ms").wait_for()
        assert other.get_by_label("Latency", exact=True).input_value() == "333"
        ask(other, "Jitter", "20")
        page.locator("#jitter-now").get_by_text("20 ms").wait_for()
        state = page.locator("#sensors tr").first.locator("td").last
        for name in ("Off", "On"):
            other.get_by_role("radio", name=name, exact=True).check()
            state.get_by_text(name.lower(), exact=True).wait_for()
        for presser, name, then, watcher in (
            (page, "Go on", "Pause", other),
            (other, "Pause", "Go on", page),
        ):
            clock_button(presser, name).click()
            clock_button(watcher, then).wait_for()
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
    address = PageAddress("127.0.0.1", free_port())
    again = MadeUpSession(View(), made_up_session.scene(5))
    with (
        ExitStack() as first,
        looking(browser, first.enter_context(on_stage(stage, address=address)).url) as page,
    ):
        page.get_by_role("button", name="Truth").click()
        until(page, "plotfeed.picture.drones !== null")
        assert page.locator("#veil").is_hidden()
        first.close()
        page.locator("#veil").get_by_text("Connection lost").wait_for()
        assert "lost" in page.locator("#connection").inner_text()
        asked = page.evaluate("plotfeed.feed.ask({ clock: { paused: true } })")
        assert asked["ok"] is False
        with on_stage(again, address=address):
            page.locator("#veil").wait_for(state="hidden")
            until(page, "plotfeed.picture.drones?.rows === 5")  # the truth is asked again
            page.get_by_text("Connected").wait_for()
            page.get_by_label("Latency", exact=True).fill("250")
            page.get_by_role("button", name="Apply").click()
            wanted = {"sensor": "radar", "set": {"link": {"latency_ms": 250}}}
            wait_for_command(page, again, wanted)
            page.locator("#latency-now").get_by_text("250 ms").wait_for()


def test_a_page_whose_token_is_old_says_so(browser: Browser, stage: MadeUpSession) -> None:
    wide = PageAddress("0.0.0.0", free_port())  # noqa: S104 - with a token
    link = f"http://127.0.0.1:{wide.port}/?token=one"
    with ExitStack() as first:
        first.enter_context(on_stage(stage, address=wide, tokens=Tokens("one")))
        with looking(browser, link) as page:
            assert "token" not in page.url
            first.close()
            with on_stage(stage, address=wide, tokens=Tokens("other")):
                page.locator("#veil").get_by_text("The address has changed").wait_for()


def test_no_request_leaves_for_anybody_else(browser: Browser, served: Served) -> None:
    context = new_context(browser)
    page = context.new_page()
    asked = requests(context, page)
    page.goto(served.url)
    until_shown(page)
    for name in ("Truth", "Light", "Zoom in", "Show all sensors"):
        page.get_by_role("button", name=name, exact=True).click()
    for name in ("Go on", "Pause", "Step 1 s", "Restart"):
        clock_button(page, name).click()
    page.get_by_label("Latency", exact=True).fill("10")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("In force.").wait_for()
    basemap = Basemap("application/json", b'{"lines": [], "areas": [], "points": []}')
    scene = testing.scene([testing.radar(id="north")], seed=1)
    served.call(lambda: served.server._view.scene(scene, basemap))
    page.get_by_role("heading", name="north: settings").wait_for()
    host = f"127.0.0.1:{served.port}"
    wait_beside(page, lambda: any(url.startswith(f"http://{host}/basemap") for url in asked))
    context.close()
    assert len(asked) > 10
    assert f"ws://{host}/feed" in asked
    assert not [url for url in asked if not url.startswith((f"http://{host}/", f"ws://{host}/"))]


def test_no_rule_of_accessibility_is_broken(browser: Browser, served: Served) -> None:
    with looking(browser, served.url, color_scheme="light", bypass_csp=True) as page:
        assert page.evaluate(THEME) == "light"
        page.get_by_role("button", name="Truth").click()
        page.get_by_role("application").press("n")
        page.get_by_text("Plot of").wait_for()
        served.call(lambda: served.server._view.tell(refusal="telemetry/x: it was no telemetry"))
        page.get_by_text("Last refused").wait_for()
        assert not broken_rules(page)


def test_totals_rates_and_refusals_are_told(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    until(page, "document.getElementById('total-plots').textContent !== '0'")
    assert page.locator("#total-drones").inner_text() == "16"
    served.call(lambda: served.server._view.tell(refusal="plotfeed/telemetry/x: missing: time_utc"))
    page.get_by_text("Last refused: plotfeed/telemetry/x: missing: time_utc").wait_for()
    words = "document.getElementById('latency-text').textContent"
    until(page, rf"/^asked 120, is 1[12]\d ± \d+ ms$/.test({words})")
    until(page, PREDICTED_AS_TOLD)
