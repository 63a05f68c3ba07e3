"""How late the messages of `plotfeed demo` leave, and how late they arrive.

    python tests/benchmarks/bench_lateness.py

The embedded broker, real time. What left when is in the ledger; arrival is taken in a subscriber
over MQTT 5, in a process of its own, and reckoned from the time at which the message was due.
"""

from __future__ import annotations

import asyncio
import sys
import time
from datetime import datetime
from typing import Any

import numpy as np
from demo_process import demo, subscriber

from plotfeed.proto import plotfeed_pb2 as pb

SECONDS = 60.0
PERCENTILES = (50.0, 99.0, 99.9, 100.0)


class Listener:
    """Collects lateness, nanoseconds."""

    def __init__(self) -> None:
        self.left_ns: list[int] = []
        self.arrived_ns: list[int] = []

    def heard(self, topic: str, payload: bytes, properties: dict[str, Any]) -> None:
        """One message."""
        now_ns = time.time_ns()
        if topic.endswith("/truth"):
            sent = pb.Ledger.FromString(payload).messages
            self.left_ns.extend(m.sent_utc_ns - m.due_utc_ns for m in sent)
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
        demo("--duration", str(seconds)) as running,
        subscriber(running, topics, listener.heard),
    ):
        await running.process.wait()
    return listener


def main() -> None:
    """Prints a table."""
    seconds = float(sys.argv[1]) if sys.argv[1:] else SECONDS
    listener = asyncio.run(listen(seconds))
    print(f"`plotfeed demo` for {seconds:g} s; milliseconds after the time at which a message was "
          "due.\n")  # fmt: skip
    print("| | messages | p50 | p99 | p99.9 | most |\n|---|--:|--:|--:|--:|--:|")
    for what, late_ns in (
        ("handed to the socket", listener.left_ns),
        ("received by a subscriber", listener.arrived_ns),
    ):
        late_ms = np.percentile(np.array(late_ns) / 1e6, PERCENTILES)
        print(f"| {what} | {len(late_ns):,} | " + " | ".join(f"{p:.2f}" for p in late_ms) + " |")


if __name__ == "__main__":
    main()
