"""A fleet on this machine: plots a second by parts, take-overs, and what others' drones cost.

    python tools/benchmarks/bench_fleet.py

Plots a second are of a scene of radars in simulated time, without broker or ledger, by the
processor time of the part that takes most, as if each had a core of its own. Take-overs are of a
fleet in real time over mosquitto, whose process gets SIGKILL or SIGSTOP: from then until the
process that stands by, or is started anew, sends. What a part pays for telemetry is processor time
a second, by how many drones report in all.
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
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aims import aim, cpu_s, ratios, spread, table
from section_4_crowd import place
from support.brokers import free_port, mosquitto
from support.fleets import Fleet, fleet
from support.scene_files import DRONE, scene_file, scene_text
from support.scene_files import radar as radar_text

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.fleet.parts import partition
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.testing import START_NS, flown, radar, rotating, scene

RADARS, DRONES, SIMULATED_S, RUNS = 100, 50, 60.0, 4
SPEEDUP, MOST_TAKE_OVER_S = 1.8, 1.0
KILLS, FREEZES, RESTARTS = 5, 3, 3
SCRIPTED = 2000
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
    how: dict[str, Any] = {"speed_m_s": 20.0, "rcs_m2": 0.5}
    paths = {f"d{i}": ((2000.0 * i, 1500.0), (2000.0 * i + 1500.0, -1500.0)) for i in range(DRONES)}
    paths |= {
        f"e{i}": ((-2e5 - 50.0 * i, -1500.0), (-2e5 - 50.0 * i, 1500.0)) for i in range(elsewhere)
    }
    drones = [
        flown(name, *(place(*at, 300.0) for at in path), **how) for name, path in paths.items()
    ]
    return scene(sensors, drones, seed=1, mqtt={"truth": False})


def of_a_core(parts: int) -> float:
    """Plots a second of as many processes as parts, by the processor time of the busiest."""
    made, plots, most_s = many(), 0, 0.0
    for k, sensors in enumerate(partition(made, parts), 1):
        part = SessionPart(number=k, parts=parts, sensors=sensors, began_utc_ns=START_NS)
        began_s, clock = time.process_time(), InstantClock(START_NS)
        work = run_over(([], {}), made, clock=clock, duration_s=SIMULATED_S, part=part)
        with undisturbed(GARBAGE_OF_SESSION):
            plots += asyncio.run(work).plots
        most_s = max(most_s, time.process_time() - began_s)
    return plots / most_s


class Begins(Observer):
    """Notes when drones fly and sensors are at work."""

    began_s = 0.0

    def begun(self, session: RunningSession) -> None:
        del session
        self.began_s = time.process_time()


def others_drones(more: int) -> float:
    """Processor time of a simulated second of a part, with so many drones out of its reach."""
    made = many(more)
    sensors = partition(made, 2)[0]
    part = SessionPart(number=1, parts=2, sensors=sensors, began_utc_ns=START_NS)
    clock, begins = InstantClock(START_NS), Begins()
    work = run_over(([], {}), made, clock=clock, duration_s=OTHERS_S, observers=[begins], part=part)
    asyncio.run(work)
    return (time.process_time() - begins.began_s) / OTHERS_S


def take_overs(folder: Path, drones: int, what: str, times: int, spares: int) -> list[float]:
    """Seconds from a fault of a process until another sends."""
    port = free_port()
    sensors = "".join(
        radar_text(f"r{i}", period_s=1.0, more=f"position_enu_m = [{300.0 * i}, 0.0, 0.0]")
        for i in range(10)
    )
    scripted = "".join(
        f'[[drone]]\nid = "e{i}"\nrcs_m2 = 0.5\nspeed_m_s = 20.0\nrepeat = true\npath = ['
        f"{{ east_m = {-2e5 - 50.0 * i}, north_m = -1500.0, above_site_m = 300.0 }}, "
        f"{{ east_m = {-2e5 - 50.0 * i}, north_m = 1500.0, above_site_m = 300.0 }}]\n"
        for i in range(drones)
    )
    path = scene_file(folder, scene_text(sensors=sensors, drones=DRONE + scripted))
    words = ("--workers", "2", "--spares", str(spares))
    with mosquitto(folder, port), fleet(path, port, *words) as at_work:
        at_work.wait(lambda: at_work.sends(2), "it never began")
        found = []
        for number in range(times):
            at_work.wait(
                lambda ready=spares * (2 + number): at_work.errors().count("stands by") >= ready,
                "none stands by",
            )
            time.sleep(3.0)
            found.append(fault_s(at_work, what))
        return found


def fault_s(at_work: Fleet, what: str) -> float:
    """One fault of a process: how long until another sends its part."""
    pid = at_work.pid(1)
    began_s = time.monotonic()
    os.kill(pid, signal.SIGKILL if what == "killed" else signal.SIGSTOP)
    at_work.wait(lambda: at_work.pid(1) != pid and at_work.sends(2), "nobody took over")
    since, took_s = len(at_work.client.heard), time.monotonic() - began_s
    at_work.wait(
        lambda: any(
            m.topic.startswith("plotfeed/r0/asterix") for m in at_work.client.heard[since:]
        ),
        "it sends nothing",
    )
    if what == "frozen":
        os.kill(pid, signal.SIGCONT)
    return took_s


def telemetry_cost(folder: Path, drones: int) -> float:
    """Cores of the part of one sensor of two that are far apart; most drones are elsewhere."""
    port = free_port()
    sensors = "".join(
        radar_text(name, period_s=1.0, more=f"position_enu_m = [{east_m}, 0.0, 0.0]")
        for name, east_m in (("here", 0.0), ("there", 200_000.0))
    )
    path = scene_file(folder, scene_text(sensors=sensors, drones=""))
    with mosquitto(folder, port), fleet(path, port, "--workers", "2") as at_work:
        at_work.wait(lambda: at_work.sends(2), "it never began")
        elsewhere = str(Path(__file__).with_name("bench_scaling.py"))
        flying = subprocess.Popen([sys.executable, elsewhere, "fly", str(port), str(drones)])
        try:
            time.sleep(4.0)
            parts = {told["sensors"][0]: k for k, told in at_work.statuses().items()}
            pid = at_work.pid(parts["there"])  # all of them fly about the other
            before, since = cpu_s(pid), time.monotonic()
            time.sleep(WINDOW_S)
            return (cpu_s(pid) - before) / (time.monotonic() - since)
        finally:
            flying.kill()
            flying.wait()


def main() -> None:
    """Prints what the page says."""
    keep_freed()
    paces = {parts: [0.0] * RUNS for parts in (1, 2)}
    for turn in range(RUNS):
        for parts, each in paces.items():
            each[turn] = of_a_core(parts)
    gain = ratios(paces[2], paces[1])
    print(f"Median (least to most) of {RUNS} turns, {SIMULATED_S:g} s of {RADARS} radars and")
    print(f"{DRONES} drones each, a core for each part.\n")
    table(
        ("parts", "plots a second", "times one"),
        ((n, spread(each, ",.0f"), spread(ratios(each, paces[1]))) for n, each in paces.items()),
        0,
    )
    print()
    print(aim("plots a second of two parts", f"{SPEEDUP:g} times one", f"{spread(gain)} times",
              is_met=statistics.median(gain) >= SPEEDUP))  # fmt: skip
    print(f"\nTake-overs, with {SCRIPTED:,} scripted drones out of reach:\n")
    found = {}

    def rows() -> Iterator[tuple[object, ...]]:
        for what, times, spares in (("killed", KILLS, 1), ("frozen", FREEZES, 1),
                                    ("killed", RESTARTS, 0)):  # fmt: skip
            with tempfile.TemporaryDirectory() as name:
                found[what, spares] = take_overs(Path(name), SCRIPTED, what, times, spares)
            stands_by = "yes" if spares else "no, it is started anew"
            yield what, stands_by, spread(found[what, spares]), times

    head = ("a process is", "another stands by", "seconds until another sends", "times")
    table(head, rows(), 2)
    took_s = found["killed", 1]
    print()
    is_met = statistics.median(took_s) <= MOST_TAKE_OVER_S
    took, most = f"{spread(took_s)} s", f"{MOST_TAKE_OVER_S:g} s"
    print(aim("take-over of a killed process's part", most, took, is_met=is_met))
    print()
    costs = []
    for drones in TOTALS:
        with tempfile.TemporaryDirectory() as name:
            costs.append((drones, f"{telemetry_cost(Path(name), drones):.3f}"))
    table(("drones that report elsewhere, 10 Hz", "cores of a part"), costs, 0)
    print("\nA part flies all drones of its scene, also those that are out of reach of all its")
    print(f"sensors, here {RADARS // 2} radars:\n")
    turns = [[others_drones(more) for more in ELSEWHERE] for _ in range(OTHERS_RUNS)]
    none, *_ = columns = [*zip(*turns, strict=True)]
    table(
        ("scripted drones out of reach", "core of the part", "times none"),
        (
            (f"{more:,}", spread(each, ".3f"), spread(ratios(each, none)))
            for more, each in zip(ELSEWHERE, columns, strict=True)
        ),
        0,
    )


if __name__ == "__main__":
    main()
