"""The browser that this machine has, driven for tests; they skip where there is none."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import urljoin

import pytest
from support.tools import needed, node_module
from support.waiting import PATIENCE_S, wait_until

if TYPE_CHECKING:
    from playwright.sync_api import (
        Browser,
        BrowserContext,
        ConsoleMessage,
        Error,
        Page,
        ViewportSize,
    )

OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
    "--disable-background-timer-throttling",
)
# All pages: to begin another one costs more than a page.
IN_ONE_PROCESS = (
    "--disable-site-isolation-trials",
    "--process-per-site",
    "--renderer-process-limit=1",
)
VIEWPORT: ViewportSize = {"width": 1280, "height": 720}
UNTIL = """async ([argument, patienceMs]) => {
  for (const since = performance.now(); performance.now() - since < patienceMs; ) {
    const found = (%s);
    if (typeof found === "function" ? found(argument) : found) return true;
    await new Promise((again) => setTimeout(again, 20));
  }
  return false;
}"""
_left: dict[Browser, Page] = {}  # A page of each browser that nobody looks at
THEME = "document.documentElement.dataset.theme"


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser in a folder of its own; skips the test where there is none to drive."""
    path = needed("chromium")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*OPTIONS, *IN_ONE_PROCESS])
        try:
            yield browser
        finally:
            _left.pop(browser, None)
            browser.close()


def new_context(browser: Browser, **more: Any) -> BrowserContext:
    """Of somebody who wants little motion, which leaves a busy machine to others."""
    usual = {"viewport": VIEWPORT, "color_scheme": "dark", "reduced_motion": "reduce"}
    context = browser.new_context(**(usual | more))
    context.set_default_timeout(PATIENCE_S * 1000)
    return context


@contextmanager
def looking(browser: Browser, url: str, **more: Any) -> Iterator[Page]:
    """A page that has drawn its first plots, and that nothing goes wrong on.

    Without wishes it is one that somebody has left, if there is any: a page costs more to make than
    to load, and nothing is kept on it.
    """
    page = (None if more else _left.pop(browser, None)) or new_context(browser, **more).new_page()
    try:
        with _problems(page) as problems:
            if page.viewport_size != VIEWPORT and not more:
                page.set_viewport_size(VIEWPORT)
            page.goto(url)
            until_shown(page)
            yield page
            # A connection that was lost on purpose is told on the console by the browser itself.
            assert not [p for p in problems if "ERR_CONNECTION_REFUSED" not in p and "403" not in p]
        if not more and _emptied(page, url):
            _left.setdefault(browser, page)
    finally:
        if _left.get(browser) is not page:
            page.context.close()


def _emptied(page: Page, url: str) -> bool:
    """Forget what was done on a page; whether that worked: who served it may have gone."""
    from playwright import sync_api

    page.mouse.move(0, 0)
    page.evaluate("localStorage.clear()")
    page.context.clear_cookies()
    try:
        page.goto(urljoin(url, "/icon.svg"))  # of the same site, and thus of the same process
    except sync_api.Error:
        return False
    return True


@contextmanager
def _problems(page: Page) -> Iterator[list[str]]:
    """What goes wrong on a page meanwhile."""
    found: list[str] = []

    def on_error(error: Error) -> None:
        found.append(str(error))

    def on_console(said: ConsoleMessage) -> None:
        if said.type == "error":
            found.append(said.text)

    page.on("pageerror", on_error)
    page.on("console", on_console)
    yield found
    page.remove_listener("pageerror", on_error)
    page.remove_listener("console", on_console)


def until(page: Page, expression: str, argument: Any = None) -> None:
    """Wait until it holds, or what the function gives; the page itself asks, again and again."""
    from playwright import sync_api

    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        left_s = deadline_s - time.monotonic()
        assert left_s > 0, f"it never was so that {expression}"
        try:
            if page.evaluate(UNTIL % expression, [argument, 1e3 * left_s]):
                return
        except sync_api.Error as error:
            if "context was destroyed" not in error.message:  # as when another page is loaded
                raise


def until_shown(page: Page) -> None:
    """Wait until a page that is loaded shows the scene and its first plots."""
    until(page, "globalThis.plotfeed?.picture.plots.end > 0 && plotfeed.display.isFitted")
    drawn(page)


def drawn(page: Page) -> None:
    """Return when all that the page knows of is drawn, where it lies now."""
    page.evaluate(
        """async () => {
          const { display } = plotfeed, enough = display.framesDrawn + 2;
          while (display.framesDrawn < enough) {
            display.redraw();
            await new Promise(requestAnimationFrame);
          }
        }"""
    )


def wait_beside(
    page: Page, holds: Callable[[], object], says: str = "it never came to that"
) -> None:
    """Return when it holds; meanwhile the page goes on."""
    wait_until(holds, says, pause=lambda _: page.wait_for_timeout(40))


def requests(context: BrowserContext, page: Page) -> list[str]:
    """Addresses that the page asks for from now on, WebSockets among them; grows as it does."""
    asked: list[str] = []
    network = context.new_cdp_session(page)
    network.on("Network.requestWillBeSent", lambda event: asked.append(event["request"]["url"]))
    network.on("Network.webSocketCreated", lambda event: asked.append(event["url"]))
    network.send("Network.enable")
    return asked


def broken_rules(page: Page) -> list[tuple[str, str, str]]:
    """Rules of accessibility that the page breaks, by axe-core; skips where that is missing.

    In both themes those of colours, which are all that a theme changes.
    """
    axe = node_module("axe-core") / "axe.min.js"
    # Evaluated and not added as a script, which the page's own policy would refuse.
    page.evaluate(axe.read_text())
    found = page.evaluate("axe.run()")["violations"]
    before = page.evaluate(THEME)
    page.locator("#theme").click()
    assert page.evaluate(THEME) != before
    found += page.evaluate("axe.run({ runOnly: ['color-contrast', 'link-in-text-block'] })")[
        "violations"
    ]
    return [(rule["impact"], rule["id"], rule["nodes"][0]["html"]) for rule in found]
