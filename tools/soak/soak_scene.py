"""What a soak runs: its scene, what comes in, and the commands that change it."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench_engine import radars
from bench_engine import scene_text as scene_of

from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.proto.utc import iso_utc
from plotfeed.testing import radar, rotating

SECTION_4 = Path(__file__).parents[2] / "feeds" / "scene" / "examples" / "section-4.toml"
KEPT_MESSAGES = 200  # Of each sensor, while the broker is away; the oldest give way
LINKS: dict[str, dict[str, Any]] = {
    "active": {
        "latency_ms": 50.0,
        "jitter_ms": 10.0,
        "delay_correlation": 0.3,
        "loss": {"kind": "gilbert-elliott", "mean_loss": 0.03, "mean_burst": 3.3},
        "duplicate": 0.01,
        "corrupt": 0.001,
    },
    "mimo": {
        "distribution": "table",
        "delays_ms": [21.0, 22.5, 24.0, 31.0, 120.0],
        "loss": {"kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5},
    },
    "passive": {
        "latency_ms": 80.0,
        "jitter_ms": 20.0,
        "distribution": "pareto",
        "loss": {"kind": "random", "probability": 0.02, "correlation": 0.2},
    },
    "microphone": {"rate_kbit_s": 8.0, "overhead_octets": 40, "queue_messages": 5},
    "north": {"latency_ms": 30.0, "jitter_ms": 30.0, "distribution": "uniform", "in_order": True},
    "east": {
        "latency_ms": 20.0,
        "on_loss": "stall",
        "loss": {"kind": "random", "probability": 0.005},
    },
    "west": {
        "latency_ms": 25.0,
        "jitter_ms": 10.0,
        "distribution": "paretonormal",
        "reorder": {"probability": 0.25, "gap": 5},
        "duplicate": 0.02,
    },
}
# In turn; the last four are refused.
COMMANDS: tuple[bytes, ...] = tuple(
    json.dumps(command).encode()
    for command in (
        {"sensor": "active", "set": {"link": {"latency_ms": 250.0}}},
        {"sensor": "active", "reset": True},
        {"sensor": "north", "set": {"link": {"down": True}}},
        {"sensor": "north", "reset": True},
        {"sensor": "west", "set": {"pfa": 1e-6}},
        {"sensor": "west", "set": {"enabled": False}},
        {"sensor": "west", "reset": True},
        {"sensor": "mimo", "set": {"link": None}},
        {"sensor": "mimo", "reset": True},
        {"sensor": "nobody", "reset": True},
        {"sensor": "east", "set": {"pfa": 2.0}},
        {"clock": {"speed": 10}},
        "reset",
    )
)


def scene_text() -> str:
    """Section 4 and three radars of 16 sectors, each sensor with its link."""
    tree = tomllib.loads(SECTION_4.read_text())
    tree["drone"][0]["repeat"] = True
    tree["sensor"] += [
        radar(id=name, scan=rotating(1.0, 16), report=["asterix-048"], pfa=1e-8, sic=10 + i)
        for i, name in enumerate(("north", "east", "west"))
    ]
    for sensor in tree["sensor"]:
        sensor["link"] = LINKS[sensor["id"]]
    tree["mqtt"] = {"qos": 1, "queue": {"policy": "drop-oldest", "messages": KEPT_MESSAGES}}
    return toml_of(tree)


def reported(drone: int, t_utc_ns: int) -> bytes:
    """A report of a drone that flies in a circle, 1 to 9 km wide."""
    radius_deg = 0.01 + 0.004 * (drone % 18)
    angle = t_utc_ns / 1e9 * 20.0 / (radius_deg * 111_000) + drone
    return json.dumps(
        {
            "time_utc": iso_utc(t_utc_ns),
            "latitude_deg": 40.45 + radius_deg * math.cos(angle),
            "longitude_deg": -3.73 + radius_deg * math.sin(angle) / 0.76,
            "altitude_m": 900.0,
            "altitude_reference": "ELLIPSOID",
        }
    ).encode()


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What a session has to do."""

    scene: str
    drones: int
    telemetry_hz: float
    garbage_every: int  # One in so many telemetry messages; 0 for none
    commands: tuple[bytes, ...]
    is_recorded: bool  # If not, a subscriber counts what arrives, and C sleeps beside it
    fault_every_s: float


def everything() -> Load:
    """Much of each kind goes wrong."""
    return Load(
        scene=scene_text(),
        drones=10,
        telemetry_hz=5.0,
        garbage_every=100,
        commands=COMMANDS,
        is_recorded=True,
        fault_every_s=180.0,
    )


def many_radars(number: int) -> Load:
    """There is much of it, and all goes well."""
    return Load(
        scene=scene_of(radars(number), 0),
        drones=50,
        telemetry_hz=10.0,
        garbage_every=0,
        commands=(),
        is_recorded=False,
        fault_every_s=math.inf,
    )
