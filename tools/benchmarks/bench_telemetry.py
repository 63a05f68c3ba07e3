"""Telemetry taken in: processor time a message, and a drone at 10 Hz beside a flood.

    python tools/benchmarks/bench_telemetry.py [SECONDS]

Messages are queued as a transport queues them and taken in by ticks of 10 ms; each tick all drones
are then asked where they are. The flood comes over a broker that shares the machine, from a process
that writes packets made beforehand; 20 radars turn meanwhile.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from aims import YARDSTICK, ratios, spread, yardstick_us
from support.brokers import free_port, mosquitto
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.intake import Intake
from plotfeed.feeds.link.counters import SessionCounters, lateness_us
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import Session, run
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY, PositionReport
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.models.state import AltitudeReference
from plotfeed.models.truth import Trajectories
from plotfeed.testing import MqttReceiver

NS = 1_000_000_000
TICK_NS = 10_000_000
START_NS = 1_767_268_800 * NS
SECONDS, RUNS = 5.0, 3


def report(t_utc_ns: int, number: int, *, with_velocity: bool) -> PositionReport:
    """Of a drone that flies on."""
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=40.45 + 1e-4 * (number % 101) + 1e-9 * (t_utc_ns % NS) / NS,
        longitude_deg=-3.73 + 1e-4 * (number // 101 % 101),
        altitude_m=900.0,
        altitude_reference=AltitudeReference.ELLIPSOID,
        velocity_enu_m_s=(5.0, -2.0, 0.5) if with_velocity else UNKNOWN_VELOCITY,
        horizontal_accuracy_m=1.0,
    )


def intake_of(scene: Scene) -> tuple[Intake, Trajectories]:
    """What takes telemetry in, with nobody to follow it."""
    engine = Engine(scene, START_NS)
    return Intake(engine, SessionCounters(), lambda _: None), engine.trajectories


Ticks = list[list[tuple[str, bytes]]]


def ticks(drones: int, rate_hz: float, seconds: float, *, kind: str, with_velocity: bool) -> Ticks:
    """Messages of so many drones by tick, the drones spread over their period."""
    encode = PositionReport.to_json if kind == "JSON" else PositionReport.to_protobuf
    period_ns, made = round(NS / rate_hz), list[list[tuple[str, bytes]]]()
    for tick in range(round(seconds * NS / TICK_NS)):
        first_ns, came = tick * TICK_NS, []
        for number in range(drones):
            phase_ns = number * period_ns // drones
            for k in range(-(-(first_ns - phase_ns) // period_ns), 1 << 62):
                t_ns = k * period_ns + phase_ns
                if t_ns >= first_ns + TICK_NS:
                    break
                said = report(START_NS + t_ns, number, with_velocity=with_velocity)
                came.append((f"plotfeed/telemetry/d{number}", encode(said)))
        made.append(came)
    return made


def cost_us(scene: Scene, by_tick: Ticks, content_type: str) -> tuple[float, float, float]:
    """Processor time a message, microseconds: queued, taken in, and asked for afterwards."""
    inputs, trajectories = intake_of(scene)
    spent_ns, number = [0, 0, 0], 0
    for tick, came in enumerate(by_tick):
        now_ns = START_NS + (tick + 1) * TICK_NS
        marks = [time.process_time_ns()]
        for topic, payload in came:
            inputs.queue(topic, payload, content_type)
        marks.append(time.process_time_ns())
        inputs.take_in(now_ns, lambda: False)
        marks.append(time.process_time_ns())
        trajectories.state_at(now_ns)
        marks.append(time.process_time_ns())
        if tick >= len(by_tick) // 5:
            number += len(came)
            spent_ns = [s + b - a for s, a, b in zip(spent_ns, marks[:-1], marks[1:], strict=True)]
    queued, taken, asked = (s / number / 1000 for s in spent_ns)
    return queued, taken, asked


def show_costs(scene: Scene) -> None:
    """A table of loads."""
    print(f"Microseconds of processor time a message: median (least to most) of {RUNS} runs.")
    print(f"{YARDSTICK}\n")
    print("| drones | rate | as | queued | taken in | asked where | a second of one core "
          "| messages a yardstick |")  # fmt: skip
    print("|--:|--:|---|--:|--:|--:|--:|--:|")
    for drones, rate_hz, kind, with_velocity in (
        (1, 10.0, "protobuf", True),
        (50, 10.0, "protobuf", True),
        (1_000, 10.0, "protobuf", True),
        (1_000, 10.0, "JSON", True),
        (1_000, 10.0, "protobuf", False),
        (5_000, 10.0, "protobuf", True),
        (5_000, 10.0, "JSON", True),
    ):
        seconds = max(0.5, min(5.0, 20_000 / (drones * rate_hz)))
        by_tick = ticks(drones, rate_hz, seconds, kind=kind, with_velocity=with_velocity)
        content_type = "application/json" if kind == "JSON" else "application/x-protobuf"
        runs = [(cost_us(scene, by_tick, content_type), yardstick_us()) for _ in range(RUNS)]
        words = kind if with_velocity else f"{kind}, no velocities"
        each = [spread(costs, ".1f") for costs in zip(*(costs for costs, _ in runs), strict=True)]
        sums = [sum(costs) for costs, _ in runs]
        each.append(spread((1e6 / us for us in sums), ",.0f"))
        each.append(spread(ratios([yardstick for _, yardstick in runs], sums), ".1f"))
        print(f"| {drones:,} | {rate_hz:g} Hz | {words} | {' | '.join(each)} |", flush=True)


FLOOD_HZ, QUIET_HZ, RADARS = 50_000.0, 10.0, 20


def publish(drone: str, rate_hz: float, port: int, start_ns: int, seconds: float) -> None:
    """Publish one drone's reports at that rate, from that time on; packets are made before."""
    step_ns, together = round(NS / rate_hz), max(1, round(rate_hz / 100))
    with MqttReceiver(port, 5) as client:
        parts = []
        for first in range(0, round(seconds * rate_hz), together):
            reports = [
                report(start_ns + i * step_ns, 0, with_velocity=True).to_protobuf()
                for i in range(first, first + together)
            ]
            packed = [
                client._publication(f"plotfeed/telemetry/{drone}", one, "application/x-protobuf")
                for one in reports
            ]
            parts.append((start_ns + first * step_ns, b"".join(packed)))
        for due_ns, part in parts:
            time.sleep(max(0.0, (due_ns - time.time_ns()) / NS))
            client._socket.sendall(part)


class Watch(Observer):
    """What was taken in, and how late sectors left."""

    def __init__(self) -> None:
        self.begins = asyncio.Event()

    def begun(self, session: Session) -> None:  # type: ignore[override]
        """Keep the session."""
        self.session = session
        self.begins.set()


async def show_flood(folder: Path, seconds: float) -> None:
    """A table of sessions beside a flood, and of the same without it, in turns."""
    without, flooded = [], []
    for _ in range(RUNS):
        without.append(await beside(folder, seconds, flooded=False))
        flooded.append(await beside(folder, seconds, flooded=True))
    print("| | without | with the flood |\n|---|--:|--:|")
    for name in without[0]:
        form = ",.0f" if isinstance(without[0][name], int) else ".3f"
        cells = (spread([run[name] for run in runs], form) for runs in (without, flooded))
        print(f"| {name} | {' | '.join(cells)} |")
    cores = ([run["share of a core"] for run in runs] for runs in (flooded, without))
    print(f"| share of a core, times that without | | {spread(ratios(*cores), '.1f')} |")


async def beside(folder: Path, seconds: float, *, flooded: bool) -> dict[str, float]:
    """What becomes of a drone at 10 Hz, and of the session."""
    sensors = "".join(radar(f"radar{i}", period_s=1.0, sectors=32) for i in range(RADARS))
    text = scene_text(port=1883, drones="", sensors=sensors, mqtt="truth = false")
    scene, port, watch, stop = load(scene_file(folder, text)), free_port(), Watch(), asyncio.Event()
    configuration = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
    ages_s, behind_s = [], []
    with mosquitto(folder, port, configuration):
        broker, clock = f"mqtt://127.0.0.1:{port}", WallClock()
        running = asyncio.create_task(
            run(scene, clock=clock, broker=broker, stop=stop, observers=[watch])
        )
        await watch.begins.wait()
        start_ns = time.time_ns() + round((2 + 4 * seconds) * NS)
        rates_hz = {"quiet": QUIET_HZ} | ({"flood": FLOOD_HZ} if flooded else {})
        publishers = [
            await asyncio.create_subprocess_exec(
                sys.executable, __file__, *map(str, (drone, rate_hz, port, start_ns, seconds))
            )
            for drone, rate_hz in rates_hz.items()
        ]
        trajectories, totals = watch.session.trajectories, watch.session.totals
        await asyncio.sleep((start_ns - time.time_ns()) / NS)
        cpu_s, began_s = time.process_time(), time.monotonic()
        while time.time_ns() < start_ns + round(seconds * NS):
            await asyncio.sleep(0.02)
            behind_s.append(totals.intake_behind_s)
            if "quiet" in trajectories.names:
                row = trajectories.names.index("quiet")
                last_ns = int(trajectories.spans_ns[row, 1])
                ages_s.append((time.time_ns() - last_ns) / NS)
        cpu_s, took_s = time.process_time() - cpu_s, time.monotonic() - began_s
        taken, flooded_number = totals.telemetry, totals.flooded
        for publisher in publishers:
            await publisher.wait()
        stop.set()
        await running
    late_us = lateness_us(totals.lateness_ns, 50, 99)
    return {
        "telemetry taken": taken,
        "flooded, dropped": flooded_number,
        "quiet drone's last report, age p50, s": float(np.percentile(ages_s, 50)),
        "and at most, s": max(ages_s),
        "intake behind, at most, s": max(behind_s),
        "sectors' lateness p50, ms": late_us[0] / 1000,
        "sectors' lateness p99, ms": late_us[1] / 1000,
        "scans missed": totals.missed_scans,
        "share of a core": cpu_s / took_s,
    }


def main(seconds: float) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = scene_text(
            port=1883,
            drones="",
            sensors=radar(period_s=1.0, sectors=32),
            telemetry="geoid_undulation_m = 51.0\nmax_new_drones_per_s = 1000000",
        )
        show_costs(load(scene_file(folder, text)))
        print(
            f"\nA drone at {QUIET_HZ:g} Hz beside {FLOOD_HZ:,.0f} messages a second of another, "
            f"{RUNS} runs of {seconds:g} s in turns:\n"
        )
        asyncio.run(show_flood(folder, seconds))


if __name__ == "__main__":
    if len(sys.argv) > 2:
        _, name, rate, port, start, duration = sys.argv
        publish(name, float(rate), int(port), int(start), float(duration))
    else:
        main(float(sys.argv[1]) if sys.argv[1:] else SECONDS)
