"""Whether lateness grows: a session in real time, and the slope of how late its messages leave.

    python tools/benchmarks/bench_drift.py [SECONDS]

Twenty rotating radars of 32 sectors, their turns begun at different times, without a broker.
Lateness is taken as means of a second, since neighbours share what delays them; the slope is by
least squares. Beside it stands what a scheduler would drift that sleeps a period instead of until a
deadline.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from plotfeed.feeds.link.counters import SessionCounters  # noqa: E402
from plotfeed.feeds.messages.message import Message  # noqa: E402
from plotfeed.feeds.session.session import run  # noqa: E402
from plotfeed.feeds.timing.clock import WallClock  # noqa: E402
from plotfeed.testing import flown, radar, rotating, scene, waypoint  # noqa: E402

SECONDS, RUNS = 40.0, 3
RADARS, SECTORS = 20, 32
NS = 1_000_000_000
Floats = NDArray[np.float64]


def lateness(seconds: float) -> tuple[Floats, Floats, SessionCounters]:
    """When messages were due, seconds from the first; how late they left, ms; and the totals."""
    sensors = [
        radar(id=f"r{i}", scan=rotating(1.0 + i / 1000, SECTORS), report=["asterix-048"], pfa=1e-8)
        for i in range(RADARS)
    ]
    drones = [
        flown(f"d{i}", waypoint(20.0 * i, 2.0, 2000.0), waypoint(20.0 * i, 2.0, 6000.0))
        for i in range(5)
    ]
    what = scene(sensors, drones, seed=1, mqtt={"truth": False})
    seen: list[tuple[int, int]] = []

    def tap(message: Message, sent_utc_ns: int) -> None:
        if "/asterix/" in message.topic:
            seen.append((message.due_utc_ns, sent_utc_ns))

    totals = asyncio.run(run(what, clock=WallClock(), broker="none", duration_s=seconds, tap=tap))
    due_ns, sent_ns = np.array(seen).T
    return (due_ns - due_ns[0]) / NS, (sent_ns - due_ns) / 1e6, totals


def slope(t_s: Floats, late_ms: Floats) -> tuple[float, float, float]:
    """In ms a minute, of means of a second; its standard error; and the p-value of none."""
    second = t_s.astype(int)
    whole = np.unique(second)[1:-1]
    means = [float(late_ms[second == s].mean()) for s in whole]
    fit = stats.linregress(whole / 60, means)
    return float(fit.slope), float(fit.stderr), float(fit.pvalue)


def naive_ms_a_minute(seconds: float, period_s: float = 1 / SECTORS) -> float:
    """Of a loop that sleeps one period after the other."""

    async def work() -> float:
        begin_s, steps = time.monotonic(), round(seconds / period_s)
        for _ in range(steps):
            await asyncio.sleep(period_s)
        return time.monotonic() - begin_s - steps * period_s

    return asyncio.run(work()) * 1e3 / seconds * 60


def main() -> None:
    """Prints a table."""
    seconds = float(sys.argv[1]) if sys.argv[1:] else SECONDS
    print(f"{RADARS} radars of {SECTORS} sectors at about 1 Hz, no broker, {RUNS} runs of "
          f"{seconds:g} s.\nThe slope is in ms a minute, with its standard error; p is that of no "
          "slope.\n")  # fmt: skip
    print("| run | messages | lateness p50, p99, ms | slope | p | scans missed | sleeping, slope |")
    print("|--:|--:|--:|--:|--:|--:|--:|")
    for run_ in range(RUNS):
        t_s, late_ms, totals = lateness(seconds)
        found, error, p = slope(t_s, late_ms)
        p50, p99 = np.percentile(late_ms, (50, 99))
        naive = naive_ms_a_minute(10.0)
        print(
            f"| {run_ + 1} | {len(late_ms):,} | {p50:.2f}, {p99:.2f} | {found:+.3f} ± {error:.3f} "
            f"| {p:.2f} | {totals.missed_scans} | {naive:+,.0f} |",
            flush=True,
        )
    print("\nThe last is of a loop that sleeps one sector after the other.")


if __name__ == "__main__":
    main()
