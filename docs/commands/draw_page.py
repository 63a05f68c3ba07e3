"""Draws docs/page-dark.png, page-light.png and page-phone.png: the live page of scene field-day.

Needs Chromium and the extra test-page. python docs/commands/draw_page.py [FOLDER]
With a folder, the page is drawn there too as it is at five sizes, in both themes, as presenter and
as audience, with the tour and with all cards: to be looked at after a change of its looks.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
from itertools import product
from pathlib import Path
from typing import Literal

from playwright.async_api import Browser, Page, ViewportSize, async_playwright

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.page_sessions import PageSessions
from plotfeed.feeds.page.run_with_page import alongside
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.shown import tracks_to_show
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import example
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import WallClock

DOCS = Path(__file__).parents[1]
START_UTC_NS = 1_767_268_800_000_000_000
SECONDS = 70.0
TRACKS_TOPIC = "plotfeed/tower/asterix/062"
OPTIONS = ["--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
WINDOW: ViewportSize = {"width": 1680, "height": 1000}
PHONE: ViewportSize = {"width": 360, "height": 740}
SIZES: tuple[ViewportSize, ...] = (
    PHONE,
    {"width": 960, "height": 640},
    {"width": 1280, "height": 720},
    {"width": 1920, "height": 1080},
    {"width": 2560, "height": 1440},
)
Theme = Literal["dark", "light"]
THEMES: tuple[Theme, ...] = ("dark", "light")


async def draw(folders: list[Path]) -> None:
    """Run the scene, look at it."""
    shown, view = example("field-day"), View()
    sessions = PageSessions(shown, view, Path("nowhere"))
    basemap = str(shown.page.basemap)
    sessions.basemap = load_basemap(basemap, shown.file(basemap), shown.scene.site)
    site = site_frame(shown.scene.site)

    def tap(message: Message, _sent_utc_ns: int) -> None:
        if message.topic == TRACKS_TOPIC:
            view.tracks(tracks_to_show(message.payload, None, sessions.now_utc_ns(), site))

    address = PageAddress("127.0.0.1", 0)
    async with (
        serving(address, view, sessions, sessions.now_utc_ns) as server,
        alongside(sessions.follow(), "page-follow"),
        async_playwright() as playwright,
    ):
        session = asyncio.create_task(
            run(
                shown,
                clock=WallClock(START_UTC_NS),
                broker="none",
                duration_s=SECONDS + 60,
                observers=[Tap(tap), sessions],
            )
        )
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=OPTIONS
        )
        dark = await _opened(browser, server.url, WINDOW, "dark")
        light = await _opened(browser, server.url, WINDOW, "light")
        phone = await _opened(browser, server.url, PHONE, "dark")
        await light.click("#truth")
        await light.get_by_role("button", name="gate").click()
        await asyncio.sleep(SECONDS)
        await dark.screenshot(path=DOCS / "page-dark.png")
        await phone.screenshot(path=DOCS / "page-phone.png")
        await _select(light)
        await light.screenshot(path=DOCS / "page-light.png")
        for folder in folders:
            await _draw_sizes(browser, server, folder)
        await browser.close()
        session.cancel()
    print(f"{DOCS}/page-dark.png, page-light.png, page-phone.png")


async def _opened(browser: Browser, url: str, window: ViewportSize, theme: Theme) -> Page:
    """A page that has its first plots, without the tour."""
    page = await browser.new_page(viewport=window, color_scheme=theme)
    await page.goto(url)
    while not await page.evaluate("globalThis.plotfeed?.picture.plots.end > 0"):
        await page.wait_for_timeout(100)  # its policy lets nothing be evaluated from within
    await page.click("#tour-skip")
    return page


async def _draw_sizes(browser: Browser, server: PageServer, folder: Path) -> None:
    for window, theme in product(SIZES, THEMES):
        for kind, url in (("", server.url), ("-audience", server.audience_url)):
            page = await _opened(browser, url, window, theme)
            name = f"{window['width']}-{theme}{kind}.png"
            if not kind:
                await page.click("#truth")
                await _select(page)
            await page.wait_for_timeout(4000)
            await page.screenshot(path=folder / name)
            if window is PHONE and not kind:
                await page.screenshot(path=folder / f"whole-{name}", full_page=True)
            await page.close()
        page = await _opened(browser, url, window, theme)
        await page.click("#help-button")
        await page.click("#connect-button")
        await page.click("#tour-start")
        await page.screenshot(path=folder / f"{window['width']}-{theme}-help.png")
        await page.close()


async def _select(page: Page) -> None:
    """The newest plot of a drone."""
    await page.evaluate(
        """() => {
          const { picture: { plots }, display } = plotfeed;
          for (let row = plots.end - 1; row >= plots.begin; row--) {
            const at = plots.at(row);
            if (plots.drone[at] >= 0 && plots.sensor[at] === 1 && !plots.flags[at])
              return display.select({ kind: "plot", row, at });
          }
        }"""
    )
    await page.wait_for_timeout(300)


if __name__ == "__main__":
    wanted = [Path(folder) for folder in sys.argv[1:2]]
    for folder in wanted:
        folder.mkdir(parents=True, exist_ok=True)
    asyncio.run(draw(wanted))
