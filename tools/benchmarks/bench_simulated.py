"""How fast simulated time can be, times real time: without a broker, as fast as one core can.

    python tools/benchmarks/bench_simulated.py [REPEATS]

The smallest scene is one rotating radar of 32 sectors a second and one drone, in categories 048 and
034. Two sessions of each scene, of which one lasts longer: what both take to begin and to end falls
out. By processor time.
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from aims import YARDSTICK, aim, ratios, spread, yardstick_us
from bench_engine import radars, scene_tree

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock

REPEATS, AIM = 5, 1500
# Radars, drones, and simulated seconds.
CASES = ((1, 1, 240.0), (4, 10, 60.0), (20, 50, 12.0), (200, 50, 2.0))


def scene_of(sensors: int, drones: int, *, truth: bool) -> Any:
    """Radars in step, and drones that the scene flies."""
    tree = scene_tree(radars(sensors), drones, mqtt={"truth": truth})
    tree["scene"]["start_utc"] = datetime(2026, 1, 1, tzinfo=UTC)
    return from_tree(tree, Path("simulated.toml"))


def spent(scene: Any, seconds: float) -> tuple[float, int]:
    """Processor time of a session so long, and its messages."""
    clock, began_s = InstantClock(scene.scene.start_utc_ns), time.process_time()
    totals = asyncio.run(run(scene, clock=clock, broker="none", duration_s=seconds))
    return time.process_time() - began_s, totals.messages


def main() -> None:
    """Prints a table."""
    repeats = int(sys.argv[1]) if sys.argv[1:] else REPEATS
    keep_freed()
    print(f"Median (least to most) of {repeats} repeats. {YARDSTICK}\n")
    print("| radars | drones | ledger | times real time | µs a message | messages a yardstick |")
    print("|--:|--:|---|--:|--:|--:|")
    first: list[float] = []
    for sensors, drones, seconds in CASES:
        for truth in (True, False):
            scene = scene_of(sensors, drones, truth=truth)
            times, costs, yardsticks = [], [], []
            for _ in range(repeats):
                yardsticks.append(yardstick_us())
                with undisturbed(GARBAGE_OF_SESSION):
                    short_s, few = spent(scene, seconds / 4)
                    long_s, many = spent(scene, seconds * 5 / 4)
                times.append(seconds / (long_s - short_s))
                costs.append(1e6 * (long_s - short_s) / (many - few))
            first = first or times
            cells = (
                f"{sensors} | {drones} | {'yes' if truth else 'no'}",
                spread(times, ",.1f"),
                spread(costs, ".1f"),
                spread(ratios(yardsticks, costs), ".1f"),
            )
            print(f"| {' | '.join(cells)} |", flush=True)
    middle = statistics.median(first)
    limit, found = f"{AIM:,} times real time", f"{middle:,.0f} times"
    print("\n" + aim("one radar and one drone", limit, found, is_met=middle >= AIM))


if __name__ == "__main__":
    main()
