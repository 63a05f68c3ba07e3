"""What everything that works in one session shares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.timing.schedule import Schedule

KeepLedger = Callable[[SectorReport, str, list[Delivery]], None]
"""Given a sector, its link's keys then in JSON, and its deliveries, all settled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionContext:
    """A session's scene, its time, its counts, and who follows it."""

    scene: Scene
    clock: Clock
    schedule: Schedule
    totals: SessionCounters
    observers: Sequence[Observer]
    keep_ledger: KeepLedger
