"""The browser that this machine has, driven for tests; they skip where there is none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.waiting import PATIENCE_S, wait_until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
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
AXE = Path(__file__).parents[2] / ".node" / "node_modules" / "axe-core" / "axe.min.js"


def program() -> str | None:
    """Where the browser is; PLOTFEED_CHROMIUM may say."""
    given = os.environ.get("PLOTFEED_CHROMIUM")
    found = (shutil.which(name) for name in ((given,) if given else NAMES))
    return next((path for path in found if path), None)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser in a folder of its own; skips the test where there is none to drive."""
    path = program()
    if path is None:
        pytest.skip("no Chromium is installed")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(OPTIONS))
        try:
            yield browser
        finally:
            browser.close()


def new_context(browser: Browser, **more: Any) -> BrowserContext:
    """Of somebody who wants little motion, which leaves a busy machine to others."""
    usual = {
        "viewport": {"width": 1280, "height": 720},
        "color_scheme": "dark",
        "reduced_motion": "reduce",
    }
    context = browser.new_context(**(usual | more))
    context.set_default_timeout(PATIENCE_S * 1000)
    return context


@contextmanager
def looking(browser: Browser, url: str, **more: Any) -> Iterator[Page]:
    """A page that has its first plots, and that nothing goes wrong on."""
    context = new_context(browser, **more)
    page = context.new_page()
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
    page.goto(url)
    until(page, "plotfeed.picture.plots.end > 0")
    try:
        yield page
        # A connection that was lost on purpose is told on the console by the browser itself.
        assert not [p for p in problems if "ERR_CONNECTION_REFUSED" not in p and "403" not in p]
    finally:
        context.close()


def until(page: Page, expression: str, argument: Any = None) -> None:
    """Wait until it holds; asked again and again, as the page's policy lets it evaluate nothing."""
    wait_until(
        lambda: page.evaluate(expression, argument),
        f"it never was so that {expression}",
        pause=lambda s: page.wait_for_timeout(s * 1e3),
    )


def requests(context: BrowserContext, page: Page) -> list[str]:
    """Addresses that the page asks for from now on, WebSockets among them; grows as it does."""
    asked: list[str] = []
    network = context.new_cdp_session(page)
    network.on("Network.requestWillBeSent", lambda event: asked.append(event["request"]["url"]))
    network.on("Network.webSocketCreated", lambda event: asked.append(event["url"]))
    network.send("Network.enable")
    return asked


def axe(page: Page) -> list[dict[str, Any]]:
    """Rules of accessibility that the page breaks, by axe-core; skips where that is missing."""
    if not AXE.exists():
        pytest.skip("axe-core is not installed: npm was not there")
    # Evaluated and not added as a script, which the page's own policy would refuse.
    page.evaluate(AXE.read_text())
    result: dict[str, Any] = page.evaluate("axe.run()")
    found: list[dict[str, Any]] = result["violations"]
    return found
