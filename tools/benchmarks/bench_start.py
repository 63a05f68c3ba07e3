"""How long until something is seen: of `plotfeed --help`, of `plotfeed demo`, and of 200 sensors.

    python tools/benchmarks/bench_start.py

Modules are compiled before anything is measured, as pip compiles what it installs. The start of one
radar and of 200 is a session without a broker that is over as soon as it has begun, by the
processor time of its process; of the one, the modules of ours that it loads too.
"""

from __future__ import annotations

import asyncio
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from aims import aim, processor_s, ratios, spread, table
from bench_engine import radars, scene_text
from demo_process import COMMAND, demo, subscriber

from plotfeed.proto import plotfeed_pb2 as pb

HELPS, DEMOS, STARTS, RADARS = 15, 9, 7, 200
AIM_HELP_S, AIM_PLOT_S, AIM_RADARS_S, AIM_MODULES = 0.3, 1.2, 1.2, 150
TIMEOUT_S = 20.0


# What each is set beside: Python that loads NumPy and ends.
NUMPY = (sys.executable, "-c", "import numpy")


def wall_s(command: Sequence[object]) -> float:
    """Of one run of a command."""
    start = time.perf_counter()
    subprocess.run([str(word) for word in command], check=True, capture_output=True)
    return time.perf_counter() - start


def modules(scene: Path) -> int:
    """How many modules of ours a session of a scene loads that reaches nobody."""
    code = (
        "import asyncio, sys; from plotfeed import load, run; "
        f"asyncio.run(run(load({str(scene)!r}), broker='none', duration_s=0.05)); "
        "print(sum(name.partition('.')[0] == 'plotfeed' for name in sys.modules))"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return int(told.stdout)


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
        subscriber(running, ["plotfeed/tower/plots"], heard),
    ):
        await asyncio.wait_for(done.wait(), TIMEOUT_S)
        start_ns = running.started_ns
    return (arrivals["sector"] - start_ns) / 1e9, (arrivals["plot"] - start_ns) / 1e9


def main() -> None:
    """Prints a table."""
    with tempfile.TemporaryDirectory() as compiled:
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = compiled
        asyncio.run(first_messages_s())
        _measure()


def _measure() -> None:
    helps, beside_help = zip(
        *((wall_s([COMMAND, "--help"]), wall_s(NUMPY)) for _ in range(HELPS)), strict=True
    )
    sectors, plots, beside_demo = zip(
        *((*asyncio.run(first_messages_s()), wall_s(NUMPY)) for _ in range(DEMOS)), strict=True
    )
    with tempfile.TemporaryDirectory() as folder:
        one, scene = Path(folder) / "radar.toml", Path(folder) / "radars.toml"
        one.write_text(scene_text(radars(1), 1))
        scene.write_text(scene_text(radars(RADARS), 50))
        how = ["--broker", "none", "--duration", "0.01", "--json"]
        alone, starts, beside_start = zip(
            *(
                (
                    processor_s([COMMAND, "run", one, *how], capture_output=True),
                    processor_s([COMMAND, "run", scene, *how], capture_output=True),
                    processor_s(NUMPY, capture_output=True),
                )
                for _ in range(STARTS)
            ),
            strict=True,
        )
        ours = modules(one)
    print("Seconds from the start of the process, and times what Python takes that loads NumPy and")
    print("ends, in turns: median (least to most).\n")
    rows = (
        ("`plotfeed --help`, to its end", helps, beside_help),
        ("`plotfeed demo`, to the first sector at a subscriber", sectors, beside_demo),
        ("`plotfeed demo`, to the first plot at a subscriber", plots, beside_demo),
        ("one radar, processor time", alone, beside_start),
        (f"{RADARS} radars, processor time", starts, beside_start),
    )
    table(
        ("", "s", "× NumPy", "repeats"),
        ((what, spread(s), spread(ratios(s, beside), ".1f"), len(s)) for what, s, beside in rows),
    )
    print()
    for what, values, aim_s in (
        ("`plotfeed --help`", helps, AIM_HELP_S),
        ("`plotfeed demo`, to the first plot", plots, AIM_PLOT_S),
        (f"{RADARS} radars, processor time", starts, AIM_RADARS_S),
    ):
        middle_s = statistics.median(values)
        print(aim(what, f"{aim_s:g} s", f"{middle_s:.2f} s", is_met=middle_s < aim_s))
    print(aim("modules of one radar", str(AIM_MODULES), str(ours), is_met=ours <= AIM_MODULES))
    print("\nThe plot waits for the beam to come round to the drone: up to a scan of one second.")


if __name__ == "__main__":
    main()
