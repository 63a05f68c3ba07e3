"""Draws docs/report.png and writes the tables of docs/report.md: five minutes of report.toml.

    python docs/commands/draw_report.py

In simulated time, so that every run draws the same.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import between

DOCS = Path(__file__).parents[1]
PAGE, PICTURE, SCENE = DOCS / "report.md", DOCS / "report.png", DOCS / "report.toml"
SECONDS = 300


def plotfeed(*arguments: object) -> str:
    """What the command prints."""
    command = [sys.executable, "-m", "plotfeed.feeds.cli", *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout  # noqa: S603


def report() -> str:
    """Run, record and draw; the tables."""
    with TemporaryDirectory() as folder:
        record = Path(folder) / "there.mcap"
        how = ("--broker", "none", "--speed", "max", "--duration", SECONDS, "--json")
        plotfeed("run", SCENE, "--record", record, *how)
        text = plotfeed("report", record, "--chart", PICTURE, "--force")
        return text.replace(str(record), record.name)


def main() -> None:
    """Draw the picture, write the tables."""
    text = report()
    between(PAGE, "report", f"```text\n{text}```")
    print(text)


if __name__ == "__main__":
    main()
