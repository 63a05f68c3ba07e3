"""What a session loads: what its scene names, and nothing that reads, shows or judges sessions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.scene_files import scene_file, scene_text

MOST = 135  # Modules of ours that a session of one radar and one drone loads
# Rooms of `feeds` that a session which nobody follows does without.
OTHERS = frozenset({"cli", "fleet", "lab", "page", "recording", "replaying", "schema"})
LIBRARIES = frozenset(
    {"scipy", "starlette", "uvicorn", "httpx", "mcap", "ray", "matplotlib", "pyproj"}
)
# What few scenes need.
FEW = {"scipy.stats", "scipy.optimize", "scipy.sparse", "scipy.spatial", "ray", "sapient_msg"}


def loaded(code: str) -> set[str]:
    """Modules that a process of its own has at the end of that."""
    words = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    return set(subprocess.run(words, check=True, capture_output=True, text=True).stdout.split())


def test_a_session_of_one_radar_loads_what_it_needs(tmp_path: Path) -> None:
    running = (
        f"run(load({str(scene_file(tmp_path, scene_text()))!r}), broker='none', duration_s=0.05)"
    )
    found = loaded(f"import asyncio; from plotfeed import load, run; asyncio.run({running})")
    ours = {name for name in found if name.partition(".")[0] == "plotfeed"}
    rooms = {name.split(".")[2] for name in ours if name.startswith("plotfeed.feeds.")}
    assert rooms & OTHERS == set()
    assert {name.partition(".")[0] for name in found} & LIBRARIES == set()
    assert len(ours) <= MOST


@pytest.mark.parametrize(
    ("begins", "besides"),
    [
        ("cli.run", {"plotfeed.feeds.lab", "plotfeed.models.effects.merging"}),
        ("page.run_with_page", {"plotfeed.feeds.lab.evidence", "plotfeed.feeds.lab.oracle"}),
    ],
)
def test_a_session_begins_without_what_few_scenes_need(begins: str, besides: set[str]) -> None:
    example = "from plotfeed.feeds.scene.scene import example; example('section-4')"
    assert loaded(f"import plotfeed.feeds.{begins}; {example}") & (FEW | besides) == set()
