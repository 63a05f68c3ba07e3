"""A fleet on this machine: plots a second by workers, take-overs, and what others' drones cost.

    python tests/benchmarks/bench_fleet.py

Plots a second are of a scene of radars in simulated time, without broker or ledger: by the
processor time of the worker that takes most, as if each had a core of its own, however busy this
machine is, and by the clock. A run of a worker has its start in it, a quarter of a second or so.
Take-overs are of a fleet in real time over mosquitto, whose worker gets SIGKILL or SIGSTOP: what
nobody sends. What a worker pays for telemetry is processor time a second, by
how many drones report in all.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from aims import aim, ratios, spread  # noqa: E402
from support.brokers import free_port, mosquitto  # noqa: E402
from support.fleet_process import NS, Fleet, fleet  # noqa: E402
from support.road import START_NS, radar, rotating, scene  # noqa: E402
from support.scene_files import DRONE, scene_file, scene_text  # noqa: E402
from support.scene_files import radar as radar_text  # noqa: E402

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed  # noqa: E402
from plotfeed.feeds.fleet.coordinator import Coordinator  # noqa: E402
from plotfeed.feeds.fleet.fleet_parts import LATE, FleetSettings, Worker  # noqa: E402
from plotfeed.feeds.fleet.partition import partition  # noqa: E402
from plotfeed.feeds.fleet.ray_workers import starter  # noqa: E402
from plotfeed.feeds.lab.runs import connected  # noqa: E402
from plotfeed.feeds.scene.scene import Scene  # noqa: E402
from plotfeed.feeds.session.observer import Observer, RunningSession  # noqa: E402
from plotfeed.feeds.session.session import run_over  # noqa: E402
from plotfeed.feeds.session.session_part import SessionPart  # noqa: E402
from plotfeed.feeds.timing.clock import InstantClock  # noqa: E402

RADARS, DRONES, SIMULATED_S, RUNS = 100, 50, 60.0, 4
SPEEDUP, MOST_SCANS = 1.8, 2.0
KILLS, FREEZES = 5, 3
LEASE_S = 1.0
TOTALS, WINDOW_S = (50, 400), 5.0
ELSEWHERE, OTHERS_S, OTHERS_RUNS = (0, 500, 2000), 20.0, 3


def many(elsewhere: int = 0) -> Scene:
    """Radars in a row of 100 km, drones that fly along it, and some that are far from all."""
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
    drones += [
        {
            "id": f"e{i}", "speed_m_s": 20.0, "repeat": True, "rcs_m2": 0.5,
            "path": [
                {"east_m": -2e5 - 50.0 * i, "north_m": north_m, "above_site_m": 300.0}
                for north_m in (-1500.0, 1500.0)
            ],
        }
        for i in range(elsewhere)
    ]  # fmt: skip
    return scene(sensors, drones, seed=1, mqtt={"truth": False})


@dataclass(frozen=True)
class Pace:
    """Plots a second, by the processor time of who took most of it, and by the clock."""

    of_a_core: float
    by_the_clock: float


def one_process() -> Pace:
    """A session of the whole scene in this process, which keeps memory as a worker does."""
    keep_freed()
    made, clock = many(), InstantClock(START_NS)
    began_s, began_of_core_s = time.monotonic(), time.process_time()
    with undisturbed(GARBAGE_OF_SESSION):
        totals = asyncio.run(run_over(([], {}), made, clock=clock, duration_s=SIMULATED_S))
    of_core_s = time.process_time() - began_of_core_s
    return Pace(totals.plots / of_core_s, totals.plots / (time.monotonic() - began_s))


async def of_workers(start: Callable[[], Any], workers: int) -> Pace:
    """One run by so many."""
    of_core_s: list[float] = []
    by_clock_s: list[float] = []

    async def noting() -> Worker:
        worker: Worker = await start()
        serve = worker.serve

        async def timed(order: Any) -> dict[str, Any]:
            began_s = time.monotonic()
            ended = await serve(order)
            by_clock_s.append(time.monotonic() - began_s)
            of_core_s.append(ended["processor_s"])
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
    plots = at_work.counts["plots"]
    return Pace(plots / max(of_core_s), plots / max(by_clock_s))


def paces() -> dict[str, list[Pace]]:
    """Of one process and of workers, in turns."""
    found: dict[str, list[Pace]] = {"one process": [], "1 worker": [], "2 workers": []}
    with connected(None, 2) as ray:
        for _ in range(RUNS):
            found["one process"].append(one_process())
            for workers, name in ((1, "1 worker"), (2, "2 workers")):
                found[name].append(asyncio.run(of_workers(starter(ray), workers)))
    return found


def table_of(found: dict[str, list[Pace]]) -> list[float]:
    """Prints what that came to; how many times one worker two are, run by run."""
    print(f"Median (least to most) of {RUNS} turns, {SIMULATED_S:g} s of {RADARS} radars and")
    print(f"{DRONES} drones each. {os.cpu_count()} cores.\n")
    print("| | plots a second of a core | times one process | by the clock, times one process |")
    print("|---|--:|--:|--:|")
    one = found["one process"]
    for name, each in found.items():
        of_core = [pace.of_a_core for pace in each]
        times = ratios(of_core, [pace.of_a_core for pace in one])
        clock = ratios([p.by_the_clock for p in each], [p.by_the_clock for p in one])
        print(f"| {name} | {spread(of_core, ',.0f')} | {spread(times)} | {spread(clock)} |")
    two, by_one = found["2 workers"], found["1 worker"]
    return ratios([pace.of_a_core for pace in two], [pace.of_a_core for pace in by_one])


class Begins(Observer):
    """Notes when drones fly and sensors are at work."""

    began_s = 0.0

    def begun(self, session: RunningSession) -> None:
        del session
        self.began_s = time.process_time()


def others_drones(more: int) -> float:
    """Processor time of a simulated second of a worker, with so many drones out of its reach."""
    made = many(more)
    sensors = partition(made, 2)[0]
    part = SessionPart(name="0", sensors=sensors, leads=False, began_utc_ns=START_NS)
    clock, begins = InstantClock(START_NS), Begins()
    work = run_over(([], {}), made, clock=clock, duration_s=OTHERS_S, observers=[begins], part=part)
    asyncio.run(work)
    return (time.process_time() - begins.began_s) / OTHERS_S


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


def telemetry_cost(folder: Path, drones: int) -> float:
    """Cores of the worker of one sensor of two that are far apart; most drones are elsewhere."""
    port = free_port()
    sensors = "".join(
        radar_text(name, period_s=1.0, more=f"position_enu_m = [{east_m}, 0.0, 0.0]")
        for name, east_m in (("here", 0.0), ("there", 200_000.0))
    )
    path = scene_file(folder, scene_text(sensors=sensors, drones=""))
    words = ("--workers", "2", "--lease", "10")
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
    gain = table_of(paces())
    found = f"{spread(gain)} times, of a core each"
    print()
    print(aim("plots a second with two workers", f"{SPEEDUP:g} times one", found,
              is_met=statistics.median(gain) >= SPEEDUP))  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        gaps = take_overs(Path(name))
    for what, each in gaps.items():
        print(f"- A worker {what}: nothing of its sensors for {spread(each)} s, {len(each)} times.")
    met = statistics.median(gaps["killed"]) < MOST_SCANS
    found = f"{spread(gaps['killed'])} scans of 1 s, {KILLS} kills"
    print(aim("a dead worker's sensors are taken over", f"under {MOST_SCANS:g} scans", found,
              is_met=met))  # fmt: skip
    print("\n| drones that report elsewhere, 10 Hz | cores of a worker |")
    print("|--:|--:|")
    for drones in TOTALS:
        with tempfile.TemporaryDirectory() as name:
            print(f"| {drones} | {telemetry_cost(Path(name), drones):.3f} |")
    print("\nA worker flies all drones of its scene, also those that are out of reach of all its")
    print(f"sensors, here {RADARS // 2} radars:\n")
    print("| scripted drones out of reach | core of the worker | times none |\n|--:|--:|--:|")
    turns = [[others_drones(more) for more in ELSEWHERE] for _ in range(OTHERS_RUNS)]
    none = [turn[0] for turn in turns]
    for more, each in zip(ELSEWHERE, zip(*turns, strict=True), strict=True):
        print(f"| {more:,} | {spread(each, '.3f')} | {spread(ratios(each, none))} |")


if __name__ == "__main__":
    main()
