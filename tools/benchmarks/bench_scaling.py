"""What a session costs in real time by how much there is: cores, memory, and where the time goes.

    python tools/benchmarks/bench_scaling.py

Each point is a session in a process of its own, with the ledger, over a broker beside it (mosquitto
where it is installed) and with nobody who listens. What it costs is looked at second after second
once it has begun. Where drones grow, they report in JSON, ten times a second each, through the
broker; elsewhere the scene flies them. Points are few and short: a bend is seen, a tenth is not.
"""

from __future__ import annotations

import asyncio
import json
import math
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from aims import YARDSTICK, ratios, spread, yardstick_us
from bench_engine import a_broker, drones, radars

from plotfeed.feeds.console.process import (
    GARBAGE_OF_SESSION,
    keep_freed,
    leave_alone_what_is_there,
    undisturbed,
)
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto.utc import iso_utc
from plotfeed.testing import MqttReceiver, radar, scene, staring

PICTURE = Path(__file__).parents[2] / "docs" / "scaling.png"
# Seconds before the first look, and how many of a second each follow; in so many processes.
SETTLED_S, WINDOWS, RUNS = 1.5, 3, 3
TELEMETRY_HZ, TELEMETRY_RADARS, SOME_DRONES = 10, 20, 50
MIB = 2**20
# What grows, and through which numbers: with 50 drones, and drones before 20 radars.
SERIES: dict[str, tuple[int, ...]] = {
    "radars, in step": (1, 10, 50, 200),
    "radars, spread": (1, 10, 50, 200),
    "drones at 10 Hz": (1, 10, 100, 1000),
    "staring sensors": (1, 20, 200, 2000),
    "one radar, one drone": (1,),
}
PROFILED = {
    "one radar, one drone": 1,
    "radars, in step": 200,
    "drones at 10 Hz": 1000,
    "staring sensors": 2000,
}
# A session that takes as much can do no more: what else it says is of a session that is late.
FULL_CORES = 0.95


# Where the processor time of a session goes: what runs when so much of it has passed.
EVERY_S = 0.002  # Linux may make it 4 ms
# What a piece of a file's path says; the innermost call that is of any of these counts.
ROOMS = {
    "feeds/engine": "sensing",
    "feeds/formats": "formats",
    "feeds/link": "link",
    "feeds/transport": "transport",
    "feeds/telemetry": "telemetry",
    "feeds/engine/intake.py": "telemetry",
}
# The rest is the loop with its clock and schedule. Physics is sensing, octets are formats.
NAMES = ("sensing", "formats", "link", "transport", "telemetry", "ledger", "the rest")


def room_of(frame: FrameType | None) -> str:
    """Whose work a call is; the ledger's wherever a function or file of that name is at work."""
    found = ""
    while frame is not None:
        code = frame.f_code
        if "ledger" in code.co_name or "ledger" in Path(code.co_filename).stem:
            return "ledger"
        if not found:
            found = next((room for part, room in ROOMS.items() if part in code.co_filename), "")
        frame = frame.f_back
    return found or "the rest"


@contextmanager
def sampled_rooms() -> Iterator[Counter[str]]:
    """Counts meanwhile what this process's main thread works at, by its processor time."""
    counts: Counter[str] = Counter()

    def look(_signal: int, frame: FrameType | None) -> None:
        counts[room_of(frame)] += 1

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, EVERY_S, EVERY_S)
    try:
        yield counts
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def scene_of(series: str, n: int) -> Scene:
    """The scene of a point."""
    if series == "drones at 10 Hz":
        return scene(radars(TELEMETRY_RADARS), drones(0), seed=1)
    if series == "one radar, one drone":
        return scene(radars(1), drones(1), seed=1)
    if series == "staring sensors":
        side = math.ceil(n**0.5)
        sensors = [
            radar(
                id=f"s{i}",
                scan=staring(),
                report=["asterix-048"],
                pfa=1e-8,
                position_enu_m=[6000.0 * (i % side) / side, 6000.0 * (i // side) / side, 0.0],
            )
            for i in range(n)
        ]
        return scene(sensors, drones(SOME_DRONES), seed=1)
    sensors = radars(n)
    if series == "radars, spread":
        for i, sensor in enumerate(sensors):  # their turns begin at multiples of their periods
            sensor["scan"] = {**sensor["scan"], "period_s": 1.0 + 1e-4 * i}
    return scene(sensors, drones(SOME_DRONES), seed=1)


class Meter(Observer):
    """Processor time of each second, once the session has begun and settled."""

    def __init__(self, stack: ExitStack) -> None:
        self.spent_s: list[float] = []
        self.at_s: list[float] = []
        self.rooms: Counter[str] = Counter()
        self._stack = stack

    def begun(self, _session: RunningSession) -> None:
        loop = asyncio.get_running_loop()
        for i in range(WINDOWS + 1):
            loop.call_later(SETTLED_S + i, self._look, i)

    def _look(self, i: int) -> None:
        self.spent_s.append(time.process_time())
        self.at_s.append(time.monotonic())
        if i == 0:
            self.rooms = self._stack.enter_context(sampled_rooms())

    def cores(self) -> list[float]:
        """Processor time by time, window after window."""
        spent = zip(self.spent_s, self.spent_s[1:], strict=False)
        passed = zip(self.at_s, self.at_s[1:], strict=False)
        return [(b - a) / (d - c) for (a, b), (c, d) in zip(spent, passed, strict=True)]


def point(series: str, n: int) -> dict[str, Any]:
    """One of the points, in this process."""
    keep_freed()
    made = scene_of(series, n)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        _, port = stack.enter_context(a_broker(folder))
        if series == "drones at 10 Hz":
            fleet = subprocess.Popen([sys.executable, __file__, "fly", str(port), str(n)])
            stack.callback(fleet.wait)
            stack.callback(fleet.kill)
            with MqttReceiver(port, 5, "plotfeed/telemetry/+") as ears:
                ears.wait_for(lambda _: True)  # the session is to have them from its beginning
        profile = stack.enter_context(ExitStack())
        meter = Meter(profile)
        stack.enter_context(undisturbed(GARBAGE_OF_SESSION))
        totals = asyncio.run(
            run(
                made,
                clock=WallClock(),
                broker=f"mqtt://127.0.0.1:{port}",
                duration_s=SETTLED_S + WINDOWS + 0.5,
                observers=[meter],
                on_ready=lambda *_: leave_alone_what_is_there(),
            )
        )
    return {
        "cores": meter.cores(),
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MIB,
        "yardstick": yardstick_us(),
        "rooms": meter.rooms,
        "missed": totals.missed_scans,
        "telemetry": totals.telemetry,
    }


def fly(port: int, n: int) -> None:
    """Report drones that go in circles, all of them ten times a second, until somebody ends it."""
    client, period_s = MqttReceiver(port, 5), 1 / TELEMETRY_HZ
    places = [(40.45 + 0.0003 * (i % 200), 0.001 + 0.0003 * (i // 200)) for i in range(n)]
    next_s = time.monotonic()
    while True:
        t_ns = time.time_ns()
        east_deg = 0.02 * math.sin(t_ns / 2e10)
        head = (
            f'{{"time_utc":"{iso_utc(t_ns)}","altitude_m":900.0,"altitude_reference":"ELLIPSOID",'
        )
        client.publish_all(
            (f"plotfeed/telemetry/d{i}",
             f'{head}"latitude_deg":{latitude:.7f},"longitude_deg":{-3.73 + east_deg + more:.7f}}}'
             .encode())
            for i, (latitude, more) in enumerate(places)
        )  # fmt: skip
        next_s = max(next_s + period_s, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))


def runs_of(series: str, n: int) -> dict[str, Any]:
    """Of some processes: of each the median of its cores, and what all saw."""
    runs = [in_a_process(series, n) for _ in range(RUNS)]
    return {
        "cores": [statistics.median(run["cores"]) for run in runs],
        "yardsticks": [run["yardstick"] / 1e6 for run in runs],
        "mib": max(run["mib"] for run in runs),
        "rooms": sum((Counter(run["rooms"]) for run in runs), Counter()),
        "missed": sum(run["missed"] for run in runs),
    }


def in_a_process(series: str, n: int) -> dict[str, Any]:
    """The same in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "point", series, str(n)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return dict(json.loads(done.stdout))


def table(found: dict[str, list[tuple[int, dict[str, Any]]]]) -> Iterator[str]:
    """A line for each point."""
    yield "| what | how many | cores | yardsticks a second | MiB | scans missed |"
    yield "|---|--:|--:|--:|--:|--:|"
    for series, points in found.items():
        for n, seen in points:
            cores, missed = seen["cores"], seen["missed"]
            told = f"{spread(cores, '.3f')} | {spread(ratios(cores, seen['yardsticks']), '.1f')}"
            yield f"| {series} | {n:,} | {told} | {seen['mib']:.0f} | {missed:,} |"


def shares(found: dict[str, list[tuple[int, dict[str, Any]]]]) -> Iterator[str]:
    """Where the time goes."""
    yield f"| | {' | '.join(NAMES)} |"
    yield "|---|" + "--:|" * len(NAMES)
    for series, n in PROFILED.items():
        rooms = dict(found[series])[n]["rooms"]
        total = sum(rooms.values()) or 1
        cells = " | ".join(f"{100 * rooms.get(name, 0) / total:.0f}" for name in NAMES)
        yield f"| {series}, {n:,} | {cells} |"


def draw(found: dict[str, list[tuple[int, dict[str, Any]]]]) -> None:
    """Cores above, memory below; on log axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(9, 8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    for i, (series, points) in enumerate(found.items()):
        n = [count for count, _ in points]
        cores = [statistics.median(seen["cores"]) for _, seen in points]
        above.plot(n, cores, "o-", ms=5, lw=1, color=f"C{i}", label=series)
        below.plot(n, [seen["mib"] for _, seen in points], "o-", ms=5, lw=1, color=f"C{i}")
    above.axhline(1.0, color="#9aa5ab", ls=":", lw=1)
    for panel in (above, below):
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.grid(visible=True, which="major", alpha=0.3)
    above.legend(fontsize=9)
    above.set_ylabel("cores")
    below.set_ylabel("MiB, the largest size")
    below.set_xlabel("how many")
    figure.savefig(PICTURE, metadata={"Software": None})


def main() -> None:
    """Prints tables and draws the picture."""
    found = {series: [(n, runs_of(series, n)) for n in sizes] for series, sizes in SERIES.items()}
    print(
        f"Cores of the session alone: median (least to most) of {RUNS} processes, of each that of "
        f"{WINDOWS} s\nin real time. {YARDSTICK}\nMemory is the largest size that a process had. "
        f"{SOME_DRONES} drones where sensors grow, {TELEMETRY_RADARS}\nradars where drones do. Who "
        f"takes more than {FULL_CORES} cores is late, and says nothing of what more would\ncost.\n"
    )
    print("\n".join(table(found)))
    print("\n![Cores and memory against how much there is](scaling.png)\n")
    print("Where the time goes, % of the session's, by what runs every few milliseconds of it:\n")
    print("\n".join(shares(found)))
    draw(found)


if __name__ == "__main__":
    if sys.argv[1:2] == ["point"]:
        print(json.dumps(point(sys.argv[2], int(sys.argv[3]))))
    elif sys.argv[1:2] == ["fly"]:
        fly(int(sys.argv[2]), int(sys.argv[3]))
    else:
        main()
