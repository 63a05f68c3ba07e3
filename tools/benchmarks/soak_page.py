"""Half an hour of the page with two viewers: memory of server and browser, minute by minute.

python tools/benchmarks/soak_page.py [MINUTES]; nothing is asserted. It prints as it goes, and
writes every fifth minute into docs/page.md, between its marks.
"""

from __future__ import annotations

import os
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "commands"))

from bench_page import WINDOW, child
from pages import between
from playwright.sync_api import CDPSession, Page, sync_playwright
from support.chromium import OPTIONS
from support.tools import place_of

from plotfeed.feeds.console.process import processor

PAGE = Path(__file__).parents[2] / "docs" / "page.md"
MINUTES = 30
DRONES = 200
EVERY = 5
HEAD = (
    "| minute | server, MiB | browser's heap, MiB | plots | drones | seconds |\n"
    "|--:|--:|--:|--:|--:|--:|"
)


def rss_mib(pid: int) -> float:
    """Resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (kib,) = (line.split()[1] for line in lines if line.startswith("VmRSS"))
    return int(kib) / 1024


def heap_mib(session: CDPSession) -> float:
    """What JavaScript holds after it has collected its garbage."""
    session.send("HeapProfiler.collectGarbage")
    used: float = session.send("Runtime.getHeapUsage")["usedSize"]
    return used / 2**20


def rows(page: Page) -> str:
    """How many plots, drones and seconds the page keeps."""
    found: list[int] = page.evaluate(
        "(({ plots, drones, seconds }) => [plots.end - plots.begin, drones.rows, seconds.length])"
        "(plotfeed.picture)"
    )
    return " | ".join(f"{n:,}" for n in found)


def main() -> None:
    """Measure, print and write."""
    minutes = int(sys.argv[1]) if sys.argv[1:] else MINUTES
    with child(DRONES, with_page=True) as (served, url), sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=place_of("chromium"), args=list(OPTIONS)
        )
        pages = [browser.new_page(viewport=WINDOW, reduced_motion="reduce") for _ in range(2)]
        for page in pages:
            page.goto(url)
            page.get_by_role("button", name="Truth").dispatch_event("click")
        session = pages[0].context.new_cdp_session(pages[0])
        print(HEAD)
        lines: list[str] = []
        began_s = time.monotonic()
        for minute in range(minutes + 1):
            pages[0].wait_for_timeout(max(0.0, began_s + 60 * minute + 10 - time.monotonic()) * 1e3)
            lines.append(
                f"| {minute} | {rss_mib(served):.1f} | {heap_mib(session):.2f} | {rows(pages[0])} |"
            )
            print(lines[-1], flush=True)
        browser.close()
    write(lines)


def write(lines: list[str]) -> None:
    """Into the documentation, with the machine."""
    words = (
        f"{DRONES} drones, two browsers that see the truth, {len(lines) - 1} minutes, on "
        f"{os.cpu_count()} cores ({processor()}), {datetime.now(UTC):%Y-%m-%d}. The server is the "
        "whole process, session included; the heap is what the page's script holds after a "
        "collection; plots, drones and seconds of the strips are those that it keeps."
    )
    between(PAGE, "soak", "\n".join([words, "", HEAD, *lines[::EVERY]]))


if __name__ == "__main__":
    main()
