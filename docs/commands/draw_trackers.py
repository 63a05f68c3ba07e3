"""Runs both trackers of examples/ with fewer and fewer detections, for docs/trackers.md.

python docs/commands/draw_trackers.py

In real time: ten minutes. Needs .venv-stonesoup, as examples/stonesoup_tracker.py says.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import between

DOCS = Path(__file__).parents[1]
PROJECT = DOCS.parent
SCENE = "examples/scenes/radar-udp.toml"
PLACES = "{host} {port} {prefix} {topic}"
TRACKERS = {
    "plain": f"{sys.executable} examples/plain_tracker.py {PLACES}",
    "stone-soup": f".venv-stonesoup/bin/python examples/stonesoup_tracker.py {PLACES}",
}
VARIED = "sensor.*.degradation.pd_factor=1.0,0.7,0.4"
HOW = ("--runs", "3", "--duration", "30", "--speed", "2", "--patience", "60")


def main() -> None:
    """Run, and put table and picture where they belong."""
    named = [f"--tracker={name}={command}" for name, command in TRACKERS.items()]
    command = [sys.executable, "-m", "plotfeed.feeds.cli", "score", SCENE, *named]
    with TemporaryDirectory() as folder:
        done = subprocess.run(  # noqa: S603 - our own command
            [*command, "--vary", VARIED, *HOW, "--folder", folder],
            cwd=PROJECT,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        shutil.copyfile(Path(folder) / "curve.png", DOCS / "trackers.png")
    lines = [line for line in done.stdout.splitlines() if folder not in line]
    between(DOCS / "trackers.md", "curve", "\n".join(["```", *lines, "```"]))


if __name__ == "__main__":
    main()
