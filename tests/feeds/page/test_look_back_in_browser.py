"""Looking back over the last minutes while the session goes on, and the marks of the time line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from support import made_up_session
from support.chromium import looking, until
from support.made_up_session import MOST_AT_ONCE_S, MadeUpSession
from support.page_server import Served, clock_button, on_stage, wait_for_command

from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PLOTS = """({ plots }) => {
  const found = [];
  for (let row = plots.begin; row < plots.end; row++) {
    const at = plots.at(row);
    found.push([plots.shown_ms[at], plots.t_utc_ms[at], plots.sensor[at], plots.east_m[at] || 0]);
  }
  return found;
}"""


@pytest.fixture(scope="module")
def stage() -> MadeUpSession:
    """Of all tests here, as what they look back at takes seconds to come."""
    return MadeUpSession(View(), made_up_session.scene(16))


@pytest.fixture(scope="module")
def served(stage: MadeUpSession) -> Iterator[Served]:
    with on_stage(stage) as served:
        yield served


@pytest.fixture(scope="module")
def shared(browser: Browser, served: Served) -> Iterator[Page]:
    with looking(browser, served.url) as page:
        until(page, "plotfeed.past.latestMs - plotfeed.past.oldestMs > 4000")
        yield page


@pytest.fixture
def watched(shared: Page) -> Page:
    """A page that has looked for some seconds, and looks at what is now."""
    shared.evaluate("document.getElementById('now').click()")
    return shared


def looked_at_ms(page: Page) -> float:
    return float(page.evaluate("plotfeed.display.picture.nowMs(performance.now())"))


def test_what_is_looked_back_at_is_what_there_was_and_the_live_goes_on(watched: Page) -> None:
    page = watched
    held_ms, then = page.evaluate(f"""() => {{
      document.getElementById("hold").click();
      return [plotfeed.display.picture.nowMs(0), ({PLOTS})(plotfeed.picture)];
    }}""")
    assert len(then) > 10
    newest = f"Math.max(...({PLOTS})(plotfeed.picture).map(([shown_ms]) => shown_ms))"
    until(page, f"{newest} > {held_ms} + 1000")
    # What was on its way to a slow browser is of that time too.
    shown = page.evaluate(f"({PLOTS})(plotfeed.display.picture)")
    assert [plot for plot in shown if plot in then] == then
    # A frame may bring what the session has worked out ahead, and no more of what came later.
    assert max(shown_ms for shown_ms, *_ in shown) <= held_ms + 1e3 * MOST_AT_ONCE_S
    assert looked_at_ms(page) == held_ms
    assert page.evaluate("plotfeed.display.picture.drones") is None
    page.get_by_label("Look back").fill("-3")
    page.locator("#back-text").get_by_text("Looking back").wait_for()
    assert looked_at_ms(page) <= page.evaluate("plotfeed.picture.nowMs(performance.now())") - 3000
    page.get_by_role("button", name="Back to now").click()
    page.locator("#back-text").get_by_text("Now", exact=True).wait_for()
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")
    assert page.get_by_role("button", name="Back to now").is_disabled()


def test_what_is_looked_back_at_goes_on_behind_the_live_as_far_as_was_asked(watched: Page) -> None:
    page = watched
    page.get_by_role("application").press("[")
    page.get_by_text("Looking back").first.wait_for()
    now_ms = "plotfeed.{}.nowMs(performance.now())"
    behind_ms = f"{now_ms.format('picture')} - {now_ms.format('display.picture')}"
    back_ms = page.evaluate(behind_ms)
    assert back_ms > 3000
    before_ms = looked_at_ms(page)
    until(page, f"plotfeed.display.picture.nowMs(performance.now()) > {before_ms} + 500")
    assert abs(page.evaluate(behind_ms) - back_ms) < 50
    page.get_by_role("application").press("l")
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")


def test_a_story_leaves_a_mark_to_which_one_goes_back(watched: Page, stage: MadeUpSession) -> None:
    page = watched
    marks = page.get_by_label("Go to a mark")
    assert marks.is_disabled()
    page.get_by_role("button", name="Outage of radar").click()
    wait_for_command(page, stage, {"story": "outage"})
    page.get_by_role("button", name="Outage of radar", pressed=True).wait_for()
    for strip in ("plots", "latency", "loss", "pd", "late"):
        label = f"document.getElementById('{strip}-strip').getAttribute('aria-label')"
        until(page, f"{label}.includes('Outage of radar')")
    told_ms = page.evaluate("plotfeed.picture.news.marks.at(-1).t_utc_ms")
    until(page, "ms => plotfeed.picture.nowMs(performance.now()) > ms + 1500", told_ms)
    clock_button(page, "Pause").click()
    until(page, "plotfeed.picture.pace === 0")
    page.get_by_role("button", name="Hold").click()
    marks.select_option(index=1)
    page.get_by_text("Looking back").first.wait_for()
    assert looked_at_ms(page) == pytest.approx(told_ms - 1000, abs=1)
    page.get_by_role("button", name="Back to now").click()
    clock_button(page, "Go on").click()
    until(page, "plotfeed.picture.pace === 1")
    page.get_by_role("button", name="Outage of radar").click()
    wait_for_command(page, stage, {"story": "outage", "reset": True})
    page.get_by_role("button", name="Outage of radar", pressed=False).wait_for()
    page.get_by_role("button", name="Undo").click()
    wait_for_command(page, stage, {"undo": True})


def test_the_truth_of_then_is_hidden_with_that_of_now(watched: Page) -> None:
    page = watched
    truth = page.get_by_role("button", name="Truth")
    truth.click()
    until(page, "plotfeed.picture.drones !== null")
    since_ms = page.evaluate("plotfeed.picture.nowMs(performance.now())")
    until(page, "ms => plotfeed.picture.nowMs(performance.now()) > ms + 1500", since_ms)
    page.get_by_role("button", name="Hold").click()
    page.get_by_label("Look back").fill("-0.5")
    until(page, "plotfeed.display.picture.drones?.rows === 16")
    truth.click()
    until(page, "plotfeed.picture.drones === null")
    assert page.locator("#table-of [value=drones]").is_disabled()
    hits = page.evaluate(
        """() => {
          const { display } = plotfeed, { view, picture } = display, { drones } = picture;
          return Array.from(drones.drone, (_, i) =>
            display.hit(view.x(drones.east_m[i]), view.y(drones.north_m[i]))?.kind);
        }"""
    )
    assert "drone" not in hits


def test_another_scene_has_no_past(watched: Page, served: Served, stage: MadeUpSession) -> None:
    page = watched
    page.get_by_label("Look back").fill("-2")
    page.get_by_text("Looking back").first.wait_for()
    view = served.server._view
    served.call(lambda: view.scene(stage.scene))
    page.locator("#back-text").get_by_text("Now", exact=True).wait_for()
    assert page.evaluate("plotfeed.display.picture === plotfeed.picture")
