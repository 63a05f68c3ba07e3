"""What each shipped scene needs, and the choices of section-4: tables and pictures of the docs.

python docs/commands/write_needs.py [SCENE ...]

Some minutes a scene; docs/needs.md and docs/speed-accuracy.md have what came of it.
"""

from __future__ import annotations

import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from pages import between, table

from plotfeed.feeds.console.process import keep_freed
from plotfeed.feeds.lab.lab_settings import ChartSettings, NeedsSettings
from plotfeed.feeds.lab.needs import (
    START_UTC_NS,
    Finding,
    Needs,
    change_text,
    choices_of,
    cost_text,
    draw,
    processor,
    variants_of,
)
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import example

DOCS = Path(__file__).parents[1]
USUAL = NeedsSettings(runs=6, duration=20.0)
CHARTED = "section-4"


def machine() -> str:
    return f"{processor()}, {datetime.now(UTC):%Y-%m-%d}, load average {os.getloadavg()[0]:.1f}"


def found_of(name: str, settings: ChartSettings, *, choices: bool = False) -> Needs:
    """As the commands find it."""
    scene = example(name)
    variants = variants_of(scene)
    if choices:
        variants = [*choices_of(scene), *(each for each in variants if not each.adds)]
    return Needs(
        scene,
        variants,
        matters=0.02,
        runs=settings.runs,
        duration_s=settings.duration,
        seed=1,
        start_utc_ns=scene.scene.start_utc_ns or START_UTC_NS,
    )


def named(found: Needs, verdict: str) -> str:
    """The effects of a verdict, in the order of what they change."""
    some = [f for f in found.findings if f.verdict == verdict and len(f.variant.effects) == 1]
    some.sort(key=lambda f: -abs(f.largest.share) if f.largest else 0.0)
    return ", ".join(f"`{f.variant.effects[0]}`" for f in some)


def rows_of(findings: list[Finding]) -> list[tuple[str, str, str]]:
    return [(f.variant.name, change_text(f.largest), cost_text(f)) for f in findings]


def main() -> None:
    """Measure, and write both pages."""
    keep_freed()
    names = sys.argv[1:] or list(summaries())
    rows = []
    for name in names:
        found = found_of(name, USUAL)
        verdicts = ("needed", "can go", "missing", "undecided")
        rows.append((name, found.runs, *(named(found, verdict) or "–" for verdict in verdicts)))
        print(name, flush=True)
    heads = ("scene", ">runs", "needed", "can go", "would be noticed if modelled", "undecided")
    text = f"{USUAL.duration:g} s a run. {machine()}.\n\n" + "\n".join(table(heads, rows))
    between(DOCS / "needs.md", "needs", text)
    chart = found_of(CHARTED, ChartSettings(), choices=True)
    draw(chart, DOCS / "speed-accuracy.png")
    cheapest = sorted(chart.findings, key=lambda f: f.cost[0])
    lines = table(("the scene", "what changes most", "processor time"), rows_of(cheapest))
    head = f"A second of the scene as it is takes {1e3 * chart.cost_s:.3g} ms of processor"
    between(
        DOCS / "speed-accuracy.md",
        "charted",
        f"{head}; {chart.runs} runs of {chart.duration_s:g} s. {machine()}.\n\n" + "\n".join(lines),
    )


if __name__ == "__main__":
    main()
