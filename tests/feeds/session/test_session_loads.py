"""What a session loads: what its scene names, and nothing that reads, shows or judges sessions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.scene_files import scene_file, scene_text

MOST = 135  # Modules of ours that a session of one radar and one drone loads
# Rooms of `feeds` that a session which nobody follows does without.
OTHERS = frozenset({"cli", "fleet", "lab", "page", "recording", "replaying", "schema"})
LIBRARIES = frozenset(
    {"scipy", "starlette", "uvicorn", "httpx", "mcap", "ray", "matplotlib", "pyproj"}
)


def loaded(scene: Path) -> set[str]:
    """What is loaded at the end of a session that reaches nobody, in a process of its own."""
    code = (
        "import asyncio, sys; from plotfeed import load, run; "
        f"asyncio.run(run(load({str(scene)!r}), broker='none', duration_s=0.05)); "
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return set(done.stdout.split())


def test_a_session_of_one_radar_loads_what_it_needs(tmp_path: Path) -> None:
    found = loaded(scene_file(tmp_path, scene_text()))
    ours = {name for name in found if name.partition(".")[0] == "plotfeed"}
    rooms = {name.split(".")[2] for name in ours if name.startswith("plotfeed.feeds.")}
    assert rooms & OTHERS == set()
    assert {name.partition(".")[0] for name in found} & LIBRARIES == set()
    assert len(ours) <= MOST
