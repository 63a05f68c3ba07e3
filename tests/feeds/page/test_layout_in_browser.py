"""Nothing of the page is cut off or covered, from a phone to a wall of 2560 pixels; cards move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from support.chromium import drawn, until, until_shown
from support.page_server import Served

if TYPE_CHECKING:
    from playwright.sync_api import Page

SIZES = ((360, 740), (960, 640), (1280, 720), (1920, 1080), (2560, 1440))
# Of windows in which the picture has two thirds.
ON_A_DESK = ((1280, 720), (1920, 1080), (2560, 1440))
SCROLLS_BELOW_PX = 860  # A narrower window has everything one below the other, and the page scrolls
TWO_THIRDS = 2 / 3
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


@pytest.mark.usefixtures("goes_on")
def test_nothing_is_cut_off_or_covered(page: Page) -> None:
    page.get_by_role("button", name="Truth").click()
    page.get_by_label("Fade").select_option("60")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("scrollTo(0, 0)")
        page.get_by_role("application").press("0")
        page.get_by_role("application").press("n")
        page.get_by_text("Plot of").wait_for()
        until(page, "plotfeed.picture.seconds.length >= 2")
        until(page, "plotfeed.picture.drones !== null && plotfeed.display.words.length > 20")
        drawn(page)
        at = f"at {width} x {height}"
        assert not page.evaluate(CUT_OFF), at
        assert not page.evaluate(WORDS_OVER_WORDS), at
        scrolls = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
        wide, high = page.evaluate(scrolls)
        assert wide == width
        if width >= SCROLLS_BELOW_PX:
            assert high == height
        assert not page.evaluate(COVERED), at
        if (width, height) in ON_A_DESK:
            box = page.locator("#display").bounding_box()
            assert box
            assert box["width"] * box["height"] >= TWO_THIRDS * width * height, at


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
def test_no_axis_is_cut_off_where_all_is_lost(page: Page) -> None:
    page.set_viewport_size({"width": 2560, "height": 1440})
    page.reload()
    until_shown(page)
    until(page, "plotfeed.picture.seconds.length > 0")
    page.evaluate("for (const second of plotfeed.picture.seconds) second.lost = 1e6")
    assert not page.evaluate(BESIDE_THE_CHART)


@pytest.mark.usefixtures("goes_on")
def test_nothing_jumps_while_the_page_is_used(page: Page) -> None:
    page.set_viewport_size({"width": 1920, "height": 1080})
    drawn(page)
    assert not page.evaluate(MOVED, PARTS)
    page.get_by_role("button", name="Truth").click()
    page.get_by_role("application").press("n")
    page.get_by_label("Pfa", exact=True).fill("7")
    page.get_by_role("button", name="Apply").click()
    page.locator("#answer[data-failed]").wait_for()
    until(page, "plotfeed.picture.seconds.length >= 2")
    drawn(page)
    assert not page.evaluate(MOVED, PARTS)


def test_a_card_is_moved_put_back_closed_and_opened_again(page: Page) -> None:
    card = page.locator("[data-card=totals]")
    before = card.bounding_box()
    assert before
    page.get_by_role("button", name="Move totals").click()
    page.get_by_role("button", name="Put back totals").press("ArrowUp")
    moved = card.bounding_box()
    assert moved
    assert moved["x"] + moved["width"] <= before["x"]
    assert moved["y"] < before["y"] or moved["y"] == 0
    page.reload()
    until_shown(page)
    kept = card.bounding_box()
    assert kept
    assert (kept["x"], kept["y"]) == pytest.approx((moved["x"], moved["y"]), abs=1)
    page.get_by_role("button", name="Put back totals").click()
    back = card.bounding_box()
    assert back
    assert back["x"] == pytest.approx(before["x"])
    page.get_by_role("button", name="Close totals").click()
    assert card.is_hidden()
    page.get_by_role("button", name="Cards").click()
    page.get_by_role("checkbox", name="Totals").check()
    assert card.is_visible()
    page.keyboard.press("Escape")
    assert page.locator("#cards-list").is_hidden()


def test_a_card_is_dragged_by_its_head(page: Page) -> None:
    head = page.get_by_role("heading", name="Sensors", exact=True).bounding_box()
    assert head
    x, y = head["x"] + 20, head["y"] + 8
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 300, y + 150, steps=4)
    page.mouse.up()
    box = page.locator("[data-card=sensors]").bounding_box()
    assert box
    dragged = page.get_by_role("heading", name="Sensors", exact=True).bounding_box()
    assert dragged
    assert (dragged["x"], dragged["y"]) == pytest.approx((head["x"] - 300, head["y"] + 150), abs=20)


def test_sensors_that_stand_together_are_all_named_and_no_words_lie_over_others(
    page: Page, served: Served
) -> None:
    from plotfeed import testing

    together = [
        testing.radar(id=f"radar-{i}", position_enu_m=[10.0 * i, 0.0, 5.0]) for i in range(9)
    ]
    scene = testing.scene(together, seed=1)
    served.call(lambda: served.server._view.scene(scene))
    page.get_by_role("heading", name="radar-0: settings").wait_for()
    until(page, "plotfeed.display.words.filter((w) => w[4].startsWith('radar-')).length === 9")
    assert not page.evaluate(WORDS_OVER_WORDS)


def test_a_stranger_is_told_what_there_is_and_the_tour_is_not_shown_again(page: Page) -> None:
    words = page.locator("#words")
    tour = page.get_by_role("group", name="Tour")
    for step in range(1, 8):
        assert words.inner_text().startswith(f"{step} of 7: ")
        assert page.locator(".toured").count() == 1
        page.locator("#tour-next").click()
    assert tour.is_hidden()
    assert "radar" in words.inner_text()
    page.reload()
    until_shown(page)
    assert tour.is_hidden()
    page.get_by_role("application").press("?")
    page.get_by_role("button", name="Show the tour").click()
    page.get_by_role("button", name="Skip the tour").click()
    assert tour.is_hidden()
    keys = page.get_by_role("table", name="Keys").inner_text()
    assert "zooms in" in keys
    assert "Space" in keys
