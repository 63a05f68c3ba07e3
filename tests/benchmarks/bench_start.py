"""How long until something is seen: of `plotfeed --help`, of `plotfeed demo`, and of 200 sensors.

    python tests/benchmarks/bench_start.py

The start of 200 radars is a session without a broker that is over as soon as it has begun, by the
processor time of its process.
"""

from __future__ import annotations

import asyncio
import resource
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from aims import aim
from bench_engine import radars, scene_text
from demo_process import COMMAND, demo, subscriber

from plotfeed.proto import plotfeed_pb2 as pb

HELPS, DEMOS, STARTS, RADARS = 15, 9, 7, 200
AIM_HELP_S, AIM_PLOT_S, AIM_RADARS_S = 0.3, 3.0, 1.5
TIMEOUT_S = 20.0


def help_s() -> float:
    """Wall time of one `plotfeed --help`."""
    start = time.perf_counter()
    subprocess.run([COMMAND, "--help"], check=True, capture_output=True)
    return time.perf_counter() - start


def radars_start_s(scene: Path) -> float:
    """Processor time of a session of many sensors that is over at once."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [COMMAND, "run", scene, "--broker", "none", "--duration", "0.01", "--json"]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


async def first_messages_s() -> tuple[float, float]:
    """From the start of the process to the first message of a sector, and to the first plot."""
    arrivals: dict[str, int] = {}
    done = asyncio.Event()

    def heard(_topic: str, payload: bytes, _properties: dict[str, Any]) -> None:
        arrivals.setdefault("sector", time.monotonic_ns())
        if pb.PlotBatch.FromString(payload).plots:
            arrivals.setdefault("plot", time.monotonic_ns())
            done.set()

    async with (
        demo("--duration", "15") as running,
        subscriber(running, ["plotfeed/active/plots"], heard),
    ):
        await asyncio.wait_for(done.wait(), TIMEOUT_S)
        start_ns = running.started_ns
    return (arrivals["sector"] - start_ns) / 1e9, (arrivals["plot"] - start_ns) / 1e9


def main() -> None:
    """Prints a table."""
    helps = [help_s() for _ in range(HELPS)]
    sectors, plots = zip(*(asyncio.run(first_messages_s()) for _ in range(DEMOS)), strict=True)
    print("Seconds from the start of the process: median (least to most).\n")
    print("| | s | repeats |\n|---|--:|--:|")
    print(f"| `plotfeed --help`, to its end | {_spread(helps)} | {HELPS} |")
    print(
        f"| `plotfeed demo`, to the first sector at a subscriber | {_spread(sectors)} | {DEMOS} |"
    )
    print(f"| `plotfeed demo`, to the first plot at a subscriber | {_spread(plots)} | {DEMOS} |")
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "radars.toml"
        scene.write_text(scene_text(radars(RADARS), 50))
        starts = [radars_start_s(scene) for _ in range(STARTS)]
    print(f"| {RADARS} radars, processor time | {_spread(starts)} | {STARTS} |\n")
    for what, values, aim_s in (
        ("`plotfeed --help`", helps, AIM_HELP_S),
        ("`plotfeed demo`, to the first plot", plots, AIM_PLOT_S),
        (f"{RADARS} radars, processor time", starts, AIM_RADARS_S),
    ):
        middle_s = statistics.median(values)
        print(aim(what, f"{aim_s:g} s", f"{middle_s:.2f} s", is_met=middle_s < aim_s))
    print("\nThe plot waits for the beam to come round to the drone: up to a scan of one second.")


def _spread(values: Any) -> str:
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


if __name__ == "__main__":
    main()
