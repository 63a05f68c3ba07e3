"""A fleet on this machine: plots a second by workers, and how long a take-over takes.

    python tests/benchmarks/bench_fleet.py

Plots a second are of a scene of radars in simulated time, without broker or ledger: by the
processor time of the worker that takes most, as if each had a core of its own, however busy this
machine is. One worker has all of it. Take-overs are of a fleet in real time over mosquitto, whose
worker gets SIGKILL or SIGSTOP: what nobody sends, in scans of 1 s. What a worker pays for telemetry
is processor time a second, with and without cells, by how many drones report in all.
"""

from __future__ import annotations

import asyncio
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from aims import aim, ratios, spread  # noqa: E402
from support.brokers import free_port, mosquitto  # noqa: E402
from support.fleet_process import NS, Fleet, fleet  # noqa: E402
from support.road import radar, rotating, scene  # noqa: E402
from support.scene_files import DRONE, scene_file, scene_text  # noqa: E402
from support.scene_files import radar as radar_text  # noqa: E402

from plotfeed.feeds.fleet.coordinator import Coordinator  # noqa: E402
from plotfeed.feeds.fleet.fleet_parts import LATE, FleetSettings, Worker  # noqa: E402
from plotfeed.feeds.fleet.ray_workers import starter  # noqa: E402
from plotfeed.feeds.scene.scene import Scene  # noqa: E402
from plotfeed.feeds.workers.ray_engine import connected  # noqa: E402

RADARS, DRONES, SIMULATED_S, RUNS = 100, 50, 20.0, 3
SPEEDUP, MOST_SCANS = 1.8, 2.0
KILLS, FREEZES = 5, 2
LEASE_S = 1.0
TOTALS, WINDOW_S = (50, 400), 5.0


def many() -> Scene:
    """Radars in a row of 100 km, and drones that fly along it."""
    sensors = [
        radar(
            id=f"r{i}", scan=rotating(1.0, 32), report=["asterix-048"], pfa=1e-6,
            position_enu_m=[1000.0 * i, 0.0, 0.0],
        )
        for i in range(RADARS)
    ]  # fmt: skip
    drones = [
        {
            "id": f"d{i}", "speed_m_s": 20.0, "repeat": True, "rcs_m2": 0.5,
            "path": [
                {"east_m": 2000.0 * i, "north_m": 1500.0, "above_site_m": 300.0},
                {"east_m": 2000.0 * i + 1500.0, "north_m": -1500.0, "above_site_m": 300.0},
            ],
        }
        for i in range(DRONES)
    ]  # fmt: skip
    return scene(sensors, drones, seed=1, mqtt={"truth": False})


async def plots_per_s(start: Callable[[], Any], workers: int) -> float:
    """Of one run."""
    seconds: list[float] = []

    async def noting() -> Worker:
        worker: Worker = await start()
        serve = worker.serve

        async def timed(order: Any) -> dict[str, Any]:
            ended = await serve(order)
            seconds.append(ended["processor_s"])
            return ended

        worker.serve = timed  # type: ignore[method-assign]
        return worker

    settings = FleetSettings(
        workers=workers, broker="none", duration_s=SIMULATED_S, is_simulated=True
    )
    at_work = Coordinator(many(), settings, noting)
    await at_work.run(asyncio.Event())
    for worker in at_work._idle:
        worker.leave()
    return at_work.counts["plots"] / max(seconds)


def by_workers() -> tuple[list[float], list[float]]:
    """Plots a second of a core with one worker and with two, run by run."""
    one, two = [], []
    with connected(None, 2) as ray:
        for _ in range(RUNS):
            one.append(asyncio.run(plots_per_s(starter(ray), 1)))
            two.append(asyncio.run(plots_per_s(starter(ray), 2)))
    return one, two


def take_overs(folder: Path) -> dict[str, list[float]]:
    """Seconds of which nobody sent anything, by what became of a worker."""
    port = free_port()
    sensors = "".join(
        radar_text(f"r{i}", period_s=1.0, more=f"position_enu_m = [{300.0 * i}, 0.0, 0.0]")
        for i in range(10)
    )
    path = scene_file(folder, scene_text(sensors=sensors, drones=DRONE))
    found: dict[str, list[float]] = {"killed": [], "frozen": []}
    words = ("--workers", "2", "--lease", str(LEASE_S), "--spares", "2")
    with mosquitto(folder, port), fleet(path, port, *words) as at_work:
        at_work.wait(lambda: at_work.sends(2, 0), "it never began")
        for what in ["killed"] * KILLS + ["frozen"] * FREEZES:
            time.sleep(4.0)
            found[what].append(gap_s(at_work, what))
    return found


def taken_over(at_work: Fleet) -> list[dict[str, Any]]:
    """Gaps of parts that nobody held."""
    return [gap for gap in at_work.health()["gaps"] if not gap["why"].endswith(LATE)]


def gap_s(at_work: Fleet, what: str) -> float:
    """What is missing after one fault, seconds."""
    before = len(taken_over(at_work))
    pid = next(iter(at_work.pids().values()))
    os.kill(pid, signal.SIGKILL if what == "killed" else signal.SIGSTOP)

    def is_over() -> bool:
        gaps = taken_over(at_work)
        return len(gaps) > before and all(gap["to_utc_ns"] for gap in gaps)

    at_work.wait(is_over, "nobody took over")
    if what == "frozen":
        os.kill(pid, signal.SIGCONT)
    gap = taken_over(at_work)[before]
    return float((gap["to_utc_ns"] - gap["from_utc_ns"]) / NS)


def cores_of(pid: int) -> float:
    """Processor time of a process so far, seconds."""
    told = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")


def telemetry_cost(folder: Path, drones: int, *cells: str) -> float:
    """Cores of the worker of one sensor of two that are far apart; most drones are elsewhere."""
    port = free_port()
    sensors = "".join(
        radar_text(name, period_s=1.0, more=f"position_enu_m = [{east_m}, 0.0, 0.0]")
        for name, east_m in (("here", 0.0), ("there", 200_000.0))
    )
    path = scene_file(folder, scene_text(sensors=sensors, drones=""))
    words = ("--workers", "2", "--lease", "10", *cells)
    with mosquitto(folder, port), fleet(path, port, *words) as at_work:
        at_work.wait(lambda: at_work.sends(2, 0), "it never began")
        elsewhere = str(HERE / "bench_scaling.py")
        flying = subprocess.Popen([sys.executable, elsewhere, "fly", str(port), str(drones)])
        try:
            time.sleep(4.0)
            parts = {p["sensors"][0]: p["part"] for p in at_work.health()["parts"]}
            pid = at_work.pids()[parts["there"]]  # all of them fly about the other
            before, since = cores_of(pid), time.monotonic()
            time.sleep(WINDOW_S)
            return (cores_of(pid) - before) / (time.monotonic() - since)
        finally:
            flying.kill()
            flying.wait()


def main() -> None:
    """Prints what the page says."""
    one, two = by_workers()
    gain = ratios(two, one)
    print(f"- One worker: {spread(one, ',.0f')} plots a second; two: {spread(two, ',.0f')}.")
    found = f"{spread(gain)}, {RUNS} runs"
    met = statistics.median(gain) >= SPEEDUP
    print(aim("plots a second with two workers, to one", f"{SPEEDUP:g}", found, is_met=met))
    with tempfile.TemporaryDirectory() as name:
        gaps = take_overs(Path(name))
    for what, each in gaps.items():
        print(f"- A worker {what}: nothing of its sensors for {spread(each)} s, or scans.")
    met = statistics.median(gaps["killed"]) < MOST_SCANS
    found = f"{spread(gaps['killed'])} scans of 1 s, {KILLS} kills"
    print(aim("a dead worker's sensors are taken over", f"under {MOST_SCANS:g} scans", found,
              is_met=met))  # fmt: skip
    print("\n| drones elsewhere, 10 Hz | all to all, cores | by cells, cores |\n|--:|--:|--:|")
    for drones in TOTALS:
        costs = []
        for cells in ((), ("--cells", "6")):
            with tempfile.TemporaryDirectory() as name:
                costs.append(telemetry_cost(Path(name), drones, *cells))
        print(f"| {drones} | {costs[0]:.3f} | {costs[1]:.3f} |")


if __name__ == "__main__":
    main()
