"""What a fleet consists of: its workers, its parts, and what nobody has sent."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from plotfeed.feeds.fleet.part_server import PartOrder, Question
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.utc import NS

MOST_GAPS = 1000
LATE = "could not send in time"
"""Why there is a gap although a part is held: its holder was late, or had no lease or no broker."""


class WorkerDiedError(Exception):
    """A worker whose process is gone."""


class Worker(Protocol):
    """A `PartServer`, wherever it is; each method may raise `WorkerDiedError`."""

    name: str

    async def serve(self, order: PartOrder) -> dict[str, Any]:
        """Run a part to its end."""

    async def asks(self, key: str) -> Question:
        """Return when a lease is to be renewed."""

    async def granted(self, key: str, number: int) -> None:
        """Renew it."""

    async def refused(self, key: str) -> None:
        """Let it send nothing more."""

    async def stop(self, key: str) -> None:
        """End a part."""

    def leave(self) -> None:
        """End the worker, which runs nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """How a fleet runs."""

    workers: int
    spares: int = 1
    """Workers that wait to take over."""
    lease_s: float = 2.0
    broker: str | None = None
    """URL, or none for no MQTT."""
    duration_s: float | None = None
    is_simulated: bool = False
    record: Path | None = None
    """A folder."""
    ramp_up_s: float = 0.0
    """Over which parts begin one after another."""


@dataclass(slots=True)
class Gap:
    """What nobody sent of a part: sectors that ended after one time, and by another, UTC."""

    part: str
    sensors: tuple[str, ...]
    why: str
    from_utc_ns: int
    to_utc_ns: int | None = None


class Gaps(deque[Gap]):
    """The last gaps of a fleet, in the order in which they were noted."""

    def __init__(self) -> None:
        super().__init__(maxlen=MOST_GAPS)

    def begin(self, part: PartHeld, why: str) -> None:
        """Nobody sends a part from what was last sent on, if that is not known already."""
        if not any(gap.part == part.name and gap.to_utc_ns is None for gap in self):
            since_ns = part.sent_until_utc_ns or part.joins_utc_ns
            self.append(Gap(part.name, part.sensors, why, since_ns))

    def end(self, part: PartHeld) -> None:
        """Somebody sends it again."""
        for gap in self:
            if gap.part == part.name and gap.to_utc_ns is None:
                gap.to_utc_ns = part.joined_utc_ns

    def leave_out(
        self, part: PartHeld, holder: str, not_sent: Mapping[str, tuple[int, int]]
    ) -> None:
        """A holder has not sent some of what was due, by sensor; a gap just before goes on."""
        if not not_sent:
            return
        why = f"{holder} {LATE}"
        from_ns = min(first_ns for first_ns, _ in not_sent.values()) - 1
        to_ns = max(last_ns for _, last_ns in not_sent.values())
        sensors = frozenset(not_sent)
        last = next((gap for gap in reversed(self) if gap.part == part.name), None)
        if last is not None and last.why == why and from_ns <= (last.to_utc_ns or 0) + NS:
            sensors |= frozenset(last.sensors)
            from_ns, to_ns = min(from_ns, last.from_utc_ns), max(to_ns, last.to_utc_ns or 0)
            self.remove(last)
        in_order = tuple(name for name in part.sensors if name in sensors)
        self.append(Gap(part.name, in_order, why, from_ns, to_ns))


@dataclass(slots=True)
class PartHeld:
    """A part, and who has it."""

    name: str
    sensors: tuple[str, ...]
    leads: bool
    joins: str
    joins_utc_ns: int
    worker: Worker | None = None
    key: str = ""
    sent_until_utc_ns: int = 0
    joined_utc_ns: int = 0
    epoch: int = 0
    leaving: bool = False
    """The fleet ends: nobody takes it over."""


COUNTED = ("looks", "plots", "false_alarms", "messages", "undelivered", "missed_scans")
"""What the sum of all parts is told of."""


async def or_not(work: Awaitable[None], timeout_s: float) -> None:
    """Wait for an answer that may never come."""
    with contextlib.suppress(WorkerDiedError, TimeoutError):
        async with asyncio.timeout(timeout_s):
            await work


def is_fenced_by_broker(scene: Scene) -> bool:
    """Whether all that is sent goes by connections that a broker cuts off for the next one."""
    to = scene.outgoing
    return not (to.udp or to.queued or to.middleware)
