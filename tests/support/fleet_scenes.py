"""Scenes for fleets: sensors of many kinds, some of which need others or keep a state."""

from __future__ import annotations

import random
from collections import defaultdict
from pathlib import Path
from typing import Any

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.testing import START_NS, radar, rotating, scene, staring, waypoint

EVENT = {"from_s": 2.0, "to_s": 3.5, "set": {"pfa": 1e-4}}


def sensors() -> list[dict[str, Any]]:
    """Eight groups: of a tracker, a beam that is steered, a camera that a radar cues."""
    far = radar(pfa=1e-6, scan=rotating(1.0, 16))
    kinds: dict[str, dict[str, Any]] = {
        "turns": far,
        "jitters": far | {"scan": rotating(0.7, 8) | {"jitter_ms": 2.0}},
        "changes": far | {"event": [EVENT]},
        "drifts": far | {"drift": {"sigma_range_m": 3.0, "time_constant_s": 60.0}},
        "tracks": far | {"report": ["asterix-062"], "tracks": {"kind": "plain"}},
        "steers": far
        | {"scan": {"kind": "electronic", "period_s": 0.5, "dwell_s": 0.01}, "integration_s": 0.01},
        "stares": far | {"scan": staring(0.5)},
        "cues": far,
        "camera": {
            "type": "camera", "scan": staring(0.2), "range_max_m": 5000.0,
            "horizontal_fov_deg": 40.0, "pixels_across": 8000, "pixels_down": 6000,
            "false_alarms_per_frame": 0.3, "mount": {"cued_by": "cues"},
        },
    }  # fmt: skip
    return [
        keys | {"id": name, "position_enu_m": [700.0 * i - 2000.0, 300.0 * (i % 3), 0.0]}
        for i, (name, keys) in enumerate(kinds.items())
    ]


def drones(
    n: int = 12, seed: int = 1, elevation_deg: float = 15.0, reach_m: tuple[int, int] = (500, 5000)
) -> list[dict[str, Any]]:
    by_chance = random.Random(seed)  # noqa: S311

    def place() -> dict[str, float]:
        azimuth_deg, up_deg = by_chance.uniform(0, 360), by_chance.uniform(2, elevation_deg)
        return waypoint(azimuth_deg, up_deg, by_chance.uniform(*reach_m))

    return [
        {"id": f"d{seed}-{i}", "speed_m_s": by_chance.uniform(5, 60), "repeat": True, "rcs_m2": 0.5,
         "path": [place() for _ in range(3)]}
        for i in range(n)
    ]  # fmt: skip


def mixed(folder: Path = Path(), **more: Any) -> Scene:
    """A scene of all of them."""
    return scene(sensors(), drones(), seed=11, folder=folder, **more)


def stateless(folder: Path = Path(), **more: Any) -> Scene:
    """Those whose octets are the same where a slow machine has left scans out before."""
    state = {"tracks", "steers", "camera"}
    some = [sensor for sensor in sensors() if sensor["id"] not in state]
    return scene(some, drones(), seed=11, folder=folder, **more)


def by_topic(messages: list[Message], after_ns: int = START_NS) -> dict[str, list[bytes]]:
    """Payloads of plots and tracks by topic, of what was due after a time; in their order."""
    found = defaultdict(list)
    for message in messages:
        if not message.retain and message.due_utc_ns > after_ns:
            found[message.topic].append(message.payload)
    found.pop("plotfeed/truth", None)
    return dict(found)
