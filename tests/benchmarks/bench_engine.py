"""The engine under load: 200 rotating radars and a broker, the bare scheduler, and plots a second.

    python tests/benchmarks/bench_engine.py [SECONDS]

The radars turn once a second in 32 sectors each and report in categories 048 and 034, all in step:
200 sectors end every 31 ms at the same instant. The broker, and a subscriber that counts what
arrives, share the machine. The scheduler is set beside clock_nanosleep from C, in turns.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from demo_process import COMMAND  # noqa: E402
from support.arrivals import Arrivals  # noqa: E402
from support.brokers import free_port, mosquitto, rumqttd  # noqa: E402
from support.nanosleep import nanosleep_late_us  # noqa: E402
from support.road import flown, radar, rotating, staring, waypoint  # noqa: E402

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed  # noqa: E402
from plotfeed.feeds.scene.scene import Scene, from_tree  # noqa: E402
from plotfeed.feeds.session.loop import SessionLoop  # noqa: E402
from plotfeed.feeds.session.observer import Observer  # noqa: E402
from plotfeed.feeds.session.session import Session, run  # noqa: E402
from plotfeed.feeds.timing.clock import InstantClock, WallClock  # noqa: E402
from plotfeed.feeds.timing.schedule import Schedule  # noqa: E402

SECONDS = 30.0
RADARS, SECTORS, DRONES = 200, 32, 50
NS = 1_000_000_000
PERCENTILES = (50, 99, 99.9)


def scene_tree(sensors: list[dict[str, Any]], drones: int, **more: Any) -> dict[str, Any]:
    """Drones that fly to and fro within 9 km."""
    rng = np.random.default_rng(1)

    def place() -> dict[str, float]:
        return waypoint(rng.uniform(0, 360), 1.0, rng.uniform(1000, 9000))

    site = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    return {
        "scene": {"name": "load", "seed": 1, "site": site},
        "sensor": sensors,
        "drone": [flown(f"d{i}", place(), place()) for i in range(drones)],
        **more,
    }


def radars(number: int) -> list[dict[str, Any]]:
    """In a square of 6 km, with few false alarms."""
    rng = np.random.default_rng(2)
    return [
        radar(
            id=f"r{i}",
            scan=rotating(1.0, SECTORS),
            report=["asterix-048"],
            pfa=1e-8,
            position_enu_m=[float(x) for x in rng.uniform(-3000, 3000, 2)] + [0.0],
        )
        for i in range(number)
    ]


def toml(value: Any) -> str:
    """As TOML, inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


@contextmanager
def a_broker(folder: Path) -> Iterator[tuple[str, int]]:
    """Mosquitto where it is installed, else rumqttd."""
    port = free_port()
    if shutil.which("mosquitto") or Path("/usr/sbin/mosquitto").exists():
        with mosquitto(folder, port):
            yield "mosquitto", port
    else:
        with rumqttd(folder, {"v5.1": ("127.0.0.1", port, "")}):
            yield "rumqttd", port


def under_load(seconds: float) -> None:
    """A session in a process of its own, and what it says of itself."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = folder / "load.toml"
        tree = scene_tree(radars(RADARS), DRONES)
        scene.write_text("\n".join(f"{key} = {toml(value)}" for key, value in tree.items()))
        with a_broker(folder) as (broker, port):
            arrivals = Arrivals(port)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            url = f"mqtt://127.0.0.1:{port}"
            out = subprocess.run(
                [COMMAND, "run", scene, "--broker", url, "--duration", str(seconds), "--json"],
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            ).stdout
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            arrived = arrivals.count()
    totals = json.loads(out.splitlines()[-1])
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(
        f"{RADARS} radars of {SECTORS} sectors at 1 Hz, {DRONES} drones, {broker} and a subscriber "
        f"on the same {os.cpu_count()} cores, {seconds:g} s:\n"
    )
    print("| | |\n|---|--:|")
    for what, value in (
        ("messages sent by sensors", f"{totals['messages']:,}"),
        ("of these arrived", f"{arrived:,}"),
        ("undelivered", totals["undelivered"]),
        ("scans missed", totals["missed_scans"]),
        ("lateness p50, ms", f"{totals['lateness_p50_us'] / 1e3:.2f}"),
        ("lateness p99, ms (aim 5)", f"{totals['lateness_p99_us'] / 1e3:.2f}"),
        ("lateness p99.9, ms", f"{totals['lateness_p999_us'] / 1e3:.2f}"),
        ("processor, cores, start included (aim under 1)", f"{cpu_s / seconds:.2f}"),
    ):
        print(f"| {what} | {value} |")


class NothingComesIn:
    """For an engine that is given nothing."""

    def __len__(self) -> int:
        return 0

    def queue(self, *_: object) -> None:
        """Nothing comes."""

    def take_in(self, *_: object) -> None:
        """Nothing waits."""


def scheduler_us(deadlines: int, step_ns: int) -> list[float]:
    """The same of the engine: one schedule, one clock."""
    clock = WallClock()
    engine = SessionLoop(
        clock,
        Schedule(clock.wake),
        inputs=NothingComesIn(),
        drain=lambda: None,
    )
    late_ns: list[int] = []
    begin_ns = clock.now_ns() + 10_000_000

    def plan(i: int) -> None:
        due_ns = begin_ns + i * step_ns

        def done() -> None:
            late_ns.append(clock.now_ns() - due_ns)
            if i + 1 < deadlines:
                plan(i + 1)

        engine.schedule.put(due_ns, done)

    plan(0)
    asyncio.run(engine.work(None))
    clock.close()
    return [float(p) / 1e3 for p in np.percentile(late_ns, PERCENTILES)]


def beside_nanosleep(seconds: float) -> None:
    """In turns, medians of three."""
    step_ns = NS // (RADARS * SECTORS)
    deadlines = round(seconds * NS) // step_ns // 3
    ours, theirs, shares = [], [], []
    for _ in range(3):
        found = nanosleep_late_us(deadlines, step_ns)
        if found is not None:
            theirs.append(np.percentile(found, PERCENTILES))
        spent_s, began_s = time.process_time(), time.monotonic()
        ours.append(scheduler_us(deadlines, step_ns))
        shares.append((time.process_time() - spent_s) / (time.monotonic() - began_s))
    print(
        f"\n{NS // step_ns:,} deadlines a second, lateness in µs, medians of three runs in turns:\n"
    )
    print("| | p50 | p99 | p99.9 |\n|---|--:|--:|--:|")
    rows = [("engine", np.median(ours, axis=0))]
    if theirs:
        rows.append(("clock_nanosleep in C, timer slack 1 ns", np.median(theirs, axis=0)))
        ratio = rows[0][1] / rows[1][1]
    for name, row in rows:
        print(f"| {name} | " + " | ".join(f"{x:.0f}" for x in row) + " |")
    if theirs:
        print("| ratio (aim 2) | " + " | ".join(f"{x:.2f}" for x in ratio) + " |")
    print(f"\nThe engine took {np.median(shares):.2f} cores for it.")


def plots_a_second() -> None:
    """As fast as possible, in memory: models, encoding, links and account, without a broker."""
    print("\nPlots a second of one process, as fast as it can (aim 200,000):\n")
    print("| drones seen by one radar at once | with the ledger | without |\n|--:|--:|--:|")
    for drones in (100, 1000, 5000):
        sensor = radar(scan=staring(), report=["asterix-048"], pfa=1e-8, power_w=5e6)
        cells = []
        for truth in (True, False):
            tree = scene_tree([sensor], drones, mqtt={"truth": truth})
            tree["scene"]["start_utc"] = datetime(2026, 1, 1, tzinfo=UTC)
            cells.append(f"{rate(from_tree(tree, Path('load.toml')), 50_000 // drones):,.0f}")
        print(f"| {drones:,} | {cells[0]} | {cells[1]} |")


def rate(scene: Scene, scans: int) -> float:
    """Plots a second of processor time; median of three."""

    def once() -> float:
        at_work, clock = AtWork(), InstantClock(scene.scene.start_utc_ns)
        observers = [at_work]
        totals = asyncio.run(
            run(scene, clock=clock, broker="none", duration_s=float(scans), observers=observers)
        )
        return totals.plots / at_work.took_s

    return float(np.median([once() for _ in range(3)]))


class AtWork(Observer):
    """Processor time of a session from its beginning to its end, without what it takes to start."""

    def begun(self, _session: Session) -> None:
        self._begin_s = time.process_time()

    def ended(self) -> None:
        self.took_s = time.process_time() - self._begin_s


def main() -> None:
    """Prints tables."""
    seconds = float(sys.argv[1]) if sys.argv[1:] else SECONDS
    under_load(seconds)
    beside_nanosleep(seconds)
    keep_freed()
    with undisturbed(GARBAGE_OF_SESSION):
        plots_a_second()


if __name__ == "__main__":
    main()
