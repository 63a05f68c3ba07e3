"""Nanoseconds per target of the physics: from where drones are to what was measured of them.

    python tools/benchmarks/bench_model.py

The radar of scene section-4 stares at drones of 0.01 m2 between 2 and 7 km, so that nearly every
look becomes a plot: the dearest case. Stages are timed inside the very looks that are counted.
Between these are timed the random numbers that a plot takes, and one small addition by NumPy: what
the machine can do at all.
"""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
from aims import aim, ratios, spread, table
from section_4_crowd import at_work, next_sectors, scene_of

from plotfeed.feeds.console.process import keep_freed
from plotfeed.feeds.engine.emulated_sensors import SensorGroup
from plotfeed.models.beam import Sectors
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import Axes
from plotfeed.models.sensors.active_radar import ActiveRadar

SIZES = (1, 10, 100, 1000, 10_000)
THREE = np.ones(3)
REPEATS = 9
SECONDS_A_REPEAT = 0.15
AIM = 2.5  # Times what the random numbers alone take, at 10,000 targets

# The path that is counted, then what else a report needs.
PATH = {
    "_there_at_the_end": (SensorGroup, "where drones are"),
    "_targets": (SensorGroup, "seen from the sensor"),
    "observe": (ActiveRadar, "looks, hits, errors"),
    "heights_m": (Axes, "heights of plots"),
}
DETAIL = {"measured": (ActiveRadar, "errors and plots, within observe")}
CHANCE = Chance(1, "random numbers")
REFERENCES = {
    "reported": "a whole look, false alarms too, with its plots encoded before the next",
    "random": "beside them: the random numbers of a plot alone",
    "addition": "beside them: one addition of three numbers, not divided by the targets",
}
ADDITIONS = 100


class Stopwatches:
    """Times calls of methods, by their names, until it is taken off."""

    def __init__(self, methods: dict[str, tuple[type, str]]) -> None:
        self.spent_ns: dict[str, int] = defaultdict(int)
        self._plain = {name: (owner, getattr(owner, name)) for name, (owner, _) in methods.items()}
        for name, (owner, plain) in self._plain.items():
            setattr(owner, name, self._timed(name, plain))

    def _timed(self, name: str, plain: Any) -> Any:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start_ns = time.perf_counter_ns()
            result = plain(*args, **kwargs)
            self.spent_ns[name] += time.perf_counter_ns() - start_ns
            return result

        return timed

    def take_off(self) -> None:
        """The methods as they were."""
        for name, (owner, plain) in self._plain.items():
            setattr(owner, name, plain)


def measure(n: int) -> dict[str, list[float]]:
    """Nanoseconds per target of each stage, one value a repeat."""
    keep_freed()
    engine = at_work(scene_of(n, report=["plots"]), after_s=4)
    found: dict[str, list[float]] = defaultdict(list)
    group, sectors = _worked_out(lambda: next_sectors(engine))
    for _ in range(REPEATS):
        in_between = Stopwatches({"look": (SensorGroup, "")})
        reports, end_s = 0, time.perf_counter() + SECONDS_A_REPEAT
        while time.perf_counter() < end_s:
            next_sectors(engine)
            reports += 1
        in_between.take_off()
        found["reported"].append(in_between.spent_ns["look"] / reports / n)
        watches = Stopwatches(PATH | DETAIL)
        reports, end_s = 0, time.perf_counter() + SECONDS_A_REPEAT
        while time.perf_counter() < end_s:
            group.look(sectors)
            reports += 1
        watches.take_off()
        found["random"].append(_timed_ns(lambda: _random_numbers(n), 10) / n)
        found["addition"].append(_timed_ns(lambda: THREE + THREE, ADDITIONS))
        for name in PATH | DETAIL:
            found[name].append(watches.spent_ns[name] / reports / n)
        found["path"].append(sum(found[name][-1] for name in PATH))
    return found


def _worked_out(report: Callable[[], object]) -> tuple[SensorGroup, Sectors]:
    """The group that works a report out, and its sectors."""
    asked: list[tuple[SensorGroup, Sectors]] = []
    plain = SensorGroup.look

    def look(group: SensorGroup, sectors: Sectors) -> Any:
        asked.append((group, sectors))
        return plain(group, sectors)

    SensorGroup.look = look  # type: ignore[method-assign]
    report()
    SensorGroup.look = plain  # type: ignore[method-assign]
    return asked[-1]


def _random_numbers(n: int) -> None:
    """A hit, a detection's power and its threshold, and three errors, for each of n."""
    rng = CHANCE.rng(Purpose.DETECTION, 1)
    rng.random(n)
    rng.standard_gamma(16.0, n)
    rng.standard_exponential(n)
    rng.standard_normal((3, n))


def _timed_ns(act: Callable[[], object], times: int) -> float:
    start_ns = time.perf_counter_ns()
    for _ in range(times):
        act()
    return (time.perf_counter_ns() - start_ns) / times


def main() -> None:
    """Prints a table and how the aim was met."""
    times = {n: measure(n) for n in SIZES}
    rows = {"path": "**the model path**"} | {k: what for k, (_, what) in (PATH | DETAIL).items()}
    rows |= REFERENCES
    print(
        f"ns per target: median (least to most) of {REPEATS} repeats. Nearly every look is a hit.\n"
    )
    cells = ([label, *(_spread(times[n][name]) for n in SIZES)] for name, label in rows.items())
    table(["targets at once", *(f"{n:,}" for n in SIZES)], cells)
    print()
    most = times[SIZES[-1]]
    reached, random = (statistics.median(most[name]) for name in ("path", "random"))
    what, limit = f"{SIZES[-1]:,} targets", f"{AIM} times what the random numbers alone take"
    found = f"{spread(ratios(most['path'], most['random']))} times, {reached:.0f} ns"
    print(aim(what, limit, found, is_met=reached <= AIM * random))


def _spread(values: list[float]) -> str:
    return f"{statistics.median(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"


if __name__ == "__main__":
    main()
