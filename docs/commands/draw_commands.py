"""Runs what commands print and draw for docs/report.md, docs/sweep.md and docs/trackers.md.

    python docs/commands/draw_commands.py [report] [sweep] [trackers]

Report and sweep are in simulated time, and the same each time; without a name, both. Trackers run
in real time: ten minutes. They need .venv-stonesoup, as examples/stonesoup_tracker.py says.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import between

DOCS = Path(__file__).parents[1]
PROJECT = DOCS.parent
SECTION_4 = "feeds/scene/examples/section-4.toml"
LEFT_OUT = ("0.003 ", "0.01 ", "0.03 ")  # Of the table of the sweep, whose picture has them
PLACES = "{host} {port} {prefix} {topic}"
TRACKERS = {
    "plain": f"{sys.executable} examples/plain_tracker.py {PLACES}",
    "stone-soup": f".venv-stonesoup/bin/python examples/stonesoup_tracker.py {PLACES}",
}


def printed(*arguments: object) -> str:
    """What the command prints, without lines of files that it has written."""
    command = [sys.executable, "-m", "plotfeed.feeds.cli", *map(str, arguments)]
    done = subprocess.run(  # noqa: S603 - our own command
        command, cwd=PROJECT, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout


def report(folder: Path) -> str:
    """Five minutes of docs/report.toml, recorded and judged."""
    record = folder / "there.mcap"
    how = ("--broker", "none", "--speed", "max", "--duration", 300, "--json")
    printed("run", "docs/report.toml", "--record", record, *how)
    text = printed("report", record, "--chart", "docs/report.png", "--force")
    return text.replace(str(record), record.name)


def sweep(folder: Path) -> str:
    """Other drones before the sensors of section 4."""
    vary = ("--vary", "drone.phantom-4.rcs_m2=0.003,0.01,0.03,0.1", "--runs", 5, "--duration", 340)
    where = ("--out", folder / "sweep", "--chart", "docs/sweep.png", "--force")
    lines = printed("sweep", SECTION_4, *vary, "--processes", os.cpu_count(), *where).splitlines()
    return "".join(f"{line}\n" for line in lines if not line.startswith(("written", *LEFT_OUT)))


def trackers(folder: Path) -> str:
    """Both trackers of examples/ with fewer and fewer detections."""
    named = [f"--tracker={name}={command}" for name, command in TRACKERS.items()]
    varied = ("--vary", "sensor.*.degradation.pd_factor=1.0,0.7,0.4", "--runs", 3)
    how = ("--duration", 30, "--speed", 2, "--patience", 60, "--folder", folder)
    text = printed("score", "examples/scenes/radar-udp.toml", *named, *varied, *how)
    shutil.copyfile(folder / "curve.png", DOCS / "trackers.png")
    return "".join(f"{line}\n" for line in text.splitlines() if str(folder) not in line)


# By the page, its mark and the language of the block.
RUNS = {"report": (report, "report", "text"), "sweep": (sweep, "sweep", "text"),
        "trackers": (trackers, "curve", "")}  # fmt: skip


def main() -> None:
    """Run, and put tables and pictures where they belong."""
    for name in sys.argv[1:] or ("report", "sweep"):
        made, mark, language = RUNS[name]
        with TemporaryDirectory() as folder:
            text = made(Path(folder))
        between(DOCS / f"{name}.md", mark, f"```{language}\n{text}```")
        print(text)


if __name__ == "__main__":
    main()
