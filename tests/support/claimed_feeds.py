"""Feeds of the radars of examples/scenes/feed-faults.toml, many of each, and their verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.lab.judge import FeedTally, Verdicts, simulated_feed
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.models.residuals import Check

SCENE = Path(__file__).parents[2] / "examples" / "scenes" / "feed-faults.toml"
START_NS = 1_767_268_800 * 10**9
SPREADS = {"range spread", "azimuth spread", "elevation spread", "height spread"}
# The checks that must fail, by radar.
NAMED: Mapping[str, set[str]] = {
    "clean": set(),
    "askew": {"azimuth"},
    "late": {"time"},
    "blind": {"Pd"},
    "cluttered": {"false alarms"},
    "lying": SPREADS,
}


def claims_of(scene: Scene, sensor: SimulatedSensor) -> list[Check]:
    """What a simulated sensor claims, checked."""
    tally = FeedTally("claimed")
    tally.take(simulated_feed(scene, sensor))
    return tally.checks()


def many(faults: Sequence[str], copies: int) -> Scene:
    """The scene with so many of those radars; the draws of each are its own."""
    scene = load(SCENE)
    sensors = [
        sensor.model_copy(update={"id": f"{sensor.id}-{i}"})
        for sensor in scene.sensor
        if sensor.id in faults
        for i in range(copies)
    ]
    return scene.model_copy(update={"sensor": tuple(sensors)})


def called_wrong(
    faults: Sequence[str], copies: int, duration_s: float, seed: int
) -> dict[str, list[set[str]]]:
    """The checks that each simulated feed fails, each judged by itself, by fault."""
    scene = many(faults, copies)
    seen = simulate(scene, duration_s, seed=seed, start_utc_ns=START_NS)
    found: dict[str, list[set[str]]] = {}
    for name, sensor in seen.items():
        wrong = Verdicts(claims_of(scene, sensor), "claimed").wrong
        found.setdefault(name.rpartition("-")[0], []).append({check.name for check in wrong})
    return found
