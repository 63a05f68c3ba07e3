"""The active radar of section-4, staring at many drones, and what a sector of a sensor costs."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed import Engine
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.proto.utc import NS

START_NS = 1_767_268_800 * NS
SECTION_4 = files("plotfeed.feeds.scene.examples") / "section-4.toml"


def scene_of(
    n: int, folder: Path = Path(), tables: Mapping[str, Any] | None = None, /, **more: Any
) -> Scene:
    """Drones of 0.01 m2 between 2 and 7 km that move slowly; `more` are keys of the radar.

    `tables` are others of the scene, whose files are in the folder.
    """
    tree = tomllib.loads(SECTION_4.read_text())
    (radar,) = (s for s in tree["sensor"] if s["id"] == "active")
    radar["scan"] = {"kind": "staring", "period_s": 1.0}
    rng = np.random.default_rng(1)
    ranges, azimuths = rng.uniform(2000, 7000, n), rng.uniform(0, 2 * np.pi, n)
    tree["sensor"] = [radar | more]
    tree["drone"] = [
        {"id": f"d{i}", "rcs_m2": 0.01, "speed_m_s": 0.01, "path": _path(r, a)}
        for i, (r, a) in enumerate(zip(ranges, azimuths, strict=True))
    ]
    return from_tree(tree | dict(tables or {}), folder / "bench.toml")


def at_work(scene: Scene, after_s: int = 2) -> Engine:
    """The scene's one sensor, which has been at work for so many seconds."""
    engine = Engine(scene, START_NS)
    for _ in range(after_s):
        next_sectors(engine)
    return engine


def next_sectors(engine: Engine) -> None:
    """Whatever ends next, with its messages."""
    assert engine.next_end_ns is not None
    for _ in engine.until(engine.next_end_ns):
        pass


def ns_per_drone(engine: Engine, n: int, seconds: float) -> float:
    """Nanoseconds of n drones and a sector each: mean of as many sectors as go into the time."""
    sectors, start_s = 0, time.perf_counter()
    while (spent_s := time.perf_counter() - start_s) < seconds:
        next_sectors(engine)
        sectors += 1
    return spent_s / sectors / n * 1e9


def _path(range_m: float, azimuth: float) -> list[dict[str, float]]:
    east_m, north_m = float(range_m * np.sin(azimuth)), float(range_m * np.cos(azimuth))
    return [place(east_m, north_m, 100.0), place(east_m + 10.0, north_m, 100.0)]


def place(east_m: float, north_m: float, above_site_m: float = 5.0) -> dict[str, float]:
    """Keys of a place, from the site."""
    return {"east_m": east_m, "north_m": north_m, "above_site_m": above_site_m}
