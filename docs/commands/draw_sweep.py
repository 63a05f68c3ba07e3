"""Draws docs/sweep.png and writes the table of docs/sweep.md: other drones and links.

    python docs/commands/draw_sweep.py

Every run of it draws the same, by however many processes.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import between

DOCS = Path(__file__).parents[1]
PAGE, PICTURE = DOCS / "sweep.md", DOCS / "sweep.png"
SCENE = DOCS.parent / "feeds" / "scene" / "examples" / "section-4.toml"
VARY = ("drone.phantom-4.rcs_m2=0.003,0.01,0.03,0.1",)
RUNS, SECONDS = 5, 340
LEFT_OUT = ("0.003 ", "0.01 ", "0.03 ")  # of the page, which the picture has


def swept(processes: str) -> str:
    """The table that the command prints, without the names of files."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "plotfeed.feeds.cli", "sweep", str(SCENE)]
        for vary in VARY:
            command += ["--vary", vary]
        command += ["--runs", str(RUNS), "--duration", str(SECONDS), "--processes", processes]
        command += ["--out", f"{folder}/sweep", "--chart", str(PICTURE), "--force"]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603
    return "\n".join(
        line for line in done.stdout.splitlines() if not line.startswith(("written", *LEFT_OUT))
    )


def main() -> None:
    """Draw the picture, write the table."""
    text = swept(sys.argv[1] if sys.argv[1:] else "1")
    between(PAGE, "sweep", f"```text\n{text}\n```")
    print(text)


if __name__ == "__main__":
    main()
