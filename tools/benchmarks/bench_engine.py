"""The engine under load: rotating radars, a broker and a subscriber.

    python tools/benchmarks/bench_engine.py [SECONDS] [PLOTFEED]

The radars turn once a second in 32 sectors each and report in categories 048 and 034, all in step:
all their sectors end every 31 ms at the same instant. The broker, and a subscriber that counts what
arrives, share the machine, and clock_nanosleep from C runs beside them. PLOTFEED is the command of
another revision, to be set beside this one in turns.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from aims import aim, cpu_s, spread, table
from beside import Arrivals, nanosleep_late_us
from demo_process import COMMAND
from support.brokers import free_port, mosquitto, own_broker, wait_until_listening
from support.tools import place_of

from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.testing import MqttReceiver, flown, radar, rotating, waypoint

SECONDS, RUNS = 12.0, 3
SECTORS, DRONES = 32, 50
NS = 1_000_000_000
SETTLED_S, AIM_MS = 2.0, 5.0


class Case(NamedTuple):
    """So many radars in step, with the embedded broker or mosquitto, with the ledger or without."""

    radars: int
    embedded: bool = False
    truth: bool = True


# The last is more than a machine can do.
CASES = (
    *(Case(200, embedded=True), Case(500, embedded=True), Case(200), Case(200, truth=False)),
    *(Case(500), Case(1000), Case(2500)),
)


def drones(number: int) -> list[dict[str, Any]]:
    """Drones that fly to and fro within 9 km."""
    rng = np.random.default_rng(1)

    def place() -> dict[str, float]:
        return waypoint(rng.uniform(0, 360), 1.0, rng.uniform(1000, 9000))

    return [flown(f"d{i}", place(), place()) for i in range(number)]


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


def scene_text(sensors: list[dict[str, Any]], number: int, **more: Any) -> str:
    """A scene with so many drones, as a file has it."""
    site = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    general = {"name": "load", "seed": 1, "site": site}
    return toml_of({"scene": general, "sensor": sensors, "drone": drones(number), **more})


@dataclass(frozen=True, slots=True)
class Loaded:
    """What a session under load said of itself, and what was seen of it."""

    broker: str
    totals: dict[str, Any]
    arrived: int
    cores: float  # From when it had settled until shortly before its end
    machine_p99_ms: float  # How late C woke in the same seconds; NaN without a compiler


def loaded(seconds: float, case: Case, command: Path) -> Loaded:
    """A session in a process of its own, with C beside it."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, options, keys = Path(name), list[str](), dict[str, Any](truth=case.truth)
        if case.embedded:
            broker, port = "embedded", free_port()
            keys["port"] = port
        else:
            broker, port = stack.enter_context(a_broker(folder))
            options = ["--broker", f"mqtt://127.0.0.1:{port}"]
        scene = folder / "load.toml"
        scene.write_text(scene_text(radars(case.radars), DRONES, mqtt=keys))
        settled_s = SETTLED_S + case.radars / 250
        options += ["--duration", str(settled_s + seconds + 1), "--json"]
        if not case.embedded:
            arrivals = Arrivals(port)
        process = subprocess.Popen(
            [command, "run", scene, *options], stdout=subprocess.PIPE, text=True
        )
        if case.embedded:
            wait_until_listening(port)
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
    machine_ms = math.nan if beside is None else float(np.percentile(beside, 99)) / 1e3
    return Loaded(broker, json.loads(out.splitlines()[-1]), arrived, cores, machine_ms)


C = "C beside it, p99, ms"
FIGURES: dict[str, tuple[str, Callable[[Loaded], float]]] = {
    "messages": (",.0f", lambda x: x.totals["messages"]),
    "arrived": (",.0f", lambda x: x.arrived),
    "lateness p50, ms": (".2f", lambda x: x.totals["lateness_p50_us"] / 1e3),
    "p99, ms": (".2f", lambda x: x.totals["lateness_p99_us"] / 1e3),
    C: (".2f", lambda x: x.machine_p99_ms),
    "scans missed": (",.0f", lambda x: x.totals["missed_scans"]),
    "cores": (".2f", lambda x: x.cores),
}


def by_load(seconds: float, other: Path | None) -> dict[Case, list[Loaded]]:
    """Prints what each case came to, beside another revision's; gives those of this one."""
    print(
        f"Radars of {SECTORS} sectors at 1 Hz, {DRONES} drones and a subscriber, on the same\n"
        f"{os.cpu_count()} cores: median (least to most) of {RUNS} runs of {seconds:g} s each in\n"
        "turns. C calls clock_nanosleep. Lateness is of the last 100,000 messages; scans missed\n"
        "are those of the whole session.\n"
    )
    commands = {"this": COMMAND} | ({} if other is None else {"other": other})
    found: dict[Case, list[Loaded]] = {}

    def rows() -> Iterator[list[str]]:
        for case in CASES:
            runs: dict[str, list[Loaded]] = {name: [] for name in commands}
            for _ in range(RUNS):
                for name, command in commands.items():
                    runs[name].append(loaded(seconds, case, command))
            found[case] = runs["this"]
            for name, each in runs.items():
                words = f"{case.radars:,}", each[0].broker, "yes" if case.truth else "no", name
                yield [*words, *(spread(map(of, each), form) for form, of in FIGURES.values())]

    table(["radars", "broker", "ledger", "revision", *FIGURES], rows(), 4)
    return found


def main() -> None:
    """Prints tables."""
    seconds = float(sys.argv[1]) if sys.argv[1:] else SECONDS
    found = by_load(seconds, Path(sys.argv[2]) if sys.argv[2:] else None)
    print()
    for truth, name, limit in ((True, "with the ledger", 0.6), (False, "without", 0.4)):
        runs = found[Case(200, truth=truth)]
        cores = [each.cores for each in runs]
        print(aim(name, f"{limit} cores", spread(cores), is_met=bool(np.median(cores) <= limit)))
        late_ms, c_ms = ([of(each) for each in runs] for _, of in (FIGURES["p99, ms"], FIGURES[C]))
        limit_ms = max(AIM_MS, 2 * np.median(c_ms))
        words = f"p99 of lateness {AIM_MS:g} ms, or twice C's where that is more"
        is_met = bool(np.median(late_ms) <= limit_ms)
        print(aim(name, words, f"{spread(late_ms)} ms", is_met=is_met))


if __name__ == "__main__":
    main()
