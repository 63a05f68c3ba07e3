"""How late the messages of `plotfeed demo section-4`, which no link delays, leave and arrive.

    python tools/benchmarks/bench_lateness.py

The embedded broker, real time. What left when is in the ledger; arrival is taken in a subscriber
over MQTT 5, in a process of its own, and reckoned from the time at which the message was due. What
the machine itself can do is told by clock_nanosleep from C, in turns with the demo, at as many
deadlines a second, with nothing beside it.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np
from aims import aim, ratios, spread
from beside import nanosleep_late_us
from demo_process import demo, subscriber

from plotfeed.proto.ledger_pb2 import LedgerBatch

NS = 1_000_000_000
SECONDS, TURNS = 60.0, 5
PERCENTILES = (50.0, 99.0, 99.9, 100.0)
DEADLINES_PER_S = 40
AIM_P50_MS, AIM_RATIO = 0.15, 2.0


class Listener:
    """Collects lateness, nanoseconds."""

    def __init__(self) -> None:
        self.left_ns: list[int] = []
        self.arrived_ns: list[int] = []

    def heard(self, topic: str, payload: bytes, properties: dict[str, Any]) -> None:
        """One message."""
        now_ns = time.time_ns()
        if topic.endswith("/truth"):
            sent = LedgerBatch.FromString(payload).messages
            self.left_ns += np.subtract(sent.sent_utc_ns, sent.due_utc_ns).tolist()
        else:
            due = dict(properties["user_property"])["time"]
            self.arrived_ns.append(now_ns - _utc_ns(due))


def _utc_ns(text: str) -> int:
    """Of 2026-01-01T12:00:00.123456789Z."""
    seconds, _, fraction = text.removesuffix("Z").partition(".")
    return int(datetime.fromisoformat(f"{seconds}+00:00").timestamp()) * 10**9 + int(fraction)


async def listen(seconds: float) -> Listener:
    """What a demo of that length sends."""
    listener = Listener()
    topics = ["plotfeed/active/plots", "plotfeed/active/asterix/+", "plotfeed/truth"]
    async with (
        demo("section-4", "--duration", str(seconds)) as running,
        subscriber(running, topics, listener.heard),
    ):
        await running.process.wait()
    return listener


def percentiles_ms(late_ms: Sequence[Any]) -> Any:
    """Medians over the turns."""
    return np.median([np.percentile(turn, PERCENTILES) for turn in late_ms], axis=0)


def main() -> None:
    """Prints a table."""
    seconds = (float(sys.argv[1]) if sys.argv[1:] else SECONDS) / TURNS
    machine, left, arrived = [], [], []
    for _ in range(TURNS):
        found = nanosleep_late_us(round(seconds / 2 * DEADLINES_PER_S), NS // DEADLINES_PER_S)
        if found is not None:
            machine.append(found / 1e3)
        listener = asyncio.run(listen(seconds))
        left.append(np.array(listener.left_ns) / 1e6)
        arrived.append(np.array(listener.arrived_ns) / 1e6)
    print(
        f"`plotfeed demo section-4`, {TURNS} times {seconds:g} s in turns with C; milliseconds\n"
        "after the time at which a message was due, medians of the turns.\n"
    )
    print("| | messages | p50 | p99 | p99.9 | most |\n|---|--:|--:|--:|--:|--:|")
    rows = [("handed to the socket", left), ("received by a subscriber", arrived)]
    if machine:
        rows.append(("clock_nanosleep in C, timer slack 1 ns", machine))
    for what, turns in rows:
        cells = " | ".join(f"{p:.3f}" for p in percentiles_ms(turns))
        print(f"| {what} | {sum(map(len, turns)):,} | {cells} |")
    if machine:
        ours, theirs = (
            np.array([np.percentile(turn, PERCENTILES) for turn in turns]).T
            for turns in (left, machine)
        )
        each = [ratios(a, b) for a, b in zip(ours, theirs, strict=True)]
        cells = " | ".join(spread(ratio, ".1f") for ratio in each)
        print(f"| handed to the socket, times C, by turns | | {cells} |")
        what, p50_ms, ratio = "handed to the socket", np.median(ours[0]), np.median(each[1])
        is_met = p50_ms <= AIM_P50_MS
        print("\n" + aim(what, f"p50 {AIM_P50_MS} ms", f"{spread(ours[0])} ms", is_met=is_met))
        limit = f"p99 {AIM_RATIO:g} times that of C"
        print(aim(what, limit, f"{spread(each[1], '.1f')} times", is_met=ratio <= AIM_RATIO))


if __name__ == "__main__":
    main()
