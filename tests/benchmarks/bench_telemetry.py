"""Telemetry taken in: processor time a message, and a drone at 10 Hz beside a flood.

    python tests/benchmarks/bench_telemetry.py [SECONDS]

Messages are queued as a transport queues them and taken in by ticks of 10 ms; each tick all drones
are then asked where they are. The flood comes over a broker that shares the machine, from a process
that writes packets made beforehand.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))


from plotfeed.feeds.delivery.counters import SessionCounters  # noqa: E402
from plotfeed.feeds.scene.scene import Scene  # noqa: E402
from plotfeed.feeds.session.inputs import SessionInputs  # noqa: E402
from plotfeed.feeds.session.observer import SessionContext  # noqa: E402
from plotfeed.feeds.telemetry.decode_reports import encode_json, encode_protobuf  # noqa: E402
from plotfeed.feeds.telemetry.position_report import PositionReport  # noqa: E402
from plotfeed.feeds.timing.clock import InstantClock  # noqa: E402
from plotfeed.feeds.timing.schedule import Schedule  # noqa: E402
from plotfeed.models.state import AltitudeReference  # noqa: E402
from plotfeed.models.truth import Trajectories  # noqa: E402

NS = 1_000_000_000
TICK_NS = 10_000_000
START_NS = 1_767_268_800 * NS
SECONDS = 10.0


def report(t_utc_ns: int, number: int, *, with_velocity: bool) -> PositionReport:
    """Of a drone that flies on."""
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=40.45 + 1e-4 * (number % 101) + 1e-9 * (t_utc_ns % NS) / NS,
        longitude_deg=-3.73 + 1e-4 * (number // 101 % 101),
        altitude_m=900.0,
        altitude_reference=AltitudeReference.ELLIPSOID,
        velocity_enu_m_s=(5.0, -2.0, 0.5) if with_velocity else None,
        horizontal_accuracy_m=1.0,
    )


def inputs_of(scene: Scene) -> tuple[SessionInputs, Trajectories]:
    """What takes telemetry in, with nobody to follow it."""
    trajectories = Trajectories(stale_after_s=scene.telemetry.stale_after_s)
    clock = InstantClock(START_NS)
    context = SessionContext(
        scene=scene,
        clock=clock,
        schedule=Schedule(clock.wake),
        totals=SessionCounters(),
        observers=(),
        keep_ledger=lambda *_: None,
    )
    return SessionInputs(context, trajectories, {}, lambda _: None), trajectories


Ticks = list[list[tuple[str, bytes]]]


def ticks(drones: int, rate_hz: float, seconds: float, *, kind: str, with_velocity: bool) -> Ticks:
    """Messages of so many drones by tick, the drones spread over their period."""
    encode = encode_json if kind == "JSON" else encode_protobuf
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
    inputs, trajectories = inputs_of(scene)
    spent_ns, number = [0, 0, 0], 0
    for tick, came in enumerate(by_tick):
        now_ns = START_NS + (tick + 1) * TICK_NS
        marks = [time.process_time_ns()]
        for topic, payload in came:
            inputs.queue(topic, payload, content_type)
        marks.append(time.process_time_ns())
        inputs.take_in(now_ns, lambda: False)
        marks.append(time.process_time_ns())
        trajectories.places_at(now_ns)
        marks.append(time.process_time_ns())
        if tick >= len(by_tick) // 5:
            number += len(came)
            spent_ns = [s + b - a for s, a, b in zip(spent_ns, marks[:-1], marks[1:], strict=True)]
    queued, taken, asked = (s / number / 1000 for s in spent_ns)
    return queued, taken, asked


def show_costs(scene: Scene) -> None:
    """A table of loads."""
    print("| drones | rate | as | queued | taken in | asked where | a second of one core |")
    print("|--:|--:|---|--:|--:|--:|--:|")
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
        costs = cost_us(scene, by_tick, content_type)
        words = kind if with_velocity else f"{kind}, no velocities"
        print(
            f"| {drones:,} | {rate_hz:g} Hz | {words} | "
            + " | ".join(f"{cost:.1f} µs" for cost in costs)
            + f" | {1e6 / sum(costs):,.0f} |"
        )
