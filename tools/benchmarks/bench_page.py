"""The live page in a headless browser: frames a second, processor time of server and browser."""

from __future__ import annotations

import asyncio
import contextlib
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aims import aim, cpu_s, spread
from support import made_up_session
from support.chromium import OPTIONS
from support.tools import place_of

from plotfeed import testing
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.server import serving
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.scene import Scene

SIZES = ((500, 5_000), (2_000, 20_000))
WINDOW = {"width": 1920, "height": 1080}
WARM_UP_S, MEASURED_S, EMPTY_S = 12.0, 15.0, 3.0
RUNS = 3
VIEWERS = 50
AIMS_FPS, AIM_UPDATES, AIM_PAINT_MS = {500: 55.0, 2_000: 50.0}, 9.5, 500.0
AIM_SERVER_PERCENT, AIM_CROWD_PERCENT = 5.0, 15.0


def crowded(drones: int) -> Scene:
    """One radar that finds every drone once a second, so that ten seconds of plots are on show."""
    radar = made_up_session.sensors(9000.0)[0] | {
        "power_w": 5e6,
        "scan": testing.rotating(period_s=1.0, sectors=32),
        "range_min_m": 0.0,
        "elevation_min_deg": -10.0,
        "elevation_max_deg": 90.0,
        "pfa": 1e-8,
    }
    return testing.scene([radar], made_up_session.drones(drones, 8000.0), seed=8)


async def serve(drones: int, *, with_page: bool) -> None:
    """A child: the stage, with the page or without, until somebody ends it."""
    view = View() if with_page else None
    stage = made_up_session.MadeUpSession(view, crowded(drones))
    async with contextlib.AsyncExitStack() as stack:
        if view is not None:
            page = serving(PageAddress("127.0.0.1", 0), view, stage, lambda: stage.now_ns)
            print((await stack.enter_async_context(page)).url, flush=True)
        await stage.run()


@contextlib.contextmanager
def child(drones: int, *, with_page: bool) -> Iterator[tuple[int, str]]:
    """The number of that child's process, and the address of its page, if it has one."""
    mode = "page" if with_page else "bare"
    words = [sys.executable, __file__, "--serve", mode, str(drones)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout
            yield process.pid, process.stdout.readline().strip() if with_page else ""
        finally:
            process.terminate()


def browser_cpu_s() -> float:
    """What all processes of the browser have used so far."""
    total_s = 0.0
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if "chrom" in (process / "comm").read_text():
                total_s += cpu_s(int(process.name))
    return total_s


def measured(drones: int) -> dict[str, float]:
    """One run in the browser, and beside it one without a page for comparison.

    Both at once: what else the machine does makes each of them dearer by the same.
    """
    from playwright.sync_api import sync_playwright

    found: dict[str, float] = {}
    with (
        child(drones, with_page=False) as (bare, _),
        child(drones, with_page=True) as (served, url),
        sync_playwright() as playwright,
    ):
        path = place_of("chromium")
        assert path, "no Chromium is installed"
        browser = playwright.chromium.launch(executable_path=path, args=list(OPTIONS))
        page = browser.new_page(viewport=WINDOW)
        empty = page.evaluate(EMPTY, EMPTY_S * 1000) / EMPTY_S
        page.goto(url)
        page.get_by_role("button", name="Truth").click()
        page.wait_for_timeout(WARM_UP_S * 1000)
        before = counts(page), cpu_s(served), cpu_s(bare), browser_cpu_s(), time.monotonic()
        page.wait_for_timeout(MEASURED_S * 1000)
        after = counts(page), cpu_s(served), cpu_s(bare), browser_cpu_s(), time.monotonic()
        served_s, bare_s, browser_s, passed_s = (
            b - a for a, b in zip(before[1:], after[1:], strict=True)
        )
        found["frames"] = (after[0]["frames"] - before[0]["frames"]) / passed_s
        found["of empty"] = found["frames"] / empty
        found["updates"] = (after[0]["updates"] - before[0]["updates"]) / passed_s
        found["plots"] = after[0]["plots"]
        found["kB"] = (after[0]["octets"] - before[0]["octets"]) / passed_s / 1000
        found["browser"] = 100 * browser_s / passed_s
        found["server"] = 100 * (served_s - bare_s) / passed_s
        found["of session"] = served_s / bare_s
        found["paint"] = statistics.median(first_paint_ms(browser, url) for _ in range(5))
        browser.close()
    return found


async def watch(url: str) -> None:
    """Take what the page sends to so many viewers, until cancelled."""
    from support.page_replays import feed_of

    async def follow() -> None:
        async with feed_of(url) as feed:
            while True:
                await feed.recv()

    await asyncio.gather(*(follow() for _ in range(VIEWERS)))


def crowd_percent() -> float:
    """What so many viewers cost the server of the smaller scene, percent of a core."""
    drones = SIZES[0][0]
    with (
        child(drones, with_page=False) as (bare, _),
        child(drones, with_page=True) as (served, url),
    ):
        viewers = subprocess.Popen([sys.executable, __file__, "--watch", url])
        time.sleep(WARM_UP_S)
        before = cpu_s(served), cpu_s(bare), time.monotonic()
        time.sleep(MEASURED_S)
        after = cpu_s(served), cpu_s(bare), time.monotonic()
        viewers.kill()
        viewers.wait()
    served_s, bare_s, passed_s = (b - a for a, b in zip(before, after, strict=True))
    return 100 * (served_s - bare_s) / passed_s


# How many frames a page gets that draws nothing.
EMPTY = """ms => new Promise(done => {
  let frames = 0;
  const began = performance.now();
  const next = now => { frames++; now - began < ms ? requestAnimationFrame(next) : done(frames); };
  requestAnimationFrame(next);
})"""
COUNTS = """() => {
  const { picture, display } = plotfeed, { plots, framesTaken, octetsTaken } = picture;
  const now = picture.nowMs(performance.now());
  let shown = 0;
  for (let row = plots.begin; row < plots.end; row++)
    shown += now - plots.shown_ms[plots.at(row)] < display.glowMs;
  return { frames: display.framesDrawn, updates: framesTaken, octets: octetsTaken, plots: shown };
}"""


def counts(page: Any) -> dict[str, float]:
    """What the page has drawn and taken so far, and how many plots are visible."""
    found: dict[str, float] = page.evaluate(COUNTS)
    return found


def first_paint_ms(browser: Any, url: str) -> float:
    """From the request to the first contentful paint, with an empty cache."""
    page = browser.new_context(viewport=WINDOW).new_page()
    page.goto(url)
    while not page.evaluate("performance.getEntriesByName('first-contentful-paint').length"):
        page.wait_for_timeout(20)
    script = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
    paint_ms = float(page.evaluate(script))
    page.context.close()
    return paint_ms


# What a run measures: its form, and its title.
COLUMNS = {
    "plots": (",.0f", "plots on show"),
    "frames": (".0f", "frames/s"),
    "of empty": (".2f", "× an empty page's"),
    "updates": (".1f", "updates/s"),
    "kB": (".0f", "kB/s"),
    "server": (".1f", "server, %"),
    "of session": (".2f", "processor with the page × without"),
    "browser": (".0f", "browser, %"),
    "paint": (".0f", "paint, ms"),
}
TITLES = [title for _, title in COLUMNS.values()]
HEAD = f"""{WINDOW["width"]} by {WINDOW["height"]} pixels, rendered in software, truth shown,
{RUNS} runs of {MEASURED_S:g} s in turns: median (least to most). The server's share of a core is
that of a session with the page less that of the same session without one, run beside it; the
browser's is of all its processes together. An empty page draws nothing, in the same browser.

| drones | {" | ".join(TITLES)} |
|--:|{"--:|" * len(TITLES)}"""


def main() -> None:
    """Print the table."""
    print(HEAD)
    runs: dict[int, list[dict[str, float]]] = {drones: [] for drones, _ in SIZES}
    for _ in range(RUNS):
        for drones, found in runs.items():
            found.append(measured(drones))
    for drones, found in runs.items():
        cells = (spread((run[name] for run in found), form) for name, (form, _) in COLUMNS.items())
        print(f"| {drones:,} | {' | '.join(cells)} |")
    crowd = crowd_percent()
    print(f"\n{VIEWERS} viewers of {SIZES[0][0]} drones cost the server {crowd:.1f} % of a core.\n")
    medians = {
        drones: {name: statistics.median(run[name] for run in found) for name in COLUMNS}
        for drones, found in runs.items()
    }
    for drones, found in medians.items():
        what, frames, updates = f"{drones} drones", found["frames"], found["updates"]
        least = AIMS_FPS[drones]
        print(aim(what, f"{least:g} frames/s", f"{frames:.0f}", is_met=frames >= least))
        met = updates >= AIM_UPDATES
        print(aim(what, f"{AIM_UPDATES:g} updates/s", f"{updates:.1f}", is_met=met))
    what, found = f"{SIZES[0][0]} drones", medians[SIZES[0][0]]
    server, paint_ms = found["server"], found["paint"]
    limit = f"server under {AIM_SERVER_PERCENT:g} %"
    print(aim(what, limit, f"{server:.1f} %", is_met=server < AIM_SERVER_PERCENT))
    limit = f"first paint under {AIM_PAINT_MS / 1000:g} s"
    print(aim(what, limit, f"{paint_ms / 1000:.2f} s", is_met=paint_ms < AIM_PAINT_MS))
    limit = f"server under {AIM_CROWD_PERCENT:g} %"
    print(aim(f"{VIEWERS} viewers", limit, f"{crowd:.1f} %", is_met=crowd < AIM_CROWD_PERCENT))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        asyncio.run(serve(int(sys.argv[3]), with_page=sys.argv[2] == "page"))
    elif sys.argv[1:2] == ["--watch"]:
        asyncio.run(watch(sys.argv[2]))
    elif place_of("chromium") is None:
        print("Not measured: no Chromium is installed.")
    else:
        main()
