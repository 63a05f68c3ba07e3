"""The engine under load: rotating radars and a broker, the bare scheduler, and plots a second.

    python tools/benchmarks/bench_engine.py [SECONDS] [PLOTFEED]

The radars turn once a second in 32 sectors each and report in categories 048 and 034, all in step:
all their sectors end every 31 ms at the same instant. The broker, and a subscriber that counts what
arrives, share the machine, and clock_nanosleep from C runs beside them. The scheduler is set beside
that in turns. PLOTFEED is the command of another revision, to be set beside this one in turns.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from aims import YARDSTICK, aim, cpu_s, ratios, spread, yardstick_us
from demo_process import COMMAND
from support.arrivals import Arrivals
from support.brokers import free_port, mosquitto, own_broker
from support.nanosleep import nanosleep_late_us
from support.tools import place_of
from support.waiting import wait_until

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.session.loop import SessionLoop
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import Session, run
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.feeds.timing.clock import InstantClock, Schedule, WallClock
from plotfeed.testing import MqttReceiver, flown, radar, rotating, staring, waypoint

SECONDS, RUNS = 12.0, 3
RADARS, SECTORS, DRONES = 200, 32, 50
# Radars, and whether the broker is the embedded one; the last is more than a machine can do.
LOADS = ((200, True), (500, True), (200, False), (500, False), (1000, False), (2500, False))
NS = 1_000_000_000
PERCENTILES = (50, 99, 99.9)
AIM_DRONES, AIM_PLOTS = 1000, 300_000
SETTLED_S, AIM_MS, AIMS_CORES = 2.0, 5.0, (0.6, 0.4)


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


@contextmanager
def a_broker(folder: Path) -> Iterator[tuple[str, int]]:
    """Mosquitto where it is installed, else own_broker."""
    port = free_port()
    if place_of("mosquitto"):
        with mosquitto(folder, port):
            yield "mosquitto", port
    else:
        with own_broker(folder, port):
            yield "own_broker", port


def scene_text(sensors: list[dict[str, Any]], drones: int, **more: Any) -> str:
    """A scene as a file has it."""
    tree = scene_tree(sensors, drones, **more)
    return toml_of(tree)


@dataclass(frozen=True, slots=True)
class Loaded:
    """What a session under load said of itself, and what was seen of it."""

    broker: str
    totals: dict[str, Any]
    arrived: int
    cores: float  # From when it had settled until shortly before its end
    # How late C woke in the same seconds, p50, p99 and p99.9; None without a compiler.
    machine_ms: Any


def loaded(
    seconds: float,
    *,
    radar_count: int = RADARS,
    truth: bool = True,
    embedded: bool = False,
    command: Path = COMMAND,
) -> Loaded:
    """A session in a process of its own, with C beside it."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, options, keys = Path(name), list[str](), dict[str, Any](truth=truth)
        if embedded:
            broker, port = "embedded", free_port()
            keys["port"] = port
        else:
            broker, port = stack.enter_context(a_broker(folder))
            options = ["--broker", f"mqtt://127.0.0.1:{port}"]
        scene = folder / "load.toml"
        scene.write_text(scene_text(radars(radar_count), DRONES, mqtt=keys))
        settled_s = SETTLED_S + radar_count / 250
        options += ["--duration", str(settled_s + seconds + 1), "--json"]
        if not embedded:
            arrivals = Arrivals(port)
        process = subprocess.Popen(
            [command, "run", scene, *options], stdout=subprocess.PIPE, text=True
        )
        if embedded:
            wait_until(lambda: is_open(port), "no broker listens")
            arrivals = Arrivals(port)
        with MqttReceiver(port, 5, "plotfeed/session") as ears:
            ears.wait_for(lambda _: True)  # that it has begun
        time.sleep(settled_s)
        before_s, began_s = cpu_s(process.pid), time.monotonic()
        beside = nanosleep_late_us(round(seconds * 100), NS // 100)
        time.sleep(max(0.0, began_s + seconds - time.monotonic()))
        cores = (cpu_s(process.pid) - before_s) / (time.monotonic() - began_s)
        out, _ = process.communicate()
        arrived = arrivals.count()
    machine_ms = None if beside is None else np.percentile(beside, PERCENTILES) / 1e3
    return Loaded(broker, json.loads(out.splitlines()[-1]), arrived, cores, machine_ms)


def is_open(port: int) -> bool:
    """Whether somebody listens there."""
    with socket.socket() as ours:
        return ours.connect_ex(("127.0.0.1", port)) == 0


def by_load(seconds: float, other: Path | None) -> None:
    """How many radars one process can do, with either broker, beside another revision's."""
    commands = {"this": COMMAND} | ({} if other is None else {"other": other})
    print(
        f"\nRadars of {SECTORS} sectors at 1 Hz, {DRONES} drones, the ledger, a subscriber,\n"
        f"as above: median (least to most) of {RUNS} runs of {seconds:g} s each in turns. Scans\n"
        "missed are those of the whole session.\n"
    )
    print(
        "| radars | broker | revision | messages | lateness p50, ms | p99, ms "
        "| C beside it, p99, ms | scans missed | cores |\n|--:|---|---|--:|--:|--:|--:|--:|--:|"
    )
    for radar_count, embedded in LOADS:
        runs: dict[str, list[Loaded]] = {name: [] for name in commands}
        for _ in range(RUNS):
            for name, command in commands.items():
                found = loaded(seconds, radar_count=radar_count, embedded=embedded, command=command)
                runs[name].append(found)
        for name, each in runs.items():
            cells = [
                spread([x.totals["messages"] for x in each], ",.0f"),
                *(
                    spread([x.totals[f"lateness_{p}_us"] / 1e3 for x in each])
                    for p in ("p50", "p99")
                ),
                spread([x.machine_ms[1] for x in each]),
                spread([x.totals["missed_scans"] for x in each], ",.0f"),
                spread([x.cores for x in each]),
            ]
            print(
                f"| {radar_count:,} | {each[0].broker} | {name} | {' | '.join(cells)} |", flush=True
            )


def under_load(seconds: float) -> None:
    """With the ledger and without it in turns, and C alone before each of them."""
    alone: dict[bool, list[Any]] = {True: [], False: []}
    runs: dict[bool, list[Loaded]] = {True: [], False: []}
    for _ in range(RUNS):
        for truth in (True, False):
            found = nanosleep_late_us(500, NS // 100)
            if found is not None:
                alone[truth].append(np.percentile(found, PERCENTILES) / 1e3)
            runs[truth].append(loaded(seconds, truth=truth))
    print(
        f"{RADARS} radars of {SECTORS} sectors at 1 Hz, {DRONES} drones, {runs[True][0].broker} "
        f"and a subscriber on the same {os.cpu_count()} cores: median (least to most) of {RUNS} "
        f"runs of {seconds:g} s each in turns.\n"
    )
    print("| | with the ledger | without |\n|---|--:|--:|")

    def row(what: str, of: Callable[[Loaded], float], form: str = ",.0f") -> None:
        cells = (spread(map(of, each), form) for each in runs.values())
        print(f"| {what} | {' | '.join(cells)} |")

    row("messages sent by sensors", lambda x: x.totals["messages"])
    row("of these arrived", lambda x: x.arrived)
    row("undelivered", lambda x: x.totals["undelivered"])
    row("scans missed", lambda x: x.totals["missed_scans"])
    for name, key in (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999")):
        row(f"lateness {name}, ms", lambda x, k=key: x.totals[f"lateness_{k}_us"] / 1e3, ".2f")
    if alone[True]:
        for i, name in enumerate(("p50", "p99", "p99.9")):
            row(f"C beside it, {name}, ms", lambda x, i=i: x.machine_ms[i], ".2f")
        row("lateness p99, times that of C beside it", _beside_c, ".1f")
        cells = (spread([found[1] for found in each]) for each in alone.values())
        print(f"| C before it, with nothing beside it, p99, ms | {' | '.join(cells)} |")
    row("processor, cores", lambda x: x.cores, ".2f")
    print("\nC calls clock_nanosleep. Lateness is of the last 100,000 messages.\n")
    for truth, name, limit in zip(runs, ("with the ledger", "without"), AIMS_CORES, strict=True):
        cores = [each.cores for each in runs[truth]]
        is_met = bool(np.median(cores) <= limit)
        print(aim(name, f"{limit} cores", spread(cores), is_met=is_met))
        if alone[True]:
            late_ms = [each.totals["lateness_p99_us"] / 1e3 for each in runs[truth]]
            limit_ms = max(AIM_MS, 2 * np.median([each.machine_ms[1] for each in runs[truth]]))
            words = f"p99 of lateness {AIM_MS:g} ms, or twice C's where that is more"
            is_met = bool(np.median(late_ms) <= limit_ms)
            print(aim(name, words, f"{spread(late_ms)} ms", is_met=is_met))


def _beside_c(found: Loaded) -> float:
    return float(found.totals["lateness_p99_us"] / 1e3 / found.machine_ms[1])


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
        on_input=lambda: None,
        drain=lambda: asyncio.sleep(0),
        write_later=lambda _: None,
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
    """In turns, medians of five."""
    step_ns = NS // (RADARS * SECTORS)
    deadlines = round(seconds * NS) // step_ns // 5
    ours, theirs, shares = [], [], []
    for _ in range(5):
        found = nanosleep_late_us(deadlines, step_ns)
        if found is not None:
            theirs.append(np.percentile(found, PERCENTILES))
        spent_s, began_s = time.process_time(), time.monotonic()
        ours.append(scheduler_us(deadlines, step_ns))
        shares.append((time.process_time() - spent_s) / (time.monotonic() - began_s))
    print(
        f"\n{NS // step_ns:,} deadlines a second, lateness in µs, medians of five runs in turns:\n"
    )
    print("| | p50 | p99 | p99.9 |\n|---|--:|--:|--:|")
    rows = [("engine", np.median(ours, axis=0))]
    if theirs:
        rows.append(("clock_nanosleep in C, timer slack 1 ns", np.median(theirs, axis=0)))
    for name, row in rows:
        print(f"| {name} | " + " | ".join(f"{x:.0f}" for x in row) + " |")
    if theirs:
        each = [ratios(a, b) for a, b in zip(np.array(ours).T, np.array(theirs).T, strict=True)]
        print("| ratio, by turns | " + " | ".join(map(spread, each)) + " |\n")
        for name, ratio in zip(("p50", "p99"), each, strict=False):
            is_met = np.median(ratio) <= 2
            print(aim("the engine beside C", f"2 times its {name}", spread(ratio), is_met=is_met))
    print(f"\nThe engine took {np.median(shares):.2f} cores for it.")


def plots_a_second() -> None:
    """As fast as possible, in memory: models, encoding, links and account, without a broker."""
    print("\nPlots of one process, a second and a yardstick: median (least to most) of "
          f"{RUNS} runs.\n{YARDSTICK}\n")  # fmt: skip
    print("| drones seen by one radar | with the ledger | a yardstick | without | a yardstick |")
    print("|--:|--:|--:|--:|--:|")
    for drones in (100, 1000, 5000):
        sensor = radar(scan=staring(), report=["asterix-048"], pfa=1e-8, power_w=5e6)
        cells = []
        for truth in (True, False):
            tree = scene_tree([sensor], drones, mqtt={"truth": truth})
            tree["scene"]["start_utc"] = datetime(2026, 1, 1, tzinfo=UTC)
            found = rates(from_tree(tree, Path("load.toml")), 50_000 // drones)
            yardsticks_s = [yardstick_us() / 1e6 for _ in found]
            each = [plots * s for plots, s in zip(found, yardsticks_s, strict=True)]
            cells += [spread(found, ",.0f"), spread(each, ",.0f")]
            if truth and drones == AIM_DRONES:
                reached = np.median(found)
        print(f"| {drones:,} | {' | '.join(cells)} |")
    what = f"with the ledger at {AIM_DRONES:,} drones"
    found = f"{reached:,.0f}"
    print("\n" + aim(what, f"{AIM_PLOTS:,} plots a second", found, is_met=reached >= AIM_PLOTS))


def rates(scene: Scene, scans: int) -> list[float]:
    """Plots a second of processor time, of some runs."""

    def once() -> float:
        at_work, clock = AtWork(), InstantClock(scene.scene.start_utc_ns)
        observers = [at_work]
        totals = asyncio.run(
            run(scene, clock=clock, broker="none", duration_s=float(scans), observers=observers)
        )
        return totals.plots / at_work.took_s

    return [once() for _ in range(RUNS)]


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
    by_load(seconds, Path(sys.argv[2]) if sys.argv[2:] else None)
    beside_nanosleep(seconds)
    keep_freed()
    with undisturbed(GARBAGE_OF_SESSION):
        plots_a_second()


if __name__ == "__main__":
    main()
