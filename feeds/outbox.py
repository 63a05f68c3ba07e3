"""Where messages leave: over every broker of the session, each exit counted and timed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from plotfeed.feeds.clock import Clock
from plotfeed.feeds.message import Message
from plotfeed.proto import plotfeed_pb2 as pb

LATENESS_KEPT = 100_000


class Link(Protocol):
    """Something that carries messages away, at once or not at all."""

    def publish(self, message: Message) -> bool:
        """Hand a message over; False if it was not taken."""

    async def drain(self, timeout_s: float = ...) -> None:
        """Wait until everything has left, or the time is up."""


class Connection(Link, Protocol):
    """A link that has to be made, and made again, while the session runs."""

    name: str

    async def run(self) -> None:
        """Keep it up until cancelled."""

    async def wait_until_up(self, timeout_s: float | None = ...) -> None:
        """Return once it is up; raises `PlotfeedError` if it is not in that time."""


Tap = Callable[[Message, int], None]
"""Called with every message and the time at which it left."""


class Outbox:
    """One client's way out: the same messages over all its links, and to the tap."""

    def __init__(self, clock: Clock, links: Sequence[Link], tap: Tap | None = None) -> None:
        self.sent = 0
        self.undelivered = 0
        self.lateness_ns: deque[int] = deque(maxlen=LATENESS_KEPT)
        self._clock = clock
        self._links = links
        self._tap = tap

    def send(self, message: Message) -> pb.Sent:
        """Send it now; it is delivered if every link took it. It is not kept for later."""
        taken = [link.publish(message) for link in self._links]
        delivered = all(taken)
        sent_utc_ns = self._clock.now_ns()
        if self._tap is not None:
            self._tap(message, sent_utc_ns)
        self.sent += 1
        self.undelivered += not delivered
        self.lateness_ns.append(sent_utc_ns - message.due_utc_ns)
        return pb.Sent(
            topic=message.topic,
            due_utc_ns=message.due_utc_ns,
            sent_utc_ns=sent_utc_ns,
            octets=len(message.payload),
            delivered=delivered,
        )

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        for link in self._links:
            await link.drain(timeout_s)


def lateness_us(lateness_ns: Sequence[int], *percentiles: float) -> list[float]:
    """Percentiles of how late messages left, microseconds; zeros if none did."""
    if not lateness_ns:
        return [0.0] * len(percentiles)
    return [float(p) / 1e3 for p in np.percentile(np.asarray(lateness_ns), percentiles)]
