"""What each shipped scene needs, and the choices of section-4: tables and pictures of the docs.

python docs/commands/write_needs.py [SCENE ...]

Some minutes a scene; docs/needs.md and docs/speed-accuracy.md have what came of it.
"""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import between, table

from plotfeed.feeds.console.process import keep_freed, processor
from plotfeed.feeds.engine.ordinary_world import START_UTC_NS
from plotfeed.feeds.lab.lab_settings import ChartSettings, NeedsSettings
from plotfeed.feeds.lab.needs import (
    Finding,
    Needs,
    change_text,
    choices_of,
    draw,
    more_text,
    variants_of,
)
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import example

DOCS = Path(__file__).parents[1]
USUAL = NeedsSettings(runs=8, duration=20.0)
CHARTED = "section-4"


def machine() -> str:
    return f"{processor()}, {datetime.now(UTC):%Y-%m-%d}"


def found_of(name: str, settings: ChartSettings, folder: Path, *, choices: bool = False) -> Needs:
    """As the commands find it."""
    scene = example(name)
    variants = variants_of(scene, folder)
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
    some.sort(key=lambda f: -f.size)
    return ", ".join(f"`{f.variant.effects[0]}`" for f in some)


def spared(found: Needs) -> str:
    """Sensors without which hardly less is plotted and followed."""
    names = []
    for name, losses in found.losses.items():
        if all(loss.before - loss.after < found.matters for loss in losses):
            names.append(f"`{name}`")
    return ", ".join(names)


def rows_of(findings: list[Finding]) -> list[tuple[str, ...]]:
    return [
        (f.variant.name, change_text(f.largest), more_text(f.cost), more_text(f.octets))
        for f in findings
    ]


def main() -> None:
    """Measure, and write both pages; of scenes that are named, their rows alone."""
    keep_freed()
    with TemporaryDirectory() as folder:
        write_scenes(sys.argv[1:] or list(summaries()), Path(folder))
        if not sys.argv[1:]:
            write_chart(Path(folder))


def write_chart(folder: Path) -> None:
    """Measure the choices of a scene; draw them, and write their rows."""
    chart = found_of(CHARTED, ChartSettings(runs=8), folder, choices=True)
    draw(chart, DOCS / "speed-accuracy.png", on_tracks=False)
    heads = ("the scene", "what changes most", "processor time", "octets")
    head = (
        f"A second of the scene as it is takes {1e3 * chart.cost_s:.3g} ms of processor; "
        f"{chart.runs} runs of {chart.duration_s:g} s. Pd by counting plots has a standard error "
        f"of {chart.counted_error:.1%} after one run. {machine()}."
    )
    lines = table(heads, rows_of(sorted(chart.findings, key=lambda f: f.cost[0])))
    between(DOCS / "speed-accuracy.md", "charted", f"{head}\n\n" + "\n".join(lines))


def rows_on_page(columns: int) -> dict[str, list[str]]:
    """The rows of scenes that the page has, by their names."""
    lines = (DOCS / "needs.md").read_text().splitlines()
    cells = ([cell.strip() for cell in line.strip("|").split(" | ")] for line in lines)
    return {row[0]: row for row in cells if len(row) == columns and row[0] in summaries()}


def write_scenes(names: list[str], folder: Path) -> None:
    """Measure those shipped scenes, and write their rows; those of others stay."""
    heads = ("scene", "needed", "can go", "would be noticed if modelled", "would not", "undecided")
    heads = (*heads, "sensors that are spared", ">processor, s")
    for name in names:
        began_s = time.process_time()
        found = found_of(name, USUAL, folder)
        spent_s = time.process_time() - began_s
        verdicts = ("needed", "can go", "missing", "no need", "undecided")
        told = (named(found, verdict) or "–" for verdict in verdicts)
        rows = rows_on_page(len(heads))
        rows[name] = [name, *told, spared(found) or "–", f"{spent_s:.0f}"]
        print(*rows[name], sep="; ", flush=True)
        head = f"At most {USUAL.runs} runs of {USUAL.duration:g} s, where 2 % matter. {machine()}."
        told_of = [rows[each] for each in summaries() if each in rows]
        between(DOCS / "needs.md", "needs", f"{head}\n\n" + "\n".join(table(heads, told_of)))


if __name__ == "__main__":
    main()
