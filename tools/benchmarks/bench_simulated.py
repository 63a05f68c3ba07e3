"""How fast simulated time can be, times real time: without a broker, as fast as one core can.

    python tools/benchmarks/bench_simulated.py [REPEATS]

The smallest scene is one rotating radar of 32 sectors a second and one drone, in categories 048 and
034; the radar that stares sees every drone. Two sessions of each scene, of which one lasts longer:
what both take to begin and to end falls out. By processor time.
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import time
from collections.abc import Iterator

from aims import YARDSTICK, aim, ratios, spread, table, yardstick_us
from bench_engine import drones, radars

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.testing import START_NS, radar, scene, staring

REPEATS, AIM = 5, 1500
AIM_DRONES, AIM_PLOTS = 1000, 300_000
# Radars in step, or one that stares; drones that the scene flies; simulated seconds.
CASES = (
    *((1, 1, 240.0), (4, 10, 60.0), (20, 50, 12.0), (200, 50, 2.0)),
    *(("stares", n, 50_000 / n) for n in (100, AIM_DRONES, 5000)),
)
SEEING = radar(scan=staring(), report=["asterix-048"], pfa=1e-8, power_w=5e6)
Key = tuple[int | str, int, bool]


def scene_of(number: int | str, flown: int, *, truth: bool) -> Scene:
    """One of the cases, with the ledger or without."""
    sensors = radars(number) if isinstance(number, int) else [SEEING]
    return scene(sensors, drones(flown), seed=1, mqtt={"truth": truth})


def spent(made: Scene, seconds: float) -> tuple[float, SessionCounters]:
    """Processor time of a session so long, and its totals."""
    clock, began_s = InstantClock(START_NS), time.process_time()
    totals = asyncio.run(run(made, clock=clock, broker="none", duration_s=seconds))
    return time.process_time() - began_s, totals


def main() -> None:
    """Prints a table."""
    repeats = int(sys.argv[1]) if sys.argv[1:] else REPEATS
    keep_freed()
    print(f"Median (least to most) of {repeats} repeats. {YARDSTICK}\n")
    faster: dict[Key, list[float]] = {}
    plots_s: dict[Key, list[float]] = {}

    def rows() -> Iterator[tuple[str, ...]]:
        for number, flown, seconds in CASES:
            for truth in (True, False):
                made, key = scene_of(number, flown, truth=truth), (number, flown, truth)
                faster[key], plots_s[key], costs, yardsticks = [], [], [], []
                for _ in range(repeats):
                    yardsticks.append(yardstick_us())
                    with undisturbed(GARBAGE_OF_SESSION):
                        short_s, few = spent(made, seconds / 4)
                        long_s, many = spent(made, seconds * 5 / 4)
                    took_s = long_s - short_s
                    faster[key].append(seconds / took_s)
                    plots_s[key].append((many.plots - few.plots) / took_s)
                    costs.append(1e6 * took_s / (many.messages - few.messages))
                yield (
                    *(f"{number}", f"{flown:,}", "yes" if truth else "no"),
                    *(spread(faster[key], ",.1f"), spread(plots_s[key], ",.0f")),
                    *(spread(costs, ".1f"), spread(ratios(yardsticks, costs), ".1f")),
                )

    head = ("radars", "drones", "ledger", "times real time", "plots/s", "µs a message")
    table((*head, "messages a yardstick"), rows(), 3)
    print()
    for what, limit, least, unit, found in (
        ("one radar and one drone", f"{AIM:,} times real time", AIM, "times", faster[1, 1, True]),
        ("with the ledger at 1,000 drones", f"{AIM_PLOTS:,} plots a second", AIM_PLOTS, "a second",
         plots_s["stares", AIM_DRONES, True]),
    ):  # fmt: skip
        middle = statistics.median(found)
        print(aim(what, limit, f"{middle:,.0f} {unit}", is_met=middle >= least))


if __name__ == "__main__":
    main()
