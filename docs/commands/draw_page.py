"""Draws docs/page-dark.png, page-light.png and page-phone.png: the live page of scene field-day.

Needs Chromium and the extra test-page. python docs/commands/draw_page.py [FOLDER]
With a folder, the page is drawn there too as it is at five sizes, in both themes, as presenter and
as audience, with the tour and with all cards: to be looked at after a change of its looks.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
from asyncio.subprocess import PIPE
from itertools import product
from pathlib import Path
from typing import Literal

from playwright.async_api import Browser, Page, ViewportSize, async_playwright

from plotfeed.feeds.page.page_access import AUDIENCE_PATH

DOCS = Path(__file__).parents[1]
SECONDS = 70.0
DEMO = (sys.executable, "-um", "plotfeed.feeds.cli", "demo", "--page", "127.0.0.1:0")
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
    """Run the demo, look at it."""
    demo = await asyncio.create_subprocess_exec(*DEMO, stdout=PIPE)
    url = ""
    while demo.stdout and not url:  # in the line of its introduction that begins so
        line = (await demo.stdout.readline()).decode()
        url = line.split()[1] if line.startswith("  page ") else ""
    try:
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=OPTIONS
            )
            await draw_page(browser, url, folders)
    finally:
        demo.terminate()
        await demo.wait()
    print(f"{DOCS}/page-dark.png, page-light.png, page-phone.png")


async def draw_page(browser: Browser, url: str, folders: list[Path]) -> None:
    """The pictures of the docs after a while, and those in folders."""
    dark = await _opened(browser, url, WINDOW, "dark")
    light = await _opened(browser, url, WINDOW, "light")
    phone = await _opened(browser, url, PHONE, "dark")
    await light.click("#truth")
    await light.get_by_role("button", name="gate").click()
    await asyncio.sleep(SECONDS)
    await dark.screenshot(path=DOCS / "page-dark.png")
    await phone.screenshot(path=DOCS / "page-phone.png")
    await _select(light)
    await light.screenshot(path=DOCS / "page-light.png")
    for folder in folders:
        await _draw_sizes(browser, url, folder)


async def _opened(browser: Browser, url: str, window: ViewportSize, theme: Theme) -> Page:
    """A page that has its first plots, without the tour."""
    page = await browser.new_page(viewport=window, color_scheme=theme)
    await page.goto(url)
    while not await page.evaluate("globalThis.plotfeed?.picture.plots.end > 0"):
        await page.wait_for_timeout(100)  # its policy lets nothing be evaluated from within
    await page.click("#tour-skip")
    return page


async def _draw_sizes(browser: Browser, url: str, folder: Path) -> None:
    for window, theme in product(SIZES, THEMES):
        for kind, path in (("", ""), ("-audience", f"{AUDIENCE_PATH.strip('/')}/")):
            page = await _opened(browser, url + path, window, theme)
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
