"""Draws docs/page-dark.png and page-light.png: the live page of scene field-day, in a browser.

Needs Chromium and the extra test-page. python docs/commands/draw_page.py
"""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

from playwright.async_api import Page, async_playwright

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.run_with_page import PageObserver, alongside
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.tracker_tracks import decode_tracks
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


async def draw() -> None:
    """Run the scene, look at it twice."""
    shown, view = example("field-day"), View()
    observer = PageObserver(view)
    basemap = str(shown.page.basemap)
    observer.scene(load_basemap(basemap, shown.file(basemap), shown.scene.site))
    site = site_frame(shown.scene.site)

    def tap(message: Message, _sent_utc_ns: int) -> None:
        if message.topic == TRACKS_TOPIC:
            view.tracks(decode_tracks(message.payload, observer.now_utc_ns(), site))

    server = PageServer(PageAddress("127.0.0.1", 0), view, observer, observer.now_utc_ns)
    async with (
        serving(server) as url,
        alongside(observer.follow(), "page-follow"),
        async_playwright() as playwright,
    ):
        session = asyncio.create_task(
            run(
                shown,
                clock=WallClock(START_UTC_NS),
                broker="none",
                duration_s=SECONDS + 60,
                observers=[Tap(tap), observer],
            )
        )
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=OPTIONS
        )
        window = {"width": 1680, "height": 1000}
        dark = await browser.new_page(viewport=window, color_scheme="dark")
        light = await browser.new_page(viewport=window, color_scheme="light")
        for page in (dark, light):
            await page.goto(url)
        await light.click("#truth")
        await light.get_by_role("button", name="gate").click()
        await asyncio.sleep(SECONDS)
        await dark.screenshot(path=DOCS / "page-dark.png")
        await _select(light)
        await light.screenshot(path=DOCS / "page-light.png")
        await browser.close()
        session.cancel()
    print(f"{DOCS}/page-dark.png, page-light.png")


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
    asyncio.run(draw())
